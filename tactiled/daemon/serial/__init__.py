"""Serial port: open, read, write, and reopen after a loss; latency timer and errors of the adapter."""

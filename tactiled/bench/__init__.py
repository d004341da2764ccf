"""The measured trades: each module is one `tactiled bench NAME`."""

"""Many boards in one process: cost, memory and latency by their number."""

"""Benches of the whole daemon: clock, faults."""

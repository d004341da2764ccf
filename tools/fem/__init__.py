"""Finite elements of one taxel: its linear compliance, and runs with friction that were made once."""

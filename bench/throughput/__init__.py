"""Scans a second through a pty, and files in times real time, with processor and memory of the daemon."""

"""Scans a second through a pty, and files in times real time."""

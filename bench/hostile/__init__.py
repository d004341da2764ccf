"""Attacks on every border of the program, done for real: files, stores, sockets, clocks, USB strings."""

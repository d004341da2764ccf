"""Bytes to frames and back, with no I/O: the one room that daemon and emulator share."""

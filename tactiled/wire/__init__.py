"""Encoding and decoding of frames, without I/O; shared by daemon and emulator."""

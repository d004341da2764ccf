"""The emulated cable: adapter, faults of the line, and the pty or TCP port that a host opens."""

"""Time limit for what a test waits for."""

PATIENCE_S = 60.0  # tells a hang from a slow machine: Python and its libraries take 10 s to start on some

"""A scene in which an object is held, for tests of `tactiled tune`."""

HELD = """
name = "held"
contact = "signal"
phases = [
    { kind = "press", duration_s = 0.5, force_n = 20.0 },
    { kind = "hold", duration_s = 600.0 },
]
"""

"""Emulator of a board with its sensor, the surface that it touches, and the serial line with its faults.

::

    scene -> motion -> contact -> electronics -> firmware -> line -> bytes
                 `-> truth                           `-> scan truth

Everything up to `port` is sans-I/O: time is an argument. `simulate` runs it in simulated time, `realtime` on
the host's clock.
"""

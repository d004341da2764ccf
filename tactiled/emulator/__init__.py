"""The other end of the cable: a board, its sensor, the world it touches and the line's faults.

::

    scene -> motion -> contact (the seam) -> electronics -> firmware -> line -> bytes
                 `-> truth                                     `-> scan truth

Everything up to `port` is sans-I/O: time is an argument. `simulate` injects a clock that jumps, `shell` the
real one.
"""

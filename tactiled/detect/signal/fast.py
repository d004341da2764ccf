"""The classes of `front_end`, compiled where the installation has a compiler (`tactiled.compiled`)."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.signal.front_end import (
    Bank,
    Hold,
    Jumps,
    NoiseFloor,
    Pressure,
    Readings,
    RelievedSides,
    StuckChannels,
)

__all__ = ["Bank", "Hold", "Jumps", "NoiseFloor", "Pressure", "Readings", "RelievedSides", "StuckChannels"]

if not TYPE_CHECKING and (_found := compiled_module("tactiled.detect.signal.front_end")) is not None:
    globals().update({name: getattr(_found, name) for name in __all__})

"""The classes of `front_end` and `pressure`, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import fastest
from tactiled.detect.signal.front_end import Bank, Readings, StuckChannels
from tactiled.detect.signal.pressure import Hold, Levels, Pressure, RestNoise

__all__ = ["Bank", "Hold", "Levels", "Pressure", "Readings", "RestNoise", "StuckChannels"]

if not TYPE_CHECKING:
    globals().update({name: fastest(globals()[name]) for name in __all__})

"""The classes of `front_end` and `pressure`, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.signal.front_end import Bank, Readings, StuckChannels
from tactiled.detect.signal.pressure import Hold, Levels, Pressure, RestNoise

__all__ = ["Bank", "Hold", "Levels", "Pressure", "Readings", "RestNoise", "StuckChannels"]

if not TYPE_CHECKING:
    if (_found := compiled_module("tactiled.detect.signal.front_end")) is not None:
        Bank, Readings, StuckChannels = _found.Bank, _found.Readings, _found.StuckChannels
    if (_found := compiled_module("tactiled.detect.signal.pressure")) is not None:
        Hold, Levels, Pressure, RestNoise = _found.Hold, _found.Levels, _found.Pressure, _found.RestNoise

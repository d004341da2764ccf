"""The classes of `front_end` and `pressure`, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.signal.front_end import Bank, Jumps, NoiseFloor, Readings, RelievedSides, StuckChannels
from tactiled.detect.signal.pressure import Hold, Levels, Pressure, RestNoise, RestSwing

__all__ = [
    "Bank",
    "Hold",
    "Jumps",
    "Levels",
    "NoiseFloor",
    "Pressure",
    "Readings",
    "RelievedSides",
    "RestNoise",
    "RestSwing",
    "StuckChannels",
]

if not TYPE_CHECKING:
    if (_found := compiled_module("tactiled.detect.signal.front_end")) is not None:
        Bank, Jumps, NoiseFloor = _found.Bank, _found.Jumps, _found.NoiseFloor
        Readings, RelievedSides, StuckChannels = _found.Readings, _found.RelievedSides, _found.StuckChannels
    if (_found := compiled_module("tactiled.detect.signal.pressure")) is not None:
        Hold, Levels, Pressure = _found.Hold, _found.Levels, _found.Pressure
        RestNoise, RestSwing = _found.RestNoise, _found.RestSwing

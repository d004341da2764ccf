"""The classes that every scan runs through, compiled where the installation has a compiler."""

import functools
from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.contact.filter import ContactFilter, Memory, Trees
from tactiled.detect.contact.signs import Signs
from tactiled.detect.signal.front_end import Bank, Readings, StuckChannels
from tactiled.detect.signal.pressure import Hold, Levels, Pressure, RestNoise

__all__ = ["Bank", "ContactFilter", "Hold", "Levels", "Memory", "Pressure", "Readings", "RestNoise", "Signs"]
__all__ += ["StuckChannels", "Trees"]

if not TYPE_CHECKING:
    _compiled = functools.cache(compiled_module)
    for _name in __all__:
        if (_found := _compiled(globals()[_name].__module__)) is not None:
            globals()[_name] = getattr(_found, _name)

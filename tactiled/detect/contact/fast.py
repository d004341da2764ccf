"""The classes that every look runs through, compiled where the installation has a compiler.

`signs`, `memory`, `trees` and `posterior` are plain Python. Cython compiles the same files with the types of
the ``.pxd`` files beside them (`hatch_build.py`); results have the same bits, and a look takes a fortieth of
the time.
"""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.contact.memory import Memory
from tactiled.detect.contact.posterior import Posterior
from tactiled.detect.contact.signs import Signs
from tactiled.detect.contact.trees import Trees

__all__ = ["Memory", "Posterior", "Signs", "Trees"]

if not TYPE_CHECKING:
    _names = "memory", "posterior", "signs", "trees"
    _found = [compiled_module(f"tactiled.detect.contact.{name}") for name in _names]
    if all(_found):
        Memory, Posterior = _found[0].Memory, _found[1].Posterior
        Signs, Trees = _found[2].Signs, _found[3].Trees

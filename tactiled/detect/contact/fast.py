"""The classes that every scan in contact runs through, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.contact.filter import ContactFilter, Memory, Trees
from tactiled.detect.contact.signs import Signs

__all__ = ["ContactFilter", "Memory", "Signs", "Trees"]

if not TYPE_CHECKING:
    if (_found := compiled_module("tactiled.detect.contact.filter")) is not None:
        ContactFilter, Memory, Trees = _found.ContactFilter, _found.Memory, _found.Trees
    if (_found := compiled_module("tactiled.detect.contact.signs")) is not None:
        Signs = _found.Signs

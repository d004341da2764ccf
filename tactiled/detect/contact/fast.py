"""The classes that every scan in contact runs through, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.detect.contact.filter import ContactFilter
from tactiled.detect.contact.friction import FrictionMemory
from tactiled.detect.contact.hysteresis import SlipHysteresis
from tactiled.detect.contact.memory import Memory
from tactiled.detect.contact.posterior import Posterior
from tactiled.detect.contact.signs import Signs
from tactiled.detect.contact.trees import Trees

__all__ = ["ContactFilter", "FrictionMemory", "Memory", "Posterior", "Signs", "SlipHysteresis", "Trees"]

if not TYPE_CHECKING:
    if (_found := compiled_module("tactiled.detect.contact.filter")) is not None:
        ContactFilter = _found.ContactFilter
    if (_found := compiled_module("tactiled.detect.contact.friction")) is not None:
        FrictionMemory = _found.FrictionMemory
    if (_found := compiled_module("tactiled.detect.contact.hysteresis")) is not None:
        SlipHysteresis = _found.SlipHysteresis
    if (_found := compiled_module("tactiled.detect.contact.memory")) is not None:
        Memory = _found.Memory
    if (_found := compiled_module("tactiled.detect.contact.posterior")) is not None:
        Posterior = _found.Posterior
    if (_found := compiled_module("tactiled.detect.contact.signs")) is not None:
        Signs = _found.Signs
    if (_found := compiled_module("tactiled.detect.contact.trees")) is not None:
        Trees = _found.Trees

"""The classes that every scan in contact runs through, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import fastest
from tactiled.detect.contact.filter import ContactFilter
from tactiled.detect.contact.friction import FrictionMemory
from tactiled.detect.contact.hysteresis import SlipHysteresis
from tactiled.detect.contact.memory import Memory
from tactiled.detect.contact.posterior import Posterior
from tactiled.detect.contact.signs import Signs
from tactiled.detect.contact.trees import Trees

__all__ = ["ContactFilter", "FrictionMemory", "Memory", "Posterior", "Signs", "SlipHysteresis", "Trees"]

if not TYPE_CHECKING:
    globals().update({name: fastest(globals()[name]) for name in __all__})

"""Answers of the contact filter to a few worlds, which tell whether a figure is older than the code."""

import numpy as np

from bench.worlds.generators import GENERATORS, draw
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.events.types import GripEvent

_SEEDS, _MINUTES = range(500_000, 500_002), 0.2  # choice: on other seeds than any result


def answers() -> dict[str, list[float]]:
    """Return mean utilisation, mean probability of sliding and number of other events, by generator."""
    found = {}
    for generator in GENERATORS:
        events = [
            event
            for world in draw(generator, _SEEDS, _MINUTES)
            for event in GripDetector(world.array).process(world.block)
        ]
        grips = [(event.utilisation, event.p_sliding) for event in events if isinstance(event, GripEvent)]
        found[generator] = [*np.mean(grips, axis=0).round(9).tolist(), len(events) - len(grips)]
    return found

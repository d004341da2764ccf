"""Answers of the contact filter to a few worlds, which tell whether a figure is older than the code."""

import numpy as np

from bench.slip.cases import run_settings
from bench.worlds.generators import GENERATORS, draw
from tactiled.detect.suite import DetectParams
from tactiled.events.types import Event, GripEvent

_DEFAULT = DetectParams().setting
_SEEDS, _MINUTES = range(500_000, 500_002), 0.2  # choice: on other seeds than any result


def answers() -> dict[str, list[float]]:
    """Return mean utilisation and probability of sliding, and other events by setting, of each generator."""
    found = {}
    for generator in GENERATORS:
        by_setting: dict[str, list[Event]] = {}
        for world in draw(generator, _SEEDS, _MINUTES):
            for name, events in run_settings(world.array, world.block).items():
                by_setting.setdefault(name, []).extend(events)
        grips = [
            (event.utilisation, event.p_sliding)
            for event in by_setting[_DEFAULT]
            if isinstance(event, GripEvent)
        ]
        n_others = [sum(not isinstance(one, GripEvent) for one in some) for some in by_setting.values()]
        found[generator] = [*np.mean(grips, axis=0).round(9).tolist(), *n_others]
    return found

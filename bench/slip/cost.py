"""Processor time of slip detection: scan by scan as it is live, and in blocks as in a file."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bench.report import table
from bench.slip.replay import OTHERS
from bench.slip.scenes import ARRAY, NOISES_V, RATE_HZ, at_speed, block_of, play
from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.samples.block import ScanBlock

_SEED = 1001
_BLOCK = 1000  # scans at once in a file
_SCANS = 500

DETECTORS: Mapping[str, Callable[[Array], Detector]] = {
    "contact filter": lambda array: build_suite(array, DetectParams(), topics=("slip", "contact")),
    **OTHERS,
}


class DetectorCost(NamedTuple):
    """Processor time of a detector.

    Attributes
    ----------
    away_us, contact_us : float
        Mean for a scan, one after the other, without contact and in contact.
    times_real_time : float
        In contact, in blocks of `_BLOCK`.
    """

    away_us: float
    contact_us: float
    times_real_time: float


def detector_costs() -> dict[str, DetectorCost]:
    """Cost of the contact filter, which is the same for all its settings, and of the other detectors."""
    played = play("1 mm/s", at_speed(1.0), _SEED)
    counts = played.counts(NOISES_V[0], draw=0)
    whole = block_of(counts)
    begins = round(played.press_end_s * RATE_HZ)
    press, touch = whole[:begins], whole[begins:]
    away = block_of(np.repeat(counts[:1], _SCANS, axis=0))
    return {
        name: DetectorCost(
            away_us=_spent_us(build(ARRAY), _in_parts(away, 1)),
            contact_us=_spent_us(_after(build(ARRAY), press), _in_parts(touch, 1)),
            times_real_time=1e6 / RATE_HZ / _spent_us(_after(build(ARRAY), press), _in_parts(touch, _BLOCK)),
        )
        for name, build in DETECTORS.items()
    }


def _after(detector: Detector, block: ScanBlock) -> Detector:
    detector.process(block)
    return detector


def _in_parts(block: ScanBlock, size: int) -> list[ScanBlock]:
    return [block[start : start + size] for start in range(0, len(block), size)]


def _spent_us(detector: Detector, parts: Sequence[ScanBlock]) -> float:
    began_s = time.process_time()
    for part in parts:
        detector.process(part)
    return 1e6 * (time.process_time() - began_s) / sum(map(len, parts))


def cost_table(costs: Mapping[str, DetectorCost]) -> str:
    """Cost by detector."""
    return table(
        {
            "detector": name,
            "no contact (us)": f"{cost.away_us:.0f}",
            "in contact (us)": f"{cost.contact_us:.0f}",
            "a file in contact, times real time": f"{cost.times_real_time:.0f}",
        }
        for name, cost in costs.items()
    )

"""Cost of slip detection: one scan at a time as it is live, and in blocks as in a replay."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bench.slip.detectors import PAPER_LEVEL, Tuning, compared_detectors
from bench.slip.rules import window_coefficients
from bench.slip.scenes import ARRAY, NOISES_V, PlayedScene
from tactiled.samples.block import ScanBlock

PLAIN = "pywt.swt, plain"
_BLOCK = 1000  # scans at once in a replay
_WINDOW = 256  # scans of the plain window: a power of two, and longer than level 5's filter


class DetectorCost(NamedTuple):
    """Time of a detector.

    Attributes
    ----------
    live_us : float
        Median for one scan at a time.
    scans_per_s : float
        Of processor time, in blocks of `_BLOCK`.
    """

    live_us: float
    scans_per_s: float


def detector_costs(played: PlayedScene, tuning: Tuning, n_scans: int) -> dict[str, DetectorCost]:
    """Cost of each detector, and of the plain transform of the last 256 scans at every scan."""
    noise_v = NOISES_V[0]
    block = played.read(noise_v, draw=0)[:n_scans]
    costs = {
        name: _cost(block, detector.build(ARRAY, noise_v).process, detector.build(ARRAY, noise_v).process)
        for name, detector in compared_detectors(tuning).items()
    }
    history = np.zeros((_WINDOW, ARRAY.n_channels))

    def slide(part: ScanBlock) -> None:
        for volts in part.volts:
            history[:-1] = history[1:]
            history[-1] = volts
            window_coefficients(history, PAPER_LEVEL)

    costs[PLAIN] = _cost(block[: max(len(block) // 10, 2)], slide, slide)
    return costs


def _cost(
    block: ScanBlock, live: Callable[[ScanBlock], object], replay: Callable[[ScanBlock], object]
) -> DetectorCost:
    live_s = []
    for n in range(len(block)):
        scan = block[n : n + 1]
        began = time.perf_counter()
        live(scan)
        live_s.append(time.perf_counter() - began)
    began = time.process_time()
    for start in range(0, len(block), _BLOCK):
        replay(block[start : start + _BLOCK])
    return DetectorCost(1e6 * float(np.median(live_s)), len(block) / (time.process_time() - began))

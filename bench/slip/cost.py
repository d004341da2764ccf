"""What slip detection costs: a scan at a time as it is live, and in blocks as in a replay."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.slip.rivals import PAPER_LEVEL, Knobs, rivals
from bench.slip.rules import window_coefficients
from bench.slip.scenes import NOISES_V, Played
from tactiled.array import load_array
from tactiled.samples.block import ScanBlock

_BLOCK = 1000  # scans handed over at once in a replay
_WINDOW = 256  # scans of the plain window: a power of two, and longer than level 5's filter


@dataclass(frozen=True)
class Cost:
    """Processor time.

    Attributes
    ----------
    live_us : float
        Median for one scan at a time.
    scans_per_s : float
        In blocks of `_BLOCK`.
    """

    live_us: float
    scans_per_s: float


def costs(played: Played, knobs: Knobs, *, scans: int) -> dict[str, Cost]:
    """Of each detector, and of the plain transform of the last 256 scans at every scan."""
    block, array = played.read(NOISES_V[0], draw=0), load_array("wang2019-3x3")
    scans = min(scans, len(block))
    found = {}
    for name, rival in rivals(knobs).items():
        one, many = rival.build(array, NOISES_V[0]), rival.build(array, NOISES_V[0])
        found[name] = _cost(block[:scans], one.process, many.process)

    history = np.zeros((_WINDOW, array.n_channels))

    def slide(part: ScanBlock) -> None:
        for volts in part.volts:
            history[:-1] = history[1:]
            history[-1] = volts
            window_coefficients(history, PAPER_LEVEL)

    found["pywt.swt, plain"] = _cost(block[: max(scans // 10, 2)], slide, slide)
    return found


def _cost(block: ScanBlock, one: Callable[[ScanBlock], object], many: Callable[[ScanBlock], object]) -> Cost:
    each = []
    for n in range(len(block)):
        scan = block[n : n + 1]
        began = time.perf_counter()
        one(scan)
        each.append(time.perf_counter() - began)
    began = time.process_time()
    for start in range(0, len(block), _BLOCK):
        many(block[start : start + _BLOCK])
    return Cost(1e6 * float(np.median(each)), len(block) / (time.process_time() - began))

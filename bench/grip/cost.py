"""Processor time of the contact filter for a scan of the shipped array.

Hot: scans one after the other. Live: a scan each 10 ms, as a board sends them; meanwhile the processor sleeps
or does other work, and caches are cold.
"""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tactiled.array import load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.samples.block import ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
RATE_HZ = 100.0
_SETTLED_SCANS, _SCANS = 250, 200  # until shear grows, and measured from then on
_NOISE_V = 1e-3


class ScanCost(NamedTuple):
    """Processor time of a scan in microseconds, the mean over scans in contact while shear grows."""

    hot_us: float
    live_us: float


def scan_cost() -> ScanCost:
    """Measure."""
    touch = _touch()
    blocks = [touch[k : k + 1] for k in range(len(touch))]
    return ScanCost(_spent_us(blocks, 0.0), _spent_us(blocks, 1.0 / RATE_HZ))


def _spent_us(blocks: Sequence[ScanBlock], pause_s: float) -> float:
    """Mean processor time of this thread for a scan, with pauses between: caches grow cold, as live."""
    detector, spent_s = GripDetector(ARRAY, GripParams()), []
    for number, block in enumerate(blocks):
        if number >= _SETTLED_SCANS and pause_s:
            time.sleep(pause_s)
        began_s = time.thread_time()
        detector.process(block)
        spent_s.append(time.thread_time() - began_s)
    return 1e6 * float(np.mean(spent_s[_SETTLED_SCANS:]))


def _touch() -> ScanBlock:
    """Return a press, then shear that grows until the end; loads are uneven, and shear goes as stiffness."""
    rng = np.random.default_rng(0)
    scans = np.arange(_SETTLED_SCANS + _SCANS)[:, np.newaxis]
    load = rng.uniform(0.5, 1.5, ARRAY.n_taxels)[ARRAY.channel_taxel]
    pressed = np.clip(scans / RATE_HZ - 0.5, 0.0, 1.0) * load
    sheared = 0.4 * np.clip((scans - _SETTLED_SCANS) / _SCANS, 0.0, 1.0) * np.cbrt(load)
    along = np.cos(np.radians(ARRAY.azimuth_deg))  # of the shear, which is along x
    noise = _NOISE_V * rng.standard_normal(pressed.shape)
    return regular_block(pressed + along * sheared + noise, RATE_HZ)

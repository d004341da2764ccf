"""Processor time of the contact filter for a scan, over arrays of several sizes.

Hot: scans one after the other. Live: a scan each 10 ms, as a board sends them; meanwhile the processor sleeps
or does other work, and caches are cold.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from bench.processes import spent_on_scans_us
from bench.worlds.arrays import square_array
from tactiled.array import Array, load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.samples.block import ScanBlock, regular_block

SIDES = (1, 3, 4, 8)  # taxels along the side of a square, each with a load and two shears
SHIPPED = "wang2019-3x3"
RATE_HZ = 100.0
_SETTLED_SCANS, _SCANS = 250, 200  # until shear grows, and measured from then on
_NOISE_V = 1e-3


class ScanCost(NamedTuple):
    """Processor time of a scan in microseconds, the mean over scans in contact while shear grows."""

    hot_us: float
    live_us: float


def scan_costs() -> dict[str, ScanCost]:
    """Return the cost by array."""
    squares = {f"{n} x {n}": square_array("xyz", n, 4.0) for n in SIDES}
    arrays = {SHIPPED: load_array(SHIPPED)} | squares
    return {name: _measure(array) for name, array in arrays.items()}


def _measure(array: Array) -> ScanCost:
    touch = _touch(array)
    blocks = [touch[k : k + 1] for k in range(len(touch))]
    costs_us = []
    for pause_s in (0.0, 1.0 / RATE_HZ):
        detector = GripDetector(array, GripParams())
        for block in blocks[:_SETTLED_SCANS]:
            detector.process(block)
        costs_us.append(float(np.mean(spent_on_scans_us(detector.process, blocks[_SETTLED_SCANS:], pause_s))))
    return ScanCost(*costs_us)


def _touch(array: Array) -> ScanBlock:
    """Return a press, then shear that grows until the end; loads are uneven, and shear goes as stiffness."""
    rng = np.random.default_rng(0)
    scans = np.arange(_SETTLED_SCANS + _SCANS)[:, np.newaxis]
    load = rng.uniform(0.5, 1.5, array.n_taxels)[array.channel_taxel]
    pressed = np.clip(scans / RATE_HZ - 0.5, 0.0, 1.0) * load
    sheared = 0.4 * np.clip((scans - _SETTLED_SCANS) / _SCANS, 0.0, 1.0) * np.cbrt(load)
    # What a channel shows of a load, and of a shear along x.
    shows = {"normal": (1.0, 0.0), "shear_x": (0.0, 1.0), "shear_y": (0.0, 0.0)}
    volts = _NOISE_V * rng.standard_normal(pressed.shape)
    for c, kind in enumerate(array.channel_kind):
        of_load, of_shear = shows.get(kind, (1.0, float(np.cos(np.radians(array.azimuth_deg[c])))))
        volts[:, c] += of_load * pressed[:, c] + of_shear * sheared[:, c]
    return regular_block(volts, RATE_HZ)


def cost_rows(costs: Mapping[str, ScanCost]) -> Iterator[dict[str, str]]:
    """Yield a row for each array."""
    for name, cost in costs.items():
        yield {"array": name, "hot (us)": f"{cost.hot_us:.0f}", "live (us)": f"{cost.live_us:.0f}"}

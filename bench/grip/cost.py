"""Processor time of the contact model for a scan, compiled and on numpy, over arrays of several sizes.

Hot: scans one after the other. Live: a scan each 10 ms, as a board sends them; meanwhile the processor sleeps
or does other work, and caches are cold.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from tactiled import compiled
from tactiled.array import Array, ArrayFile, Grid, TaxelChannel, build
from tactiled.detect.grip.detector import GripDetector, GripParams
from tactiled.samples.block import ScanBlock, regular_block

SIDES = (1, 3, 4, 8)  # taxels along the side of a square
ARRAY_SIDE = 3  # of the 2019 array
RATE_HZ = 100.0
WAYS = ("compiled", "numpy")
_SETTLED_SCANS, _SCANS = 250, 200  # until shear grows, and measured from then on
_NOISE_V = 1e-3


class ScanCost(NamedTuple):
    """Processor time of a scan in microseconds, the mean over scans in contact while shear grows."""

    hot_us: float
    live_us: float


def scan_costs() -> dict[str, dict[int, ScanCost]]:
    """Return the cost by way and number of taxels; without a library, on numpy only."""
    ways = WAYS if compiled.path.functions is not None else WAYS[1:]
    return {way: {side**2: _measure(way, side) for side in SIDES} for way in ways}


def _measure(way: str, side: int) -> ScanCost:
    with _on(way):
        array = _square(side)
        touch = _touch(array)
        blocks = [touch[k : k + 1] for k in range(len(touch))]
        return ScanCost(_spent_us(array, blocks, 0.0), _spent_us(array, blocks, 1.0 / RATE_HZ))


@contextmanager
def _on(way: str) -> Iterator[None]:
    """Make objects on the compiled path or on numpy."""
    before = compiled.path
    if way == "numpy":
        compiled.path = compiled.CompiledPath(None, "bench")
    try:
        yield
    finally:
        compiled.path = before


def _square(side: int) -> Array:
    places = [4.0 * k for k in range(side)]
    return build(
        ArrayFile(
            name="square",
            grids=[Grid(x_mm=places, y_mm=places)],
            taxel_channels=[
                TaxelChannel(name="x", kind="shear_x"),
                TaxelChannel(name="y", kind="shear_y"),
                TaxelChannel(name="z", kind="normal"),
            ],
            full_scale_volts=8.0,
        )
    )


def _touch(array: Array) -> ScanBlock:
    """Return a press, then shear that grows until the end; loads are uneven, and shear goes as stiffness."""
    rng = np.random.default_rng(0)
    n, n_taxels = _SETTLED_SCANS + _SCANS, array.n_taxels
    load = rng.uniform(0.5, 1.5, n_taxels)
    pressed = np.clip(np.arange(n) / RATE_HZ - 0.5, 0.0, 1.0)
    sheared = 0.4 * np.clip((np.arange(n) - _SETTLED_SCANS) / _SCANS, 0.0, 1.0)
    volts = np.zeros((n, n_taxels, 3))
    volts[..., 0] = -sheared[:, np.newaxis] * np.cbrt(load)
    volts[..., 2] = pressed[:, np.newaxis] * load
    return regular_block(volts.reshape(n, -1) + _NOISE_V * rng.standard_normal((n, 3 * n_taxels)), RATE_HZ)


def _spent_us(array: Array, blocks: list[ScanBlock], pause_s: float) -> float:
    detector = GripDetector(array, GripParams(enabled=True))
    for block in blocks[:_SETTLED_SCANS]:
        detector.process(block)
    spent_s = 0.0
    for block in blocks[_SETTLED_SCANS:]:
        if pause_s:
            time.sleep(pause_s)
        began_s = time.thread_time()
        detector.process(block)
        spent_s += time.thread_time() - began_s
    return 1e6 * spent_s / _SCANS


def cost_rows(costs: dict[str, dict[int, ScanCost]]) -> Iterator[dict[str, str]]:
    """Yield a row for each number of taxels."""
    for n_taxels in costs["numpy"]:
        yield {"taxels": f"{n_taxels}"} | {
            f"{way}, {kind} (us)": f"{value:.0f}"
            for way, found in costs.items()
            for kind, value in zip(("hot", "live"), found[n_taxels], strict=True)
        }

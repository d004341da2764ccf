"""What texture costs: processor time of one answer, and of the whole online estimator, by size.

Signals are clean, so that every answer is a full one. Times are of one thread, the least of several runs:
what else the machine does can only add.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, load_array
from tactiled.bench.report import table
from tactiled.bench.texture_answers import faithful, joint_fit
from tactiled.bench.texture_bound import Wave
from tactiled.bench.texture_online import slip_at
from tactiled.bench.texture_signal import LEVEL_VOLTS, RATE_HZ, Case, readings, sensed_by
from tactiled.detect.grooves import Motion
from tactiled.detect.texture_joint import PRESETS, JointParams, JointTexture
from tactiled.detect.texture_paper import PaperTexture, TextureParams
from tactiled.samples.block import ScanBlock, regular_block

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
ARRAYS = ("normal-3x3", "normal-4x4", "xyz-two-pads-4x4")
BLOCK_SCANS = 1000  # handed over at once, as in a replay
_SLIDE_S = 20.0
_WAVE = Wave(1.2, 30.0, 9.0)  # six periods in the shortest window
_SNR_DB = 20.0


@dataclass(frozen=True)
class Cost:
    """Milliseconds of processor time for one window."""

    what: str
    array: str
    channels: int
    window_s: float
    milliseconds: float


@dataclass(frozen=True)
class OnlineCost:
    """A whole estimator on a slide, in blocks of `BLOCK_SCANS`.

    Attributes
    ----------
    fits : int
        Fits (windows, for the procedure) in `slide_s`.
    microseconds : float
        Processor time for each fit or window.
    scans_per_s : float
    """

    estimator: str
    slide_s: float
    fits: int
    microseconds: float
    scans_per_s: float


def run_cost(repeats: int) -> tuple[list[Cost], list[OnlineCost]]:
    """One fit in every window on the paper's array and in two on others, and the procedure's; online, all."""
    ours = load_array("wang2019-3x3")
    found = [_fit_cost(ours, window_s, repeats) for window_s in WINDOWS_S]
    for name in ARRAYS:
        found += [_fit_cost(load_array(name), window_s, repeats) for window_s in (2.0, 10.0)]
    case = _case(ours, 10.0)
    volts = readings(case, np.random.default_rng(1))
    spent_ms = _least_ms(lambda: faithful(case, volts, True), repeats)
    found.append(Cost("procedure", ours.name, 3, 10.0, spent_ms))
    return found, _online_costs()


def _fit_cost(array: Array, window_s: float, repeats: int) -> Cost:
    case = _case(array, window_s)
    volts = readings(case, np.random.default_rng(1))
    motion = Motion(_WAVE.speed_mm_s, 0.0, 0.0, 0.0)
    spent_ms = _least_ms(lambda: joint_fit(array, volts, RATE_HZ, case.sensed.offset_s, motion), repeats)
    return Cost("joint fit", array.name, array.n_channels, window_s, spent_ms)


def _case(array: Array, window_s: float) -> Case:
    sensed = sensed_by(array, np.random.default_rng(0), _SNR_DB, ())
    drift = np.column_stack([np.full(array.n_channels, LEVEL_VOLTS), np.zeros(array.n_channels)])
    return Case(_WAVE, sensed, drift, np.arange(round(window_s * RATE_HZ)) / RATE_HZ)


def _least_ms(work: Callable[[], object], repeats: int) -> float:
    work()  # imports, tables and caches are made
    spent_s = []
    for _ in range(repeats):
        began_s = time.process_time()
        work()
        spent_s.append(time.process_time() - began_s)
    return 1e3 * min(spent_s)


def cost_table(found: list[Cost]) -> str:
    """All sizes."""
    head = ["what", "array", "channels", "window", "ms a window"]
    rows = [[c.what, c.array, str(c.channels), f"{c.window_s:g} s", f"{c.milliseconds:.2f}"] for c in found]
    return table(head, rows)


def _online_costs() -> list[OnlineCost]:
    """Every preset, and the procedure with its windows of 10 s."""
    array = load_array("wang2019-3x3")
    case = _case(array, _SLIDE_S)
    block = regular_block(
        readings(case, np.random.default_rng(1)), RATE_HZ, channel_offset_s=case.sensed.offset_s
    )
    speed_mm_s = _WAVE.speed_mm_s
    paper = TextureParams(speed_mm_s=speed_mm_s)
    found = [_online("procedure", PaperTexture(array, paper), block, _SLIDE_S / paper.window_s)]
    for preset in PRESETS:
        params = JointParams(preset=preset, speed_mm_s=speed_mm_s)
        found.append(_online(preset, JointTexture(array, params), block, _SLIDE_S / params.hop_s))
    return found


def _online(name: str, estimator: PaperTexture | JointTexture, block: ScanBlock, fits: float) -> OnlineCost:
    slip = slip_at(0.0, 0.0)
    estimator.process(block[:1], [slip])
    began_s = time.process_time()
    for first in range(1, len(block), BLOCK_SCANS):
        estimator.process(block[first : first + BLOCK_SCANS])
    spent_s = time.process_time() - began_s
    return OnlineCost(name, _SLIDE_S, int(fits), 1e6 * spent_s / int(fits), len(block) / spent_s)


def online_table(found: list[OnlineCost]) -> str:
    """Estimators beside each other."""
    head = ["estimator", f"fits in {_SLIDE_S:g} s", "us a fit", "scans a second", "part of a core at 100 Hz"]
    rows = [
        [
            c.estimator,
            str(c.fits),
            f"{c.microseconds:.0f}",
            f"{c.scans_per_s:.0f}",
            f"{100 * RATE_HZ / c.scans_per_s:.1f} %",
        ]
        for c in found
    ]
    return table(head, rows)

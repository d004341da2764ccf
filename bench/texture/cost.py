"""Processor time of one groove fit, by array and window.

Signals are clean enough that every answer is a full one; to a pad of even pitch the grating is ambiguous, and
with the speed known it is looked at twice. Channels that are alike show what the wave costs; those whose
phases stray, as on real skins they do, what it costs to tell strays from other waves. Times are of one
thread, the least of several runs: what else the machine does can only add.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.report import Table, table
from bench.texture.signal import LEVEL_VOLTS, Grating, Wave, readings, scan_times_s, sensed_by
from bench.texture.trials import ARRAY, DIRECTION_SD_DEG, joint_fit
from tactiled.array import Array, ArrayFile, Grid, TaxelChannel, build

STRAY_RAD = 0.1  # rms, of a channel's phase from its kind's: that of skins with physics
_WAVE = Wave(1.2, 30.0, 9.0)  # 13 periods in two seconds
_SNR_DB = 20.0
_LARGE = 16  # rows and columns of a large pad
_ENOUGH_S = 0.3  # of runs: what takes so long is not moved by what else the machine does


def grating_of(array: Array, window_s: float, stray_rad: float = 0.0) -> Grating:
    """Make a window whose channels' phases stray from their kind's."""
    rng = np.random.default_rng(0)
    sensed = sensed_by(array, rng, _SNR_DB)
    phase_rad = sensed.phase_rad[sensed.kind] + stray_rad * rng.standard_normal((array.n_channels, 1))
    sensed = replace(sensed, kind=np.arange(array.n_channels), phase_rad=phase_rad)
    drift = np.column_stack([np.full(array.n_channels, LEVEL_VOLTS), np.zeros(array.n_channels)])
    return Grating(_WAVE, sensed, drift, scan_times_s(window_s))


def cost_table(repeats: int) -> Table:
    """Measure the fit on our array and on a large pad."""
    places = [4.0 * i for i in range(_LARGE)]
    channel, grid = TaxelChannel(name="N", kind="normal"), Grid(x_mm=places, y_mm=places)
    large = build(ArrayFile(name=f"pad {_LARGE}x{_LARGE}", grids=(grid,), taxel_channels=(channel,)))
    rows = []
    for array, window_s in ((ARRAY, 1.0), (ARRAY, 2.0), (ARRAY, 20.0), (large, 2.0)):
        row = {"array": array.name, "channels": f"{array.n_channels}", "window": f"{window_s:g} s"}
        for words, stray_rad in (("channels alike", 0.0), (f"straying by {STRAY_RAD:g} rad", STRAY_RAD)):
            grating = grating_of(array, window_s, stray_rad)
            volts, offset_s = readings(grating, np.random.default_rng(1)), grating.sensed.offset_s
            for speed, speed_mm_s in (("known", _WAVE.speed_mm_s), ("unknown", 0.0)):

                def fit(asked: tuple[float, ...] = (speed_mm_s, 0.0, DIRECTION_SD_DEG)) -> None:
                    joint_fit(array, volts, offset_s, *asked)  # noqa: B023  called in this turn

                row[f"{words}, speed {speed} (ms)"] = f"{_least_ms(fit, repeats):.1f}"
        rows.append(row)
    return table(rows)


def _least_ms(work: Callable[[], object], repeats: int) -> float:
    work()  # imports, tables and caches are made
    spent_s: list[float] = []
    while len(spent_s) < repeats and sum(spent_s) <= _ENOUGH_S:
        began_s = time.process_time()
        work()
        spent_s.append(time.process_time() - began_s)
    return 1e3 * min(spent_s)

"""Processor time of one groove fit, and of the whole online estimator, by size.

Signals are clean enough that every answer is a full one; to pads of even pitch the grating is ambiguous, and
with the speed known they look twice. Channels that are alike show what the wave costs; those whose phases
stray, as on real skins they do, what it costs to tell strays from other waves. Times are of one thread, the
least of several runs: what else the machine does can only add.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.report import NONE, table
from bench.texture.signal import (
    LEVEL_VOLTS,
    RATE_HZ,
    FloatArray,
    Grating,
    Wave,
    readings,
    scan_times_s,
    sensed_by,
)
from bench.texture.trials import ARRAY, DIRECTION_SD_DEG, joint_fit, joint_motion, procedure, slip_at
from tactiled.array import Array, ArrayFile, Grid, TaxelChannel, build, load_array
from tactiled.detect.grooves.estimator import PRESETS, JointParams, JointTexture
from tactiled.detect.grooves.model import WaveParams, channel_layout
from tactiled.detect.grooves.spectrum import line_spectra
from tactiled.detect.grooves.track import track_wave
from tactiled.detect.grooves.window import make_window
from tactiled.detect.wang2019.texture import PaperTexture, TextureParams
from tactiled.samples.block import ScanBlock, regular_block

STRAY_RAD = 0.1  # rms, of a channel's phase from its kind's: that of skins with physics
_WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_ARRAYS = ("normal-3x3", "normal-4x4", "xyz-two-pads-4x4")
_LARGE = 16  # rows and columns of a large pad
_SLIDE_S = 20.0
_WAVE = Wave(1.2, 30.0, 9.0)  # three periods in the shortest window
_SNR_DB = 20.0
_ENOUGH_S = 0.3  # of runs: what takes so long is not moved by what else the machine does


@dataclass(frozen=True)
class FitCost:
    """Milliseconds of processor time for one window.

    Attributes
    ----------
    milliseconds : list of float
        Channels alike: speed known, unknown; then the same where they stray.
    recursive : float
        Of that, in each: spectrum and trends, which running sums could spare; none for the procedure.
    tracked : list of float
        The same windows tracked, where the fit had an answer to track.
    """

    what: str
    array: str
    channels: int
    window_s: float
    milliseconds: list[float]
    recursive: float = 0.0
    tracked: tuple[float, ...] = ()


@dataclass(frozen=True)
class OnlineCost:
    """Processor time of a whole estimator on a slide over channels that stray.

    Attributes
    ----------
    fits : int
        Hops (windows, for the procedure) in the slide, at which waves are fitted or tracked.
    microseconds : float
        Mean of a hop or window.
    median_ms, longest_ms : float
        Of a hop, which a worker computes where there is one.
    """

    estimator: str
    fits: int
    microseconds: float
    median_ms: float
    longest_ms: float
    scans_per_s: float


def run_cost(repeats: int) -> tuple[list[FitCost], list[OnlineCost]]:
    """Measure one fit in each window on the paper's array and in two on others, and all estimators online."""
    found = [_fit_cost(ARRAY, window_s, repeats) for window_s in _WINDOWS_S]
    found += [_fit_cost(load_array(name), window_s, repeats) for name in _ARRAYS for window_s in (2.0, 10.0)]
    places = [4.0 * i for i in range(_LARGE)]
    channel, grid = TaxelChannel(name="N", kind="normal"), Grid(x_mm=places, y_mm=places)
    large = build(ArrayFile(name=f"pad {_LARGE}x{_LARGE}", grids=(grid,), taxel_channels=(channel,)))
    found.append(_fit_cost(large, 2.0, repeats))
    grating = grating_of(ARRAY, 10.0)
    volts = readings(grating, np.random.default_rng(1))
    spent_ms = _least_ms(lambda: procedure(grating, volts), repeats)
    return [*found, FitCost("procedure", ARRAY.name, 3, 10.0, [spent_ms])], _online_costs()


def grating_of(array: Array, window_s: float, stray_rad: float = 0.0) -> Grating:
    """Make a window whose channels' phases stray from their kind's."""
    rng = np.random.default_rng(0)
    sensed = sensed_by(array, rng, _SNR_DB)
    phase_rad = sensed.phase_rad[sensed.kind] + stray_rad * rng.standard_normal((array.n_channels, 1))
    sensed = replace(sensed, kind=np.arange(array.n_channels), phase_rad=phase_rad)
    drift = np.column_stack([np.full(array.n_channels, LEVEL_VOLTS), np.zeros(array.n_channels)])
    return Grating(_WAVE, sensed, drift, scan_times_s(window_s))


def _fit_cost(array: Array, window_s: float, repeats: int) -> FitCost:
    spent_ms, tracked_ms, layout = [], [], channel_layout(array)
    for stray_rad in (0.0, STRAY_RAD):
        grating = grating_of(array, window_s, stray_rad)
        volts, offset_s = readings(grating, np.random.default_rng(1)), grating.sensed.offset_s
        for speed_mm_s in (_WAVE.speed_mm_s, 0.0):
            motion = speed_mm_s, 0.0, DIRECTION_SD_DEG
            spent_ms.append(_least_ms(lambda: joint_fit(array, volts, offset_s, *motion), repeats))  # noqa: B023
            fit = joint_fit(array, volts, offset_s, *motion)
            window = volts, grating.time_s, offset_s, layout, joint_motion(*motion), WaveParams()
            if fit.wave is not None:
                tracked_ms.append(_least_ms(lambda: track_wave(fit, *window), repeats))  # noqa: B023
    recursive_ms = _least_ms(lambda: _recursive(volts, grating.time_s, offset_s), repeats)
    return FitCost(
        "joint fit", array.name, array.n_channels, window_s, spent_ms, recursive_ms, tuple(tracked_ms)
    )


def _recursive(volts: FloatArray, time_s: FloatArray, offset_s: FloatArray) -> None:
    """Do what depends on scans alone: sums over them could be moved along from hop to hop.

    All else is asked at a frequency that the window itself tells, anew each time.
    """
    window = make_window(volts, time_s, np.full(len(volts), _WAVE.speed_mm_s), offset_s)
    line_spectra(window, window.with_trend_order(WaveParams().trend_order))


def _least_ms(work: Callable[[], object], repeats: int) -> float:
    work()  # imports, tables and caches are made
    spent_s: list[float] = []
    while len(spent_s) < repeats and sum(spent_s) <= _ENOUGH_S:
        began_s = time.process_time()
        work()
        spent_s.append(time.process_time() - began_s)
    return 1e3 * min(spent_s)


def _online_costs() -> list[OnlineCost]:
    """Every preset, and the procedure with its windows of 10 s."""
    grating = grating_of(ARRAY, _SLIDE_S, STRAY_RAD)
    volts = readings(grating, np.random.default_rng(1))
    block = regular_block(volts, RATE_HZ, channel_offset_s=grating.sensed.offset_s)
    paper = TextureParams(speed_mm_s=_WAVE.speed_mm_s)
    found = [_online("procedure", PaperTexture(ARRAY, paper), block, paper.window_s)]
    for preset in PRESETS:
        params = JointParams(preset=preset, speed_mm_s=_WAVE.speed_mm_s)
        found.append(_online(preset, JointTexture(ARRAY, params), block, params.hop_s))
    return found


def _online(
    name: str, estimator: PaperTexture | JointTexture, block: ScanBlock, every_s: float
) -> OnlineCost:
    estimator.process(block[:1], [slip_at(0.0, 0.0, DIRECTION_SD_DEG)])
    hop, spent_s = round(JointParams().hop_s * RATE_HZ), []
    for first in range(1, len(block), hop):
        began_s = time.process_time()
        estimator.process(block[first : first + hop])
        spent_s.append(time.process_time() - began_s)
    total_s, fits = sum(spent_s), int(_SLIDE_S / every_s)
    median_ms, longest_ms = 1e3 * float(np.median(spent_s)), 1e3 * max(spent_s)
    return OnlineCost(name, fits, 1e6 * total_s / fits, median_ms, longest_ms, len(block) / total_s)


def cost_table(found: Sequence[FitCost]) -> str:
    """One fit at all sizes."""
    rows = []
    for c in found:
        parts = [100 * c.recursive / spent for spent in c.milliseconds]
        spent = [f"{spent:.1f}" for spent in c.milliseconds] + [NONE] * (4 - len(c.milliseconds))
        rows.append(
            {
                "what": c.what,
                "array": c.array,
                "channels": f"{c.channels}",
                "window": f"{c.window_s:g} s",
                "ms, channels alike: speed known": spent[0],
                "alike: unknown": spent[1],
                f"straying by {STRAY_RAD:g} rad: speed known": spent[2],
                "straying: unknown": spent[3],
                "of it, spectrum and trends": f"{c.recursive:.1f} ({min(parts):.0f} to {max(parts):.0f} %)",
                "tracked": f"{min(c.tracked):.1f} to {max(c.tracked):.1f}" if c.tracked else NONE,
            }
        )
    return table(rows)


def online_table(found: Sequence[OnlineCost]) -> str:
    """Online estimators beside each other."""
    return table(
        {
            "estimator": c.estimator,
            f"hops in {_SLIDE_S:g} s": f"{c.fits}",
            "us a hop": f"{c.microseconds:.0f}",
            "hop, median": f"{c.median_ms:.1f} ms",
            "longest hop": f"{c.longest_ms:.0f} ms",
            "scans a second": f"{c.scans_per_s:.0f}",
            "part of a core at 100 Hz": f"{100 * RATE_HZ / c.scans_per_s:.1f} %",
        }
        for c in found
    )

"""What texture costs: processor time of one answer, and of the whole online estimator, by size.

Signals are clean enough that every answer is a full one; to pads of even pitch the grating is ambiguous, and
with the speed known they look twice. Channels that are alike show what the wave costs; those whose phases
stray, as on real skins they do, what it costs to tell strays from other waves. Times are of one thread, the
least of several runs: what else the machine does can only add.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.texture.answers import faithful, joint_fit
from bench.texture.bound import FloatArray, Wave
from bench.texture.online import DIRECTION_SD_DEG, slip_at
from bench.texture.signal import LEVEL_VOLTS, RATE_HZ, Case, readings, sensed_by
from tactiled.array import Array, ArrayFile, Grid, TaxelChannel, build, load_array
from tactiled.detect.grooves.estimator import PRESETS, JointParams, JointTexture
from tactiled.detect.grooves.model import WaveParams
from tactiled.detect.grooves.spectrum import line_spectra
from tactiled.detect.grooves.window import make_window
from tactiled.detect.wang2019.grooves import SlidingMotion
from tactiled.detect.wang2019.texture import PaperTexture, TextureParams
from tactiled.plain_table import table
from tactiled.samples.block import ScanBlock, regular_block

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
ARRAYS = ("normal-3x3", "normal-4x4", "xyz-two-pads-4x4")
STRAY_RAD = 0.1  # rms, of a channel's phase from its kind's: that of skins with physics
_LARGE = 16  # rows and columns of a large pad
_SLIDE_S = 20.0
_WAVE = Wave(1.2, 30.0, 9.0)  # three periods in the shortest window
_SNR_DB = 20.0
_ENOUGH_S = 0.3  # of runs: what takes so long is not moved by what else the machine does


@dataclass(frozen=True)
class Cost:
    """Milliseconds of processor time for one window.

    Attributes
    ----------
    milliseconds : list of float
        Channels alike: speed known, unknown; then the same where they stray.
    recursive : float
        Of that, in each: spectrum and trends, which running sums could spare; none for the procedure.
    """

    what: str
    array: str
    channels: int
    window_s: float
    milliseconds: list[float]
    recursive: float = 0.0


@dataclass(frozen=True)
class OnlineCost:
    """A whole estimator on a slide over channels that stray, hop by hop.

    Attributes
    ----------
    fits : int
        Fits (windows, for the procedure) in `slide_s`.
    microseconds : float
        Processor time for each fit or window.
    longest_ms : float
        Of a hop: for so long the scans that come meanwhile wait.
    scans_per_s : float
    """

    estimator: str
    slide_s: float
    fits: int
    microseconds: float
    longest_ms: float
    scans_per_s: float


def run_cost(repeats: int) -> tuple[list[Cost], list[OnlineCost]]:
    """One fit in every window on the paper's array and in two on others, and the procedure's; online, all."""
    ours = load_array("wang2019-3x3")
    found = [_fit_cost(ours, window_s, repeats) for window_s in WINDOWS_S]
    for name in ARRAYS:
        found += [_fit_cost(load_array(name), window_s, repeats) for window_s in (2.0, 10.0)]
    found.append(_fit_cost(_large_pad(), 2.0, repeats))
    case = case_of(ours, 10.0)
    volts = readings(case, np.random.default_rng(1))
    spent_ms = _least_ms(lambda: faithful(case, volts, True), repeats)
    found.append(Cost("procedure", ours.name, 3, 10.0, [spent_ms]))
    return found, _online_costs()


def _fit_cost(array: Array, window_s: float, repeats: int) -> Cost:
    spent_ms = []
    for stray_rad in (0.0, STRAY_RAD):
        case = case_of(array, window_s, stray_rad)
        volts, offset_s = readings(case, np.random.default_rng(1)), case.sensed.offset_s
        for speed_mm_s in (_WAVE.speed_mm_s, 0.0):
            motion = SlidingMotion(speed_mm_s, 0.0, 0.0, DIRECTION_SD_DEG)
            spent_ms.append(_least_ms(lambda: joint_fit(array, volts, RATE_HZ, offset_s, motion), repeats))  # noqa: B023
    recursive_ms = _least_ms(lambda: _recursive(volts, case.time_s, offset_s), repeats)
    return Cost("joint fit", array.name, array.n_channels, window_s, spent_ms, recursive_ms)


def _recursive(volts: FloatArray, time_s: FloatArray, offset_s: FloatArray) -> None:
    """What depends on scans alone: sums over them could be moved along from hop to hop.

    All else is asked at a frequency that the window itself tells, anew each time.
    """
    window = make_window(volts, time_s, np.full(len(volts), _WAVE.speed_mm_s), offset_s)
    line_spectra(window, window.with_trend_order(WaveParams().trend_order))


def _large_pad() -> Array:
    places = [4.0 * i for i in range(_LARGE)]
    channel = TaxelChannel(name="N", kind="normal")
    name = f"pad {_LARGE}x{_LARGE}"
    return build(ArrayFile(name=name, grids=(Grid(x_mm=places, y_mm=places),), taxel_channels=(channel,)))


def case_of(array: Array, window_s: float, stray_rad: float = 0.0) -> Case:
    """A window over the grating; phases of channels stray from their kind's."""
    rng = np.random.default_rng(0)
    sensed = sensed_by(array, rng, _SNR_DB, ())
    phase_rad = sensed.phase_rad[sensed.kind] + stray_rad * rng.standard_normal((array.n_channels, 1))
    sensed = replace(sensed, kind=np.arange(array.n_channels), phase_rad=phase_rad)
    drift = np.column_stack([np.full(array.n_channels, LEVEL_VOLTS), np.zeros(array.n_channels)])
    return Case(_WAVE, sensed, drift, np.arange(round(window_s * RATE_HZ)) / RATE_HZ)


def _least_ms(work: Callable[[], object], repeats: int) -> float:
    work()  # imports, tables and caches are made
    spent_s = []
    for _ in range(repeats):
        began_s = time.process_time()
        work()
        spent_s.append(time.process_time() - began_s)
        if sum(spent_s) > _ENOUGH_S:
            break
    return 1e3 * min(spent_s)


def cost_table(found: Sequence[Cost]) -> str:
    """All sizes."""
    head = [
        "what", "array", "channels", "window", "ms, alike: speed known", "unknown",
        f"straying by {STRAY_RAD:g} rad: speed known", "unknown", "of it, spectrum and trends",
    ]  # fmt: skip
    rows = []
    for c in found:
        parts = [c.recursive / spent for spent in c.milliseconds]
        share = f"{c.recursive:.1f} ({100 * min(parts):.0f} to {100 * max(parts):.0f} %)"
        spent = [f"{spent:.1f}" for spent in c.milliseconds] + ["-"] * (4 - len(c.milliseconds))
        rows.append([c.what, c.array, str(c.channels), f"{c.window_s:g} s", *spent, share])
    return table(head, rows)


def _online_costs() -> list[OnlineCost]:
    """Every preset, and the procedure with its windows of 10 s."""
    array = load_array("wang2019-3x3")
    case = case_of(array, _SLIDE_S, STRAY_RAD)
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
    estimator.process(block[:1], [slip_at(0.0, 0.0, DIRECTION_SD_DEG)])
    hop = round(JointParams().hop_s * RATE_HZ)
    spent_s = []
    for first in range(1, len(block), hop):
        began_s = time.process_time()
        estimator.process(block[first : first + hop])
        spent_s.append(time.process_time() - began_s)
    total_s = sum(spent_s)
    per_fit_us, longest_ms = 1e6 * total_s / int(fits), 1e3 * max(spent_s)
    return OnlineCost(name, _SLIDE_S, int(fits), per_fit_us, longest_ms, len(block) / total_s)


def online_table(found: Sequence[OnlineCost]) -> str:
    """Estimators beside each other."""
    head = [
        "estimator", f"fits in {_SLIDE_S:g} s", "us a fit", "longest hop", "scans a second",
        "part of a core at 100 Hz",
    ]  # fmt: skip
    rows = [
        [
            c.estimator,
            str(c.fits),
            f"{c.microseconds:.0f}",
            f"{c.longest_ms:.0f} ms",
            f"{c.scans_per_s:.0f}",
            f"{100 * RATE_HZ / c.scans_per_s:.1f} %",
        ]
        for c in found
    ]
    return table(head, rows)

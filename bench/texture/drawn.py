"""Single plates drawn at random on scenes that obey physics: nobody slides over the paper's seven alone.

Each seed has a period and an angle of its own. Plates are played by the `periodic` rung, as those of table 2
are. The joint fit sees windows of each slide from 1 s after slip was detected on, told the speed and not; the
direction is that of the slip event. Online, told the speed, it answers when its preset lets it.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from bench.paper.play import NONE, Run, play
from bench.texture.answers import joint_fit
from bench.texture.bound import FloatArray, Wave
from bench.texture.grid import WRONG_TURNS, turns_off
from bench.texture.misfit import WITHIN
from bench.texture.paper import SETTLE_S, SPEED_MM_S, First, first_answer, offsets_s, true_onset
from bench.texture.signal import RATE_HZ
from tactiled.array import load_array
from tactiled.detect.wang2019.grooves import SlidingMotion
from tactiled.emulator.scene.description import Scene, paper_scenes
from tactiled.plain_table import table

PERIODS_MM = (0.8, 2.5)
ANGLES_DEG = (-60.0, 60.0)
WINDOWS_S = (10.0, 4.0)
_HOLD_S, _SLIDE_S = 5.0, 13.0  # as long as slip detection and the longest window need


@dataclass(frozen=True)
class Drawn:
    """What was said of one window of one plate; errors are zero where it was refused or wrong."""

    seed: int
    period_mm: float
    angle_deg: float
    window_s: float
    is_speed_known: bool
    status: str
    is_wrong: bool = False
    period_error_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_error_deg: float = 0.0
    angle_sd_deg: float = 0.0


def run_drawn(
    advance: Callable[[float], None], pool: Executor, *, n_plates: int
) -> tuple[list[Drawn], list[First]]:
    """Plates of seeds 0 to n_plates - 1: windows, and the first answers of the "balanced" preset."""
    found: list[Drawn] = []
    firsts: list[First] = []
    for windows, first in pool.map(drawn, range(n_plates)):
        found += windows
        firsts.append(first)
        advance(1 / n_plates)
    return found, firsts


def plate(seed: int) -> tuple[float, float]:
    """Period (mm) and angle (degrees) of a seed."""
    rng = np.random.default_rng(seed)
    period_mm = float(np.exp(rng.uniform(*np.log(PERIODS_MM))))
    return round(period_mm, 3), round(float(rng.uniform(*ANGLES_DEG)), 1)


def drawn(seed: int) -> tuple[list[Drawn], First]:
    """One slide over the plate of a seed."""
    period_mm, angle_deg = plate(seed)
    run = play(_scene(period_mm, angle_deg), seed)
    windows = [_window(run, seed, window_s, is_known) for window_s in WINDOWS_S for is_known in (True, False)]
    return windows, first_answer(run, First((period_mm, angle_deg), "balanced", seed))


def _scene(period_mm: float, angle_deg: float) -> Scene:
    scene = paper_scenes()["experiment-d1.20-a0"].with_surface(period_mm=period_mm, angle_deg=angle_deg)
    press, hold, slide = (phase.model_dump() for phase in scene.phases)
    phases = [press, hold | {"duration_s": _HOLD_S}, slide | {"duration_s": _SLIDE_S}]
    return scene.with_changes(contact="periodic", phases=phases)


def _window(run: Run, seed: int, window_s: float, is_speed_known: bool) -> Drawn:
    period_mm, angle_deg = plate(seed)
    array, onset = load_array("wang2019-3x3"), true_onset(run)
    begin = int(np.searchsorted(run.time_s, onset.detected_s + SETTLE_S))
    volts: FloatArray = run.volts[begin : begin + round(window_s * RATE_HZ)]
    speed_mm_s = SPEED_MM_S if is_speed_known else 0.0
    motion = SlidingMotion(speed_mm_s, 0.0, onset.direction_deg, onset.direction_sd_deg)
    fit = joint_fit(array, volts, RATE_HZ, offsets_s(array), motion)
    if fit.status != "ok":
        return Drawn(seed, period_mm, angle_deg, window_s, is_speed_known, fit.status)
    wave = Wave(period_mm, angle_deg, SPEED_MM_S, 0.0)
    if turns_off(array.x_mm, array.y_mm, wave, fit.period_mm, fit.angle_deg) > WRONG_TURNS:
        return Drawn(seed, period_mm, angle_deg, window_s, is_speed_known, "ok", is_wrong=True)
    return Drawn(
        seed,
        period_mm,
        angle_deg,
        window_s,
        is_speed_known,
        "ok",
        period_error_mm=fit.period_mm - period_mm,
        period_sd_mm=fit.period_sd_mm,
        angle_error_deg=(fit.angle_deg - angle_deg + 90) % 180 - 90,
        angle_sd_deg=fit.angle_sd_deg,
    )


def drawn_table(found: Sequence[Drawn], firsts: Sequence[First]) -> str:
    """A row for each length of the window, speed known and not; a last one for first answers online."""
    head = ["window", "speed", "answered", "wrong", "error: D, angle", "within 95 %: D, angle", "refused as"]
    rows = []
    for window_s in dict.fromkeys(d.window_s for d in found):
        for is_known, words in ((True, "known"), (False, "unknown")):
            mine = [d for d in found if (d.window_s, d.is_speed_known) == (window_s, is_known)]
            rows.append([f"{window_s:g} s", words, *_cells(mine)])
    after_s = [f.after_s for f in firsts if np.isfinite(f.after_s)]
    words = f"median {np.median(after_s):.1f} s, latest {max(after_s):.1f} s" if after_s else NONE
    return (
        f"{table(head, rows)}\n\nFirst answers online, balanced, speed known: {words} after the true onset "
        f"({len(after_s)} of {len(firsts)} plates)."
    )


def _cells(windows: Sequence[Drawn]) -> list[str]:
    ok = [d for d in windows if d.status == "ok"]
    right = [d for d in ok if not d.is_wrong]
    refused = Counter(d.status for d in windows if d.status != "ok")
    words = ", ".join(f"{status} {n}" for status, n in refused.most_common()) or NONE
    share = [f"{len(ok)} of {len(windows)}", str(len(ok) - len(right))]
    if not right:
        return [*share, NONE, NONE, words]
    period = np.array([(d.period_error_mm, d.period_sd_mm) for d in right])
    angle = np.array([(d.angle_error_deg, d.angle_sd_deg) for d in right])
    rms = [float(np.sqrt(np.mean(e[:, 0] ** 2))) for e in (period, angle)]
    within = [100 * float(np.mean(np.abs(e[:, 0]) <= WITHIN * e[:, 1])) for e in (period, angle)]
    return [
        *share,
        f"{1e3 * rms[0]:.3g} um, {rms[1]:.2g} deg",
        f"{within[0]:.0f} %, {within[1]:.0f} %",
        words,
    ]

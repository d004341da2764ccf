"""What becomes of answers and of their stated sigmas where the wave model does not hold."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from bench.texture.grid import WRONG_TURNS, turns_off
from bench.texture.online import answers, slip_at
from bench.texture.plates import GROOVELESS, MISFITS
from bench.texture.window import SNR_DB, Window, perfect
from tactiled.array import Array, load_array
from tactiled.detect.grooves.estimator import JointParams
from tactiled.events.types import TextureEvent
from tactiled.plain_table import table

WINDOW_S = 5.0
WITHIN = 1.96  # sigmas of a 95 % interval


@dataclass(frozen=True)
class Spoiled:
    """What a spoiled window gave; errors and sigmas are zero where it was refused."""

    name: str
    is_speed_known: bool
    seed: int
    status: str
    period_error_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_error_deg: float = 0.0
    angle_sd_deg: float = 0.0
    is_wrong: bool = False


def run_misfit(advance: Callable[[float], None], pool: Executor, *, n_windows: int) -> list[Spoiled]:
    """Every way to spoil a window, seeds 0 to n_windows - 1, speed known and not."""
    jobs = [(name, known) for name in MISFITS | GROOVELESS for known in (True, False)]
    found: list[Spoiled] = []
    for windows in pool.map(_Job(n_windows), jobs):
        found += windows
        advance(1 / len(jobs))
    return found


@dataclass(frozen=True)
class _Job:
    n_windows: int

    def __call__(self, job: tuple[str, bool]) -> list[Spoiled]:
        return [spoiled(*job, seed) for seed in range(self.n_windows)]


def spoiled(name: str, is_speed_known: bool, seed: int) -> Spoiled:
    """One window through the online estimator: what it says when the window is full."""
    array = load_array("wang2019-3x3")
    rng = np.random.default_rng(seed)
    window = perfect(array, rng, WINDOW_S)
    (MISFITS | GROOVELESS)[name](window, rng)
    event = full_window(array, window, rng, WINDOW_S, is_speed_known)
    if event.status != "ok":
        return Spoiled(name, is_speed_known, seed, event.status)
    wave = window.wave
    off = turns_off(array.x_mm, array.y_mm, wave, event.period_mm, event.angle_deg)
    return Spoiled(
        name,
        is_speed_known,
        seed,
        "ok",
        event.period_mm - wave.period_mm,
        event.period_sd_mm,
        (event.angle_deg - wave.angle_deg + 90) % 180 - 90,
        event.angle_sd_deg,
        name in GROOVELESS or off > WRONG_TURNS,
    )


def full_window(
    array: Array, window: Window, rng: np.random.Generator, window_s: float, is_speed_known: bool
) -> TextureEvent:
    """What the online estimator says of a window when it is full."""
    # The direction is configured: that of a slip is less sure, and would leave a known speed nothing to tie.
    direction_deg = window.wave.direction_deg
    params = JointParams(max_window_s=window_s, hop_s=window_s, settle_s=0.0, direction_deg=direction_deg)
    said = answers(
        array,
        params,
        window.volts(rng),
        window.sensed.offset_s,
        slip_at(0.0, direction_deg),
        valid=window.valid,
        given_mm_s=window.given_mm_s if is_speed_known else (),
    )
    return list(said)[-1]


def misfit_table(found: Sequence[Spoiled]) -> str:
    """A row for each way to spoil a window."""
    head = [
        "what is wrong", "speed known: answered", "wrong", "error: D, angle", "within 95 %: D, angle",
        "unknown: answered", "wrong", "error: D, angle", "within 95 %: D, angle", "refused as",
    ]  # fmt: skip
    rows = []
    for name in dict.fromkeys(s.name for s in found):
        cells = [name]
        for is_known in (True, False):
            cells += _cells([s for s in found if (s.name, s.is_speed_known) == (name, is_known)])
        refused = Counter(s.status for s in found if s.name == name and s.status != "ok")
        rows.append([*cells, ", ".join(f"{status} {n}" for status, n in refused.most_common()) or "-"])
    return (
        f"Windows of {WINDOW_S:g} s at {SNR_DB:g} dB, one thing wrong in each. Errors: root mean square of "
        "answers that are not wrong by a lobe. The last rows have no grating: any answer is wrong.\n\n"
        + table(head, rows)
    )


def _cells(windows: Sequence[Spoiled]) -> list[str]:
    ok = [s for s in windows if s.status == "ok"]
    right = [s for s in ok if not s.is_wrong]
    share = f"{len(ok)} of {len(windows)}"
    if not right:
        return [share, str(len(ok)), "-", "-"]
    period = np.array([(s.period_error_mm, s.period_sd_mm) for s in right])
    angle = np.array([(s.angle_error_deg, s.angle_sd_deg) for s in right])
    rms = [float(np.sqrt(np.mean(e[:, 0] ** 2))) for e in (period, angle)]
    within = [100 * float(np.mean(np.abs(e[:, 0]) <= WITHIN * e[:, 1])) for e in (period, angle)]
    return [
        share,
        str(len(ok) - len(right)),
        f"{1e3 * rms[0]:.3g} um, {rms[1]:.2g} deg",
        f"{within[0]:.0f} %, {within[1]:.0f} %",
    ]

"""Error over bound, over windows and noise; what an estimator refuses, and how often it is wrong.

A trial is one window of `texture_signal`. Errors count over the bound of the trial's own grating. An answer
is wrong, as against inexact, when somewhere on the array its groove phase is more than a quarter turn off: it
then sits on another lobe of the likelihood, which is what an unresolved integer ambiguity looks like.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass

import numpy as np

from bench.texture.answers import Answer, Estimate, faithful, joint
from bench.texture.bound import FloatArray, Wave, bound
from bench.texture.signal import Case, draw_case, readings
from tactiled.array import load_array

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
ESTIMATORS: dict[str, Estimate] = {"joint": joint, "procedure": faithful}
MIN_PERIODS = 3.0  # the aim is stated from here on
_FREE_EVERY = 5  # one trial in five may have fewer
WRONG_TURNS = 0.25
_WITHIN = 1.96  # sigmas of a 95 % interval


@dataclass(frozen=True)
class Trial:
    """What one window gave; errors are signed, in units of the bound and of the stated sigma."""

    window_s: float
    snr_db: float
    is_speed_known: bool
    seed: int
    periods: float
    period_mm: float
    angle_deg: float
    status: str
    angle_over_bound: float = 0.0
    period_over_bound: float = 0.0
    angle_over_sd: float = 0.0
    period_over_sd: float = 0.0
    angle_error_deg: float = 0.0
    period_error_mm: float = 0.0
    is_wrong: bool = False

    @property
    def is_ok(self) -> bool:
        return self.status == "ok"


@dataclass(frozen=True)
class Summary:
    """Many trials in a row of a table; roots of mean squares over answers that are not wrong."""

    trials: int
    ok: int
    wrong: int
    angle: float
    period: float
    angle_within: float
    period_within: float

    def cell(self) -> str:
        """``angle / period (ok)``."""
        if self.ok == self.wrong:
            return f"all {self.ok} wrong" if self.ok else "-"
        return f"{self.angle:.2f} / {self.period:.2f} ({100 * self.ok / self.trials:.0f} %)"


def summary(trials: Sequence[Trial]) -> Summary:
    """Of any selection."""
    ok = [t for t in trials if t.is_ok]
    right = [t for t in ok if not t.is_wrong]

    def rms(values: Iterable[float]) -> float:
        squares = [value**2 for value in values]
        return float(np.sqrt(np.mean(squares))) if squares else float("nan")

    def within(values: Iterable[float]) -> float:
        inside = [abs(value) <= _WITHIN for value in values]
        return float(np.mean(inside)) if inside else float("nan")

    return Summary(
        trials=len(trials),
        ok=len(ok),
        wrong=len(ok) - len(right),
        angle=rms(t.angle_over_bound for t in right),
        period=rms(t.period_over_bound for t in right),
        angle_within=within(t.angle_over_sd for t in ok),
        period_within=within(t.period_over_sd for t in ok),
    )


def trial(estimator: str, window_s: float, snr_db: float, is_speed_known: bool, seed: int) -> Trial:
    """One window of a cell; the same arguments the same trial."""
    rng = np.random.default_rng([seed, round(10 * window_s), round(snr_db) + 100, is_speed_known])
    least = 0.0 if seed % _FREE_EVERY == _FREE_EVERY - 1 else MIN_PERIODS
    case = draw_case(load_array("wang2019-3x3"), rng, window_s, snr_db, least)
    answer = ESTIMATORS[estimator](case, readings(case, rng), is_speed_known)
    return scored(case, answer, window_s, snr_db, is_speed_known, seed)


def scored(
    case: Case, answer: Answer, window_s: float, snr_db: float, is_speed_known: bool, seed: int
) -> Trial:
    """An answer beside the truth and the bound."""
    wave = case.wave
    known = Trial(
        window_s,
        snr_db,
        is_speed_known,
        seed,
        case.periods,
        wave.period_mm,
        wave.angle_deg,
        answer.status,
    )
    if answer.status != "ok":
        return known
    least = bound(wave, case.sensed, case.time_s, is_speed_known=is_speed_known)
    angle_deg = (answer.angle_deg - wave.angle_deg + 90) % 180 - 90  # a groove normal has no sense
    period_mm = answer.period_mm - wave.period_mm
    off = turns_off(case.sensed.x_mm, case.sensed.y_mm, wave, answer.period_mm, answer.angle_deg)
    return Trial(
        **asdict(known)
        | {
            "angle_over_bound": angle_deg / least.angle_sd_deg,
            "period_over_bound": period_mm / least.period_sd_mm,
            "angle_over_sd": angle_deg / answer.angle_sd_deg,
            "period_over_sd": period_mm / answer.period_sd_mm,
            "angle_error_deg": angle_deg,
            "period_error_mm": period_mm,
            "is_wrong": off > WRONG_TURNS,
        }
    )


def turns_off(x_mm: FloatArray, y_mm: FloatArray, wave: Wave, period_mm: float, angle_deg: float) -> float:
    """Largest error of an answer's groove phase over places on the array, in turns, their middle in phase."""
    true, said = _per_mm(wave.period_mm, wave.angle_deg), _per_mm(period_mm, angle_deg)
    said = said if said @ true >= 0 else -said
    places = np.column_stack([x_mm - x_mm.mean(), y_mm - y_mm.mean()])
    return float(np.abs(places @ (said - true)).max())


def _per_mm(period_mm: float, angle_deg: float) -> FloatArray:
    angle = np.radians(angle_deg)
    return np.array([np.cos(angle), np.sin(angle)]) / period_mm


def run_grid(
    advance: Callable[[float], None],
    pool: Executor,
    estimator: str,
    *,
    n_trials: int,
    windows_s: Sequence[float] = WINDOWS_S,
    snrs_db: Sequence[float] = SNRS_DB,
    knowing: Sequence[bool] = (True, False),
) -> list[Trial]:
    """All trials of all cells, seeds 0 to n_trials - 1 in each; `advance` is told what part is done more."""
    cells = list(itertools.product(windows_s, snrs_db, knowing))
    trials: list[Trial] = []
    for found in pool.map(_Cell(estimator, n_trials), cells):
        trials += found
        advance(1 / len(cells))
    return trials


@dataclass(frozen=True)
class _Cell:
    """All trials of a cell, in whichever process."""

    estimator: str
    n_trials: int

    def __call__(self, cell: tuple[float, float, bool]) -> list[Trial]:
        return [trial(self.estimator, *cell, seed) for seed in range(self.n_trials)]

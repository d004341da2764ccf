"""How often an "ok" is wrong: thousands of short windows in coloured noise.

Short windows of a few periods are where phases are told apart worst, and cheap. Noise that remembers (an
autoregression of order 1 in each channel) has its power where ripples are slow, and lends false lines.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bench.texture.answers import joint
from bench.texture.grid import MIN_PERIODS, Trial, scored, summary
from bench.texture.signal import draw_case, readings
from bench.texture.tables import most_wrong
from tactiled.array import load_array
from tactiled.plain_table import table

MEMORIES = (0.9, 0.97)  # of noise from scan to scan: 0.1 s and 0.33 s at 100 Hz
WINDOWS_S = (1.0, 2.0)
SNRS_DB = (10.0, 15.0, 20.0)
_SLOW_HZ = 5.0  # ripples are slower: there such noise has most of its power (80 % and 94 %)
FIRST_SEED = 5001  # seeds of reports; nothing is tuned on them
_A_JOB = 50  # windows at a time, so that both workers end together


@dataclass(frozen=True)
class Counted:
    """A trial in noise that remembers; its errors over the bound of white noise mean nothing."""

    memory: float
    trial: Trial


def run_count(advance: Callable[[float], None], pool: Executor, *, n_windows: int) -> list[Counted]:
    """So many windows for each memory, half of them with the speed known."""
    jobs = [(m, first) for m in MEMORIES for first in range(FIRST_SEED, FIRST_SEED + n_windows, _A_JOB)]
    found: list[Counted] = []
    for windows in pool.map(_job, jobs):
        found += windows
        advance(1 / len(jobs))
    return found


def _job(job: tuple[float, int]) -> list[Counted]:
    memory, first = job
    return [counted(memory, seed) for seed in range(first, first + _A_JOB)]


def counted(memory: float, seed: int) -> Counted:
    """One window; odd seeds are told the speed."""
    rng = np.random.default_rng([seed, round(100 * memory)])
    window_s, snr_db, is_known = float(rng.choice(WINDOWS_S)), float(rng.choice(SNRS_DB)), seed % 2 == 1
    case = draw_case(load_array("wang2019-3x3"), rng, window_s, snr_db, MIN_PERIODS, _SLOW_HZ)
    answer = joint(case, readings(case, rng, memory), is_known)
    trial = scored(case, answer, window_s, snr_db, is_known, seed)
    return Counted(memory, replace(trial, angle_over_bound=0.0, period_over_bound=0.0))


def count_table(white: Sequence[Trial], coloured: Sequence[Counted]) -> str:
    """Wrong answers among those that said ok, by noise; white is the grid of the bound."""
    head = [
        "noise", "speed", "windows", "ok", "wrong", "in 1000, at most (95 %)", "within 95 %: angle", "period",
        "refused as",
    ]  # fmt: skip
    groups = [("white, all windows", list(white))]
    for memory in dict.fromkeys(c.memory for c in coloured):
        trials = [c.trial for c in coloured if c.memory == memory]
        groups.append((f"AR(1), {memory:g}: {_span(WINDOWS_S)} s, {_span(SNRS_DB)} dB", trials))
    rows = []
    for name, trials in groups:
        for is_known, words in ((True, "known"), (False, "unknown")):
            rows.append(_row(name, words, [t for t in trials if t.is_speed_known == is_known]))
        rows.append(_row(name, "both", trials))
    return table(head, rows)


def _span(values: Sequence[float]) -> str:
    return f"{values[0]:g} to {values[-1]:g}"


def _row(name: str, speed: str, trials: Sequence[Trial]) -> list[str]:
    found = summary(trials)
    refused = Counter(t.status for t in trials if not t.is_ok)
    return [
        name,
        speed,
        str(found.trials),
        f"{found.ok} ({100 * found.ok / max(found.trials, 1):.0f} %)",
        str(found.wrong),
        f"{1e3 * most_wrong(found):.2f}",
        f"{100 * found.angle_within:.1f} %",
        f"{100 * found.period_within:.1f} %",
        ", ".join(f"{status} {n}" for status, n in refused.most_common()) or "-",
    ]

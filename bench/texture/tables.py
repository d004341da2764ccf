"""Tables and aims of ``./run bench texture`` from its trials.

A measure beyond its limit by less than two of its own standard errors is "open", as is a rate that too few
answers cannot show to be small enough: a quick run leaves most so.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bench.report import CONFIDENCE, NONE, Aim, Table, aim, grouped, largest_rate, never, rms, table
from bench.texture.trials import MIN_PERIODS, QUANTITIES, Quantity, Trial

SPEEDS = {True: "speed known", False: "speed unknown"}
_WITHIN = 1.96  # sigmas of a 95 % interval


class TrialSet:
    """Trials of one row of a table: all, those that were answered (`ok`), and the right ones of these."""

    def __init__(self, trials: Iterable[Trial]) -> None:
        self.all = list(trials)
        self.ok = [t for t in self.all if t.status == "ok"]
        self.right = [t for t in self.ok if not t.is_wrong]

    @property
    def n_wrong(self) -> int:
        """Number of wrong answers."""
        return len(self.ok) - len(self.right)

    @property
    def most_wrong(self) -> float:
        """Largest rate of wrong answers that is not excluded."""
        return largest_rate(self.n_wrong, len(self.ok))

    @property
    def bounded(self) -> list[Trial]:
        """Answers that are not wrong and have a bound."""
        return [t for t in self.right if np.isfinite(t.angle.bound)]

    def over_bound(self, quantity: Quantity) -> float:
        """Root mean square of errors over their bounds, of answers that are not wrong."""
        return rms([t.of(quantity).error / t.of(quantity).bound for t in self.bounded])

    def within(self, quantity: Quantity) -> float:
        """Part of 95 % intervals that hold the truth; NaN where there are none."""
        inside = [abs(t.of(quantity).error) <= _WITHIN * t.of(quantity).sd for t in self.ok]
        return float(np.mean(inside)) if inside else float("nan")


def over_bound_table(trials: Sequence[Trial], is_speed_known: bool) -> Table:
    """Windows down, noise across: error over bound of the angle / of the period (answered)."""
    cells = grouped(trials, lambda t: (t.window_s, t.snr_db))

    def cell(window_s: float, snr_db: float) -> str:
        mine = cells.get((window_s, snr_db), [])
        found = TrialSet(t for t in mine if t.is_speed_known == is_speed_known and t.periods >= MIN_PERIODS)
        if not found.right:
            return f"all {len(found.ok)} wrong" if found.ok else NONE
        part = f"{100 * len(found.ok) / len(found.all):.0f} %"
        return f"{found.over_bound('angle'):.2f} / {found.over_bound('period'):.2f} ({part})"

    snrs_db = sorted({t.snr_db for t in trials})
    return table(
        {"window": f"{window_s:g} s"} | {f"{snr_db:g} dB": cell(window_s, snr_db) for snr_db in snrs_db}
        for window_s in sorted({t.window_s for t in trials})
    )


Found = Mapping[str, Sequence[Trial]]  # by the parts of the bench
_OVER_BOUND = 1.1
_HELD = (0.93, 0.97)  # of 95 % intervals, on white noise
_WRONG = 1e-3  # of answers
_SURE = 2.0  # standard errors


def aims(found: Found) -> list[Aim]:
    """Judge the trials of all parts."""
    whole = [t for t in found["grid"] if t.periods >= MIN_PERIODS]
    over, held = [], []
    for quantity in QUANTITIES:
        for is_known, speed in SPEEDS.items():
            some = [t for t in whole if t.is_speed_known == is_known]
            over.append(_near_the_bound(f"{quantity}: error over its bound, {speed}", quantity, some))
            own = TrialSet(t for t in found["grid"] if t.is_speed_known == is_known)
            held.append(_held(f"{quantity}: truth within 95 % intervals, {speed}", quantity, own))
    return [
        *over,
        *held,
        _rarely_wrong("wrong answers, white noise", TrialSet(found["grid"])),
        never("surfaces without grooves: answered", [t.is_wrong for t in found["grooveless"]]),
    ]


def _near_the_bound(name: str, quantity: Quantity, some: Sequence[Trial]) -> Aim:
    """Take all noises of a window together, and all windows of a noise: a cell cannot tell 1.1 from 1."""
    parts = {f"{s:g} s": TrialSet(of) for s, of in grouped(some, lambda t: t.window_s).items()}
    parts |= {f"{db:g} dB": TrialSet(of) for db, of in grouped(some, lambda t: t.snr_db).items()}
    parts = {part: trials for part, trials in parts.items() if trials.right}
    worst = max(parts, key=lambda part: parts[part].over_bound(quantity), default="")
    limit, trials = f"at most {_OVER_BOUND:g}", parts.get(worst, TrialSet(()))
    if not trials.bounded:
        return aim(name, limit, "nothing answered", False, is_open=True)
    error = trials.over_bound(quantity)
    words = f"{error:.2f} ({worst}; all {TrialSet(some).over_bound(quantity):.2f})"
    least = error * (1 - _SURE / np.sqrt(2 * len(trials.bounded)))
    return aim(name, limit, words, error <= _OVER_BOUND, is_open=bool(least <= _OVER_BOUND))


def _held(name: str, quantity: Quantity, trials: TrialSet) -> Aim:
    # The sigma of intervals that hold what they should: those measured are too few to say how far they stray.
    if not trials.ok:
        return aim(name, "93 to 97 %", "nothing answered", False, is_open=True)
    part, sd = trials.within(quantity), np.sqrt(_HELD[0] * (1 - _HELD[0]) / len(trials.ok))
    off = max(_HELD[0] - part, part - _HELD[1])
    return aim(name, "93 to 97 %", f"{100 * part:.1f} %", off <= 0, is_open=bool(off <= _SURE * sd))


def _rarely_wrong(name: str, trials: TrialSet) -> Aim:
    """Judge a rate by its upper 95 % confidence bound, which must be within the limit."""
    words = f"{trials.n_wrong} of {len(trials.ok)} ({100 * CONFIDENCE:.0f} %: below "
    words += f"{1e3 * trials.most_wrong:.2f} in 1000)"
    is_open = trials.n_wrong <= _WRONG * len(trials.ok)
    return aim(name, f"at most {1e3 * _WRONG:g} in 1000", words, trials.most_wrong <= _WRONG, is_open=is_open)

"""Tables of ``./run bench texture`` from its trials."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import special

from bench.report import NONE, Table, counts_in_words, grouped, rms, table
from bench.texture.plates import PUBLISHED
from bench.texture.trials import MIN_PERIODS, QUANTITIES, Quantity, Trial

SPEEDS = {True: "speed known", False: "speed unknown"}
CONFIDENCE = 0.95  # of the largest rate that is not excluded
_WITHIN = 1.96  # sigmas of a 95 % interval


class TrialSet:
    """Trials of one row of a table.

    Attributes
    ----------
    all, ok, right : list of Trial
        All of them, those that were answered, and those among these that are not wrong.
    """

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
        """Largest rate of wrong answers that is not excluded (one-sided, Clopper and Pearson 1934)."""
        return float(special.betaincinv(self.n_wrong + 1, len(self.right), CONFIDENCE)) if self.right else 1.0

    @property
    def bounded(self) -> list[Trial]:
        """Answers that are not wrong and have a bound."""
        return [t for t in self.right if np.isfinite(t.angle.bound)]

    def over_bound(self, quantity: Quantity) -> float:
        """Root mean square of errors over their bounds, of answers that are not wrong."""
        return rms([t.of(quantity).error / t.of(quantity).bound for t in self.bounded])

    def error(self, quantity: Quantity) -> float:
        """Root mean square error of the answers that are not wrong."""
        return rms([t.of(quantity).error for t in self.right])

    def within(self, quantity: Quantity) -> float:
        """Part of 95 % intervals that hold the truth; NaN where there are none."""
        inside = [abs(t.of(quantity).error) <= _WITHIN * t.of(quantity).sd for t in self.ok]
        return float(np.mean(inside)) if inside else float("nan")

    @property
    def errors(self) -> str:
        """Root mean square errors in words."""
        return f"{1e3 * self.error('period'):.3g} um, {self.error('angle'):.2g} deg" if self.right else NONE


def windows_of(trials: Iterable[Trial]) -> list[Trial]:
    """Trials that are not first answers."""
    return [t for t in trials if np.isnan(t.after_s)]


def first_answers(trials: Iterable[Trial]) -> list[Trial]:
    """Trials that are first answers of the online estimator."""
    return [t for t in trials if not np.isnan(t.after_s)]


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


def answers_table(what: str, groups: Mapping[str, Iterable[Trial]]) -> Table:
    """Answers of each group of windows: how many, how good, and why not."""

    def row(name: str, found: TrialSet) -> dict[str, str]:
        held = [f"{100 * found.within(quantity):.1f}" for quantity in QUANTITIES]
        over = [f"{found.over_bound(quantity):.2f}" for quantity in QUANTITIES]
        return {
            what: name,
            "answered": f"{len(found.ok)} of {len(found.all)}",
            "wrong": f"{found.n_wrong}",
            "in 1000, at most (95 %)": f"{1e3 * found.most_wrong:.2f}" if found.ok else NONE,
            "error: D, angle": found.errors,
            "over the bound: D, angle": ", ".join(over) if found.bounded else NONE,
            "within 95 % (%): D, angle": ", ".join(held) if found.ok else NONE,
            "refused as": counts_in_words(t.status for t in found.all if t.status != "ok"),
        }

    return table(row(name, TrialSet(trials)) for name, trials in groups.items())


def named(
    trials: Iterable[Trial], *, with_window: bool = False, with_speed: bool = True
) -> dict[str, list[Trial]]:
    """Trials by name, and by length of the window and whether the speed was known."""

    def name(t: Trial) -> str:
        window, speed = f", {t.window_s:g} s" * with_window, f", {SPEEDS[t.is_speed_known]}" * with_speed
        return t.name + window + speed

    return grouped(trials, name)


def plate_groups(trials: Iterable[Trial]) -> dict[str, list[Trial]]:
    """Windows over the plates of the paper, by plate and method, with what the paper has for each."""

    def name(t: Trial) -> str:
        period_mm, angle_deg = PUBLISHED[t.period.true, t.angle.true]
        paper = f" (paper: {period_mm} mm, {angle_deg} deg)" if t.name == "procedure" else ""
        return f"{t.period.true:.2f} mm, {t.angle.true:g} deg: {t.name}{paper}"

    return grouped(windows_of(trials), name)


def after_table(what: str, groups: Mapping[str, Sequence[Trial]]) -> Table:
    """Time until a first answer, or until the answer to old grooves no longer stands."""
    rows = []
    for name, trials in groups.items():
        after_s, found = [t.after_s for t in trials], TrialSet(trials)
        times = [f"{np.quantile(after_s, part, method='higher'):.1f} s" for part in (0.5, 0.9, 1.0)]
        rows.append(
            {
                what: name,
                "slides": f"{len(trials)}",
                "after (median, 90 %, latest)": ", ".join(times),
                "wrong": f"{found.n_wrong}",
                "error: D, angle": found.errors,
            }
        )
    return table(rows)

"""Tables of ``./run bench texture`` from its trials."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np
from scipy import special

from bench.report import NONE, counts_in_words, grouped, rms, spread, table
from bench.texture.plates import PUBLISHED, Plate
from bench.texture.trials import (
    COLOURED_SNRS_DB,
    COLOURED_WINDOWS_S,
    MIN_PERIODS,
    QUANTITIES,
    Quantity,
    Trial,
)

SPEEDS = {True: "speed known", False: "speed unknown"}
CONFIDENCE = 0.95  # of the largest rate that is not excluded
_WITHIN = 1.96  # sigmas of a 95 % interval
_ANSWERED = 0.9  # of windows, from which on a noise is said to be answered
_BANDS: tuple[tuple[str, Callable[[Trial], float], tuple[float, ...]], ...] = (
    ("period (mm)", lambda t: t.period.true, (0.6, 0.9, 1.5, 3.0, 6.0)),
    ("angle (deg)", lambda t: abs(t.angle.true), (0.0, 15.0, 45.0, 60.0, 75.0)),
    ("periods in the window", lambda t: t.periods, (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 1000.0)),
)


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
    def answered(self) -> str:
        """``3 of 4``."""
        return f"{len(self.ok)} of {len(self.all)}"

    @property
    def answered_percent(self) -> str:
        """``3 (75 %)``."""
        return f"{len(self.ok)} ({100 * len(self.ok) / max(len(self.all), 1):.0f} %)"

    @property
    def refused(self) -> str:
        """Refusals by their reason."""
        return counts_in_words(t.status for t in self.all if t.status != "ok")

    def over_bound(self, quantity: Quantity) -> float:
        """Root mean square of errors over their bounds, of answers that are not wrong."""
        return rms([t.of(quantity).error / t.of(quantity).bound for t in self.right])

    def error(self, quantity: Quantity) -> float:
        """Root mean square error of the answers."""
        return rms([t.of(quantity).error for t in self.ok])

    def errors(self, um: str, deg: str) -> str:
        """Root mean square errors of the answers in words, in these formats."""
        if not self.ok:
            return NONE
        return f"{1e3 * self.error('period'):{um}} um, {self.error('angle'):{deg}} deg"


def within(trials: Sequence[Trial], quantity: Quantity) -> float:
    """Part of 95 % intervals that hold the truth; NaN where there are none."""
    inside = [abs(t.of(quantity).error) <= _WITHIN * t.of(quantity).sd for t in trials]
    return float(np.mean(inside)) if inside else float("nan")


def windows_of(trials: Iterable[Trial]) -> list[Trial]:
    """Trials that are not first answers."""
    return [t for t in trials if np.isnan(t.after_s)]


def first_answers(trials: Iterable[Trial]) -> list[Trial]:
    """Trials that are first answers of the online estimator."""
    return [t for t in trials if not np.isnan(t.after_s)]


def over_bound_table(trials: Sequence[Trial], is_speed_known: bool) -> str:
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


def band_table(trials: Sequence[Trial]) -> str:
    """Table of the trials by properties of the grating, with the coverage of the stated sigmas."""
    rows = {}
    for name, value, edges in _BANDS:
        for low, high in pairwise(edges):
            rows[f"{name} {low:g} to {high:g}"] = [t for t in trials if low <= value(t) < high]
    for is_known, words in SPEEDS.items():
        rows[words] = [t for t in trials if t.is_speed_known == is_known]
    rows["all"] = list(trials)

    def row(name: str, found: TrialSet) -> dict[str, str]:
        def cell(words: str) -> str:
            return words if found.ok else NONE

        return {
            "trials": name,
            "windows": f"{len(found.all)}",
            "answered": found.answered_percent if found.ok else "0",
            "error / bound: angle": cell(f"{found.over_bound('angle'):.2f}"),
            "error / bound: period": cell(f"{found.over_bound('period'):.2f}"),
            "angle within 95 %": cell(f"{100 * within(found.ok, 'angle'):.1f} %"),
            "period within 95 %": cell(f"{100 * within(found.ok, 'period'):.1f} %"),
            "wrong": f"{found.n_wrong}",
        }

    return table(row(name, TrialSet(mine)) for name, mine in rows.items())


def noise_table(white: Sequence[Trial], coloured: Sequence[Trial]) -> str:
    """Wrong answers among all answers, by noise; white is the grid of the bound."""
    span = " to ".join(f"{s:g}" for s in COLOURED_WINDOWS_S) + " s, "
    span += f"{COLOURED_SNRS_DB[0]:g} to {COLOURED_SNRS_DB[-1]:g} dB"
    groups = {"white, all windows": list(white)}
    groups |= {f"{name}: {span}": mine for name, mine in grouped(coloured, lambda t: t.name).items()}
    rows = []
    for name, trials in groups.items():
        for speed, knowing in (("known", {True}), ("unknown", {False}), ("both", {True, False})):
            found = TrialSet(t for t in trials if t.is_speed_known in knowing)
            rows.append(
                {
                    "noise": name,
                    "speed": speed,
                    "windows": f"{len(found.all)}",
                    "answered": found.answered_percent,
                    "wrong": f"{found.n_wrong}",
                    "in 1000, at most (95 %)": f"{1e3 * found.most_wrong:.2f}",
                    "angle within 95 %": f"{100 * within(found.ok, 'angle'):.1f} %",
                    "period within 95 %": f"{100 * within(found.ok, 'period'):.1f} %",
                    "refused as": found.refused,
                }
            )
    return table(rows)


def track_table(trials: Sequence[Trial]) -> str:
    """Answers of whole slides, at every hop, by noise and by how the channels' phases stray."""
    rows = []
    for name, mine in grouped(trials, lambda t: t.name).items():
        found = TrialSet(mine)
        answered = {t.seed for t in found.ok}
        wrong = {t.seed for t in found.ok if t.is_wrong}
        compared = TrialSet(t for t in mine if np.isfinite(t.angle.bound))
        errors = [f"{compared.over_bound(quantity):.2f}" for quantity in reversed(QUANTITIES)]
        rows.append(
            {
                "noise": name,
                "slides with answers": f"{len(answered)} of {len({t.seed for t in found.all})}",
                "answers": f"{len(found.ok)}",
                "wrong": f"{found.n_wrong} (in {len(wrong)} slides)" if wrong else "0",
                "in 1000, at most (95 %)": f"{1e3 * found.most_wrong:.2f}",
                "angle within 95 %": f"{100 * within(found.ok, 'angle'):.1f} %" if found.ok else NONE,
                "period within 95 %": f"{100 * within(found.ok, 'period'):.1f} %" if found.ok else NONE,
                "over the bound: angle, period": ", ".join(errors) if compared.right else NONE,
                "refused as": found.refused,
            }
        )
    return table(rows)


def stray_table(trials: Sequence[Trial]) -> str:
    """Answers by strays of the channels."""
    rows = []
    for name, mine in grouped(trials, lambda t: t.name).items():
        found = TrialSet(mine)
        row = {"strays": name}
        for is_known, speed in SPEEDS.items():
            part = TrialSet(t for t in mine if t.is_speed_known == is_known)
            row[f"{speed}: answered"] = part.answered_percent
        row |= {"answers": f"{len(found.ok)}", "wrong": f"{found.n_wrong}"}
        row |= {
            f"{quantity} within 95 %": f"{100 * within(found.ok, quantity):.1f} %" if found.ok else NONE
            for quantity in reversed(QUANTITIES)
        }
        rows.append(row | {"refused as": found.refused})
    return table(rows)


def change_table(trials: Sequence[Trial]) -> str:
    """Time until the answer to the old grooves is no longer given."""
    rows = []
    for name, mine in grouped(trials, lambda t: t.name).items():
        found, after_s = TrialSet(mine), sorted(t.after_s for t in mine)
        rows.append(
            {
                "change": name,
                "slides": f"{len(mine)}",
                "noticed after (median, 90 %, latest)": ", ".join(
                    f"{after_s[min(int(part * len(after_s)), len(after_s) - 1)]:.1f} s"
                    for part in (0.5, 0.9, 1)
                ),
                "last answer right": f"{len(found.right)}",
                "wrong": f"{found.n_wrong}",
            }
        )
    return table(rows)


def threshold_table(trials: Sequence[Trial]) -> str:
    """Largest noise up to which 9 of 10 windows of `MIN_PERIODS` or more are answered, by window."""
    long = grouped(
        (t for t in trials if t.periods >= MIN_PERIODS), lambda t: (t.window_s, t.is_speed_known, t.snr_db)
    )
    snrs_db = sorted({t.snr_db for t in trials}, reverse=True)

    def cell(window_s: float, is_known: bool) -> str:
        least = "none"
        for snr_db in snrs_db:
            here = long.get((window_s, is_known, snr_db), [])
            if not here or np.mean([t.status == "ok" for t in here]) < _ANSWERED:
                break
            least = f"{snr_db:g} dB"
        return least

    return table(
        {"window": f"{window_s:g} s"}
        | {f"{words}: answered from": cell(window_s, is_known) for is_known, words in SPEEDS.items()}
        for window_s in sorted({t.window_s for t in trials})
    )


def _plate_of(trial: Trial) -> Plate:
    return trial.period.true, trial.angle.true


def _in_words(plate: Plate) -> str:
    return f"{plate[0]:.2f} mm, {plate[1]} deg"


def by_plate(trials: Iterable[Trial]) -> dict[Plate, dict[str, TrialSet]]:
    """Trials by plate and method."""
    return {
        plate: {name: TrialSet(some) for name, some in grouped(mine, lambda t: t.name).items()}
        for plate, mine in grouped(trials, _plate_of).items()
    }


def published_table(trials: Sequence[Trial]) -> str:
    """Table 2 of the paper: period and angle, mean and standard deviation over windows (answered of all)."""

    def cell(found: TrialSet) -> str:
        share = f"({len(found.ok)}/{len(found.all)})"
        if not found.ok:
            return f"{NONE} {share}"
        period_mm, angle_deg = ([t.of(q).true + t.of(q).error for t in found.ok] for q in QUANTITIES)
        return f"{spread(period_mm, 4)} mm, {spread(angle_deg, 3)} deg {share}"

    return table(
        {"D, angle": _in_words(plate)}
        | {f"paper, {kind}": " mm, ".join(PUBLISHED[plate][kind][1:]) + " deg" for kind in PUBLISHED[plate]}
        | {method: cell(found) for method, found in methods.items()}
        for plate, methods in by_plate(windows_of(trials)).items()
    )


def plate_error_table(trials: Sequence[Trial]) -> str:
    """Errors (rms) of the methods, and by how much the joint fit's are smaller than the procedure's."""

    def smaller(base: TrialSet, found: TrialSet) -> str:
        if not base.ok or not found.ok:
            return NONE
        times = [base.error(quantity) / found.error(quantity) for quantity in QUANTITIES]
        return f"{times[0]:.0f}, {times[1]:.0f} times"

    rows = []
    for plate, methods in by_plate(windows_of(trials)).items():
        base, *others = methods.values()
        rows.append(
            {"D, angle": _in_words(plate)}
            | {f"{method}: D, angle": found.errors(".2f", ".3f") for method, found in methods.items()}
            | {
                f"smaller at {found.all[0].name.removeprefix('joint, ')}": smaller(base, found)
                for found in others
            }
        )
    return table(rows)


def first_table(trials: Sequence[Trial]) -> str:
    """Times of the first answers, median and latest, and their errors (rms)."""

    def cell(found: TrialSet) -> str:
        after_s = [t.after_s for t in found.ok]
        share = f"({len(found.ok)}/{len(found.all)})"
        if not after_s:
            return f"{NONE} {share}"
        return f"{np.median(after_s):.1f} s, {max(after_s):.1f} s: {found.errors('.2f', '.3f')} {share}"

    return table(
        {"D, angle": _in_words(plate)}
        | {f"{preset}: D, angle": cell(found) for preset, found in mine.items()}
        for plate, mine in by_plate(first_answers(trials)).items()
    )


def _counts(found: TrialSet, before: str = "") -> dict[str, str]:
    return {f"{before}answered": found.answered, f"{before}wrong": f"{found.n_wrong}"}


def _errors(found: TrialSet, before: str = "") -> dict[str, str]:
    """Errors, and intervals that hold, of the answers that are not wrong."""
    held = [f"{100 * within(found.right, quantity):.0f} %" for quantity in QUANTITIES]
    return {
        f"{before}error: D, angle": TrialSet(found.right).errors(".3g", ".2g"),
        f"{before}within 95 %: D, angle": ", ".join(held) if found.right else NONE,
    }


def drawn_table(trials: Sequence[Trial]) -> str:
    """A row for each length of the window, speed known and not; then the first answers online."""
    rows = []
    for (window_s, is_known), mine in grouped(
        windows_of(trials), lambda t: (t.window_s, t.is_speed_known)
    ).items():
        found = TrialSet(mine)
        start = {"window": f"{window_s:g} s", "speed": "known" if is_known else "unknown"}
        rows.append(start | _counts(found) | _errors(found) | {"refused as": found.refused})
    firsts = first_answers(trials)
    after_s = [t.after_s for t in firsts if np.isfinite(t.after_s)]
    words = f"median {np.median(after_s):.1f} s, latest {max(after_s):.1f} s" if after_s else NONE
    return (
        f"{table(rows)}\n\nFirst answers online, balanced, speed known: {words} after the true onset "
        f"({len(after_s)} of {len(firsts)} plates)."
    )


def misfit_table(trials: Sequence[Trial]) -> str:
    """A row for each way to spoil a window."""
    rows = []
    for name, mine in grouped(trials, lambda t: t.name).items():
        row = {"what is wrong": name}
        for is_known, words in SPEEDS.items():
            found = TrialSet(t for t in mine if t.is_speed_known == is_known)
            row |= _counts(found, f"{words}: ") | _errors(found, f"{words}: ")
        rows.append(row | {"refused as": TrialSet(mine).refused})
    return table(rows)


def two_wave_table(trials: Sequence[Trial], short_s: float) -> str:
    """A row for each pair of waves, windows of `short_s` named so."""
    rows = []
    for (name, window_s), mine in grouped(trials, lambda t: (t.name, t.window_s)).items():
        row = {"what is in view": name if window_s != short_s else f"{name}, in {window_s:g} s"}
        for is_known, words in SPEEDS.items():
            found = TrialSet(t for t in mine if t.is_speed_known == is_known)
            _, held = _errors(found).values()
            row |= _counts(found, f"{words}: ")
            row |= {f"{words}: within 95 %: D, angle": held}
        rows.append(row | {"refused as": TrialSet(mine).refused})
    return table(rows)


def standing_answers(trials: Sequence[Trial]) -> dict[str, dict[float, TrialSet]]:
    """Answers of slides by preset, and by the time at which they stand."""
    return {
        preset: {time_s: TrialSet(some) for time_s, some in grouped(mine, lambda t: t.window_s).items()}
        for preset, mine in grouped(windows_of(trials), lambda t: t.name).items()
    }


def curve_table(trials: Sequence[Trial]) -> str:
    """Errors of the answer that stands at each time, and of the first one."""
    curve = standing_answers(trials)

    def cell(found: TrialSet) -> str:
        part = f"{100 * len(found.ok) / len(found.all):.0f} %"
        return f"{found.errors('.2f', '.4f')} ({part})" if found.ok else NONE

    rows = []
    for time_s, last in list(curve.values())[-1].items():
        least = [rms([t.of(quantity).bound for t in last.all]) for quantity in QUANTITIES]
        rows.append(
            {"time since onset": f"{time_s:g} s"}
            | {f"{preset}: D, angle (answered)": cell(times[time_s]) for preset, times in curve.items()}
            | {"bound: D, angle": f"{1e3 * least[0]:.2f} um, {least[1]:.4f} deg"}
        )
    firsts = []
    for preset, mine in grouped(first_answers(trials), lambda t: t.name).items():
        found = TrialSet(mine)
        after_s = [t.after_s for t in found.ok]
        first = {"preset": preset}
        for name, part in (("first answer, median", 50), ("90 %", 90), ("latest", 100)):
            first[name] = f"{np.percentile(after_s, part):.1f} s" if after_s else NONE
        firsts.append(
            first | {"error then: D, angle": found.errors(".2f", ".3f"), "answered": found.answered}
        )
    return f"{table(rows)}\n\n{table(firsts)}"

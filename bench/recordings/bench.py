"""``./run bench recordings --data DIR``: public recordings of other groups, beside simple rules and trees."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from bench.recordings import ours
from bench.recordings.catalogue import Question, Source, how_to_get, sources
from bench.recordings.log import Log
from bench.recordings.rules import (
    LOG_RULES,
    RIDGES,
    agreement,
    by_best_of_others,
    by_threshold,
    by_trees,
    contact_by_norm,
    pose_errors_of_trees,
    strongest_line_hz,
)
from bench.recordings.sources import READERS
from bench.report import NONE, Aim, BenchOptions, aim, aims_table, table
from tactiled.array import FloatArray
from tactiled.errors import DataError
from tactiled.progress import ProgressBar

_RIGHT = 0.05  # of the period
_MOST_LOGS = 5  # that are shown one by one


@dataclass(frozen=True)
class Periods:
    """Answers on slides: right and wrong, of those over a grating and of those without."""

    right: int
    wrong: int
    of: int
    has_grating: bool

    @classmethod
    def count(cls, logs: Sequence[Log], answers: Sequence[float]) -> "Periods":
        """Compare answers (mm, 0 for none) with the periods; over no grating each answer is wrong."""
        right = [
            log.period_mm > 0 and abs(mm / log.period_mm - 1) < _RIGHT
            for log, mm in zip(logs, answers, strict=True)
        ]
        answered = sum(mm > 0 for mm in answers)
        has_grating = any(log.period_mm > 0 for log in logs)
        return cls(sum(right), answered - sum(right), len(logs), has_grating)

    def __str__(self) -> str:
        if not self.has_grating:
            return f"{self.wrong} of {self.of} with a period"
        return f"{self.right} of {self.of} right, {self.wrong} wrong"


@dataclass(frozen=True)
class Decisions:
    """Logs of which it was said that something happens, of those where it does and where it does not."""

    found: int
    of: int
    false: int
    of_rests: int

    @classmethod
    def count(cls, logs: Sequence[Log], said: Sequence[bool]) -> "Decisions":
        """Compare with the labels."""
        label, yes = np.array([log.label for log in logs]), np.array(said)
        return cls(int((yes & label).sum()), int(label.sum()), int((yes & ~label).sum()), int((~label).sum()))

    def __str__(self) -> str:
        return f"{self.found} of {self.of}, {self.false} of {self.of_rests} false"


@dataclass(frozen=True)
class Contacts:
    """Agreement of contact with the force, of each log; 0.5 is chance."""

    agreement: Sequence[float]

    def __str__(self) -> str:
        return _each_log([f"{one:.2f}" for one in self.agreement], self.agreement)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of forces over their ranges, by axis, of each log."""

    of_logs: Sequence[FloatArray]  # each (axes,)
    # each (axes,): parts of the 90 % intervals that hold the force; empty where there are no intervals
    inside: Sequence[FloatArray] = ()
    n_refused: int = 0

    def __str__(self) -> str:
        words = [[f"{100 * x:.2f} %" for x in one] for one in self.of_logs]
        for of_log, inside in zip(words, self.inside, strict=False):
            of_log[:] = [f"{x} ({100 * part:.0f} %)" for x, part in zip(of_log, inside, strict=True)]
        said = _each_log([", ".join(one) for one in words], [float(one.mean()) for one in self.of_logs])
        return said + (f", {self.n_refused} refused" if self.n_refused else "")


class Found(NamedTuple):
    """Answers of the daemon, of the rule and of trees to one question on the logs of one source.

    Each is one of `Periods`, `Decisions`, `Contacts` and `Errors`, the last also without trees.
    """

    source: Source
    question: Question
    n_logs: int
    ours: Any
    rule: Any
    trees: Any = NONE


def bench_recordings(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Score every source whose checkout is in the folder of the data; say how to get the others."""
    data = options.data or Path()
    here = [source for source in sources() if options.data is not None and source.is_in(data)]
    if not here:
        where = f"no source is in {data}" if options.data else "give a folder by --data"
        raise click.UsageError(f"{where}. To fill it:\n  " + "\n  ".join(how_to_get(sources())))
    progress.begin(len(here))
    found: list[Found] = []
    for source in here:
        found += _measure(source, data)
        progress.advance(source.name)
    missing = how_to_get(source for source in sources() if source not in here)
    measured = [one for one in found if one.question in _MEASURED]
    sections = [
        "Public recordings of other groups. The column asked says what each method must find in the logs "
        "of a source: the period of a grating, or, for each log, whether there is a slip (of any kind, or a "
        "gross one), a touch or the loss of an object. 'p of sliding' asks for gross slips by the largest "
        "`p_sliding` of a log: it must exceed a threshold, which is learnt from the other objects, as that "
        "of the rule is. Rules and trees are scored on each object after they have learnt from the other "
        "objects of the source.",
        table(_row(one) for one in found if one not in measured),
        "Logs with measured forces. Force: rms error of each axis, in percent of the range of this axis in "
        "the log, on contacts from which the calibration did not learn. In parentheses: how many of the "
        "90 % intervals contain the true force. Commas separate axes, semicolons separate logs. For more "
        "than five logs: the median, then the smallest and the largest. Refused: `tactiled calibrate` made "
        "no calibration from the log. Ridge with squares is a ridge regression on the readings and their "
        "squares. Contact: mean of two proportions: of the scans with more than 5 % of the range of force, "
        "those in which contact is reported, and of the scans with less than 0.5 %, those in which none is "
        "reported. Chance gives 0.5.",
        table(_row(one) for one in measured),
        "Aims of these results.",
        aims_table(_aims(found)),
        "Constants that were chosen on a source: "
        + ("; ".join(f"{source.name}: {source.chosen}" for source in here if source.chosen) or "none")
        + ".",
    ]
    if missing:
        sections.append("Not there:\n\n    " + "\n    ".join(missing))
    return sections


def _measure(source: Source, data: Path) -> Iterator[Found]:
    logs = list(READERS[source.name](data / source.folder))
    check_range(source, logs)
    for question, rule in source.asked.items():
        yield Found(source, question, len(logs), *_answers(question, rule, source, logs))


def check_range(source: Source, logs: Sequence[Log]) -> None:
    """Raise DataError where the catalogue's range of the sensor is less than that of its readings.

    What is beyond it counts as saturated, which makes every answer worse and no row says so.
    """
    low = min(float(np.nanmin(log.readings)) for log in logs)
    high = max(float(np.nanmax(log.readings)) for log in logs)
    if low < source.array.low or high > source.array.high:
        raise DataError(f"{source.name}: readings are {low:g} to {high:g}, beyond `range` in catalogue.toml")


def _answers(question: Question, rule: str, source: Source, logs: Sequence[Log]) -> tuple[Any, ...]:
    """Return the answers of the daemon, of the rule and, where there are some, of trees."""
    array = source.array
    if question in ("force", "poses"):
        are_poses = question == "poses"
        studies = [ours.forces(log, array, RIDGES[rule], are_poses=are_poses) for log in logs]
        errors = [one for one in studies if one is not None]
        mine = Errors([e.ours for e in errors], [e.inside for e in errors], len(logs) - len(errors))
        both = (mine, Errors([e.ridge for e in errors]))
        return (*both, Errors([pose_errors_of_trees(log) for log in logs])) if are_poses else both
    if question == "contact":
        said_right = [agreement(ours.contact(log, array), log) for log in logs]
        return Contacts(said_right), Contacts(contact_by_norm(logs))
    if question == "period":
        answers = [(ours.periods_mm(log, array) or [0.0])[-1] for log in logs]
        lines = [log.speed_mm_s / hz if (hz := strongest_line_hz(log)) else 0.0 for log in logs]
        return Periods.count(logs, answers), Periods.count(logs, lines)
    if question == "slip" and source.growths:
        said = by_best_of_others(logs, ours.slips_by_growth(logs, array, source.growths))
    elif question == "p of sliding":  # with a threshold that is found as that of the rule is
        said = by_threshold(logs, lambda log: ours.largest_p_sliding(log, array))
    else:
        says = {
            "slip": ours.slips,
            "gross slip": ours.slips_grossly,
            "touch": ours.touches,
            "loss": ours.loses,
        }[question]
        said = [says(log, array) for log in logs]
    all_said = (said, by_threshold(logs, LOG_RULES[rule]), by_trees(logs))
    return tuple(Decisions.count(logs, one) for one in all_said)


def _row(one: Found) -> dict[str, str]:
    return {
        "source": one.source.name,
        "sensor": one.source.sensor,
        "asked": one.question,
        "logs": f"{one.n_logs}",
        "tactiled": str(one.ours),
        "simple rule": f"{one.source.asked[one.question]}: {one.rule}",
        "trees": str(one.trees),
    }


def _each_log(words: Sequence[str], values: Sequence[float]) -> str:
    """Return what is said of each log; of more than five, of the (lower) median, the least and the most."""
    if len(words) <= _MOST_LOGS:
        return "; ".join(words)
    order = np.argsort(values)
    middle, least, most = (words[order[k]] for k in ((len(words) - 1) // 2, 0, -1))
    return f"{middle}, from {least} to {most}"


def _aims(found: Sequence[Found]) -> Iterator[Aim]:
    by_name = {(one.source.name, one.question): one for one in found}
    for name, limit, source, question, is_met in _AIMS:
        one = by_name.get((source, question))
        if one is None:
            yield aim(name, limit, "not there", False, is_open=True)
        else:
            yield aim(name, limit, _row(one)["tactiled"], is_met(one))


def _periods(most_wrong: int, least_right: int) -> Callable[[Found], bool]:
    return lambda one: one.ours.right >= least_right and one.ours.wrong <= most_wrong


def _slips(least: int, most_false: int) -> Callable[[Found], bool]:
    return lambda one: one.ours.found >= least and one.ours.false <= most_false


def _beats_rule(one: Found) -> bool:
    return bool(one.ours.found > one.rule.found and one.ours.false < one.rule.false)


def _agrees(one: Found) -> bool:
    return bool(min(one.ours.agreement) >= _LEAST_AGREEMENT)


def _below_ridge(one: Found) -> bool:
    if one.ours.n_refused:
        return False
    pairs = zip(one.ours.of_logs, one.rule.of_logs, strict=True)
    holds = all((np.abs(inside - 0.9) <= 0.05).all() for inside in one.ours.inside)
    return holds and all((ours < ridge).all() for ours, ridge in pairs)


def _at_most_trees(one: Found) -> bool:
    if one.ours.n_refused:
        return False
    pairs = zip(one.ours.of_logs, one.trees.of_logs, strict=True)
    return all(bool((ours <= trees).all()) for ours, trees in pairs)


_MEASURED: tuple[Question, ...] = ("force", "poses", "contact")
_LEAST_AGREEMENT = 0.95
_OF_40, _AS_RIDGE, _AS_RULE = (
    "at most 3 of 40 with a period, the machine's included",
    "below ridge, intervals 85 to 95 %",
    "more slips found and fewer false reports than the rule",
)
_AIMS: tuple[tuple[str, str, str, Question, Callable[[Found], bool]], ...] = (
    ("gratings", "24 of 24, 0 wrong", "FabricSlide", "period", _periods(0, 24)),
    ("materials, of which two are woven", _OF_40, "BioTac_slide_20_50", "period", _periods(3, 0)),
    ("slips of an electrode finger", "235 of 262, 4 of 44 false", "BioTacSP-DoS", "slip", _slips(235, 4)),
    ("tugs of a magnetic skin", "95 of 103, 2 false", "eFlesh tugs", "slip", _slips(95, 2)),
    ("slips of a hand of pads", _AS_RULE, "SDH-2", "slip", _beats_rule),
    ("presses", _AS_RIDGE, "eFlesh presses", "force", _below_ridge),
    ("contact of presses", "0.95 in each run", "eFlesh presses", "contact", _agrees),
    ("shears", _AS_RIDGE, "eFlesh shears", "force", _below_ridge),
    ("contact of shears", "0.95 in each run", "eFlesh shears", "contact", _agrees),
    ("poses of a magnetic chip", "at or below trees on each axis", "Tactaxis", "poses", _at_most_trees),
)
"""Name, limit, source, question, and whether what was found meets it."""

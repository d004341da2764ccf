"""``./run bench recordings --data DIR``: public recordings of other groups, beside simple rules and trees."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from bench.recordings import ours
from bench.recordings.catalogue import Question, Source, how_to_get, sources
from bench.recordings.log import Log
from bench.recordings.ours import ForceErrors
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
from bench.report import NONE, Aim, BenchOptions, Reading, aims_table, judge, table
from tactiled.array import FloatArray
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
    """Agreement of contact with the force, of each log; 0.5 is chance.

    Attributes
    ----------
    agreement, with_light : sequence of float
        Scans with a light force left out, and counted as free.
    """

    agreement: Sequence[float]
    with_light: Sequence[float] = ()

    def __str__(self) -> str:
        said = _each_log([f"{one:.2f}" for one in self.agreement], self.agreement)
        if not self.with_light:
            return said
        return f"{said} ({_each_log([f'{one:.2f}' for one in self.with_light], self.with_light)})"


@dataclass(frozen=True, eq=False)
class Found:
    """Answers of the daemon, of the rule and of trees to one question on the logs of one source."""

    source: Source
    question: Question
    n_logs: int
    ours: Periods | Decisions | Contacts | Sequence[ForceErrors]
    rule: Periods | Decisions | Contacts | None = None
    trees: Decisions | Sequence[FloatArray] | None = None
    n_refused: int = 0


def bench_recordings(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Score every source whose checkout is in the folder of the data; say how to get the others."""
    if options.data is None or not options.data.is_dir():
        raise click.UsageError(
            "give a folder by --data. To fill it:\n  " + "\n  ".join(how_to_get(sources()))
        )
    here = [source for source in sources() if source.is_in(options.data)]
    if not here:
        raise click.UsageError(
            f"no source is in {options.data}. To fill it:\n  " + "\n  ".join(how_to_get(sources()))
        )
    progress.begin(len(here))
    found: list[Found] = []
    for source in here:
        found += _measure(source, options.data)
        progress.advance(source.name)
    missing = how_to_get(source for source in sources() if source not in here)
    sections = [
        "Public recordings of other groups. Rules and trees learn from the other objects of a source. Force: "
        "rms error over the range of each axis, in folds that leave out contacts, and the part of the 90 % "
        "intervals that hold it. Contact: mean of the parts of scans that are said right with a force beyond "
        "5 % of its range, and below 0.5 % (in brackets: below 5 %); 0.5 is chance. Of more than five logs, "
        "the median is there, and the range.",
        table(_row(one) for one in found),
        aims_table(AIMS, {"measured": {(one.source.name, one.question): one for one in found}}),
        "Constants that were chosen on a source: "
        + ("; ".join(f"{source.name}: {source.chosen}" for source in here if source.chosen) or "none")
        + ".",
    ]
    if missing:
        sections.append("Not there:\n\n    " + "\n    ".join(missing))
    return sections


def _measure(source: Source, data: Path) -> Iterator[Found]:
    logs = list(READERS[source.name](data / source.folder))
    for question, rule in source.asked.items():
        yield _ask(question, rule, source, logs)


def _ask(question: Question, rule: str, source: Source, logs: Sequence[Log]) -> Found:
    array = source.array
    if question in ("force", "poses"):
        are_poses = question == "poses"
        studies = [ours.forces(log, array, RIDGES[rule], are_poses=are_poses) for log in logs]
        errors = [one for one in studies if one is not None]
        trees = [pose_errors_of_trees(log) for log in logs] if are_poses else None
        return Found(source, question, len(logs), errors, None, trees, len(logs) - len(errors))
    if question == "contact":
        touching = [ours.contact(log, array) for log in logs]
        found = Contacts(
            [agreement(one, log) for one, log in zip(touching, logs, strict=True)],
            [agreement(one, log, light_is_free=True) for one, log in zip(touching, logs, strict=True)],
        )
        by_rule = Contacts(contact_by_norm(logs), contact_by_norm(logs, light_is_free=True))
        return Found(source, question, len(logs), found, by_rule)
    if question == "period":
        answers = [(ours.periods_mm(log, array) or [0.0])[-1] for log in logs]
        lines = [log.speed_mm_s / hz if (hz := strongest_line_hz(log)) else 0.0 for log in logs]
        return Found(source, question, len(logs), Periods.count(logs, answers), Periods.count(logs, lines))
    if question == "slip" and source.growths:
        said = by_best_of_others(logs, ours.slips_by_growth(logs, array, source.growths))
    else:
        says = {"slip": ours.slips, "touch": ours.touches, "loss": ours.loses}[question]
        said = [says(log, array) for log in logs]
    decisions = Decisions.count(logs, said)
    of_rule = Decisions.count(logs, by_threshold(logs, LOG_RULES[rule]))
    return Found(source, question, len(logs), decisions, of_rule, Decisions.count(logs, by_trees(logs)))


def _row(one: Found) -> dict[str, str]:
    source, rule = one.source, one.source.asked[one.question]
    row = {"source": source.name, "sensor": source.sensor, "asked": one.question, "logs": f"{one.n_logs}"}
    if isinstance(one.ours, Periods | Decisions | Contacts):
        return row | {
            "tactiled": str(one.ours),
            "simple rule": f"{rule}: {one.rule}",
            "trees": NONE if one.trees is None else str(one.trees),
        }
    mine = _each_log(
        [
            ", ".join(
                f"{100 * x:.2f} % ({100 * inside:.0f} %)" for x, inside in zip(e.ours, e.inside, strict=True)
            )
            for e in one.ours
        ],
        [float(e.ours.mean()) for e in one.ours],
    )
    trees = NONE if one.trees is None or isinstance(one.trees, Decisions) else _percent(one.trees)
    return row | {
        "tactiled": mine + (f", {one.n_refused} refused" if one.n_refused else ""),
        "simple rule": f"{rule}: {_percent([e.ridge for e in one.ours])}",
        "trees": trees,
    }


def _percent(errors: Sequence[FloatArray]) -> str:
    return _each_log(
        [", ".join(f"{100 * x:.2f} %" for x in one) for one in errors], [float(one.mean()) for one in errors]
    )


def _each_log(words: Sequence[str], values: Sequence[float]) -> str:
    """Return what is said of each log; of more than five, of the middle one, the least and the most."""
    if len(words) <= _MOST_LOGS:
        return "; ".join(words)
    order = np.argsort(values)
    middle, least, most = (words[order[k]] for k in (len(words) // 2, 0, -1))
    return f"{middle}, from {least} to {most}"


def _aim(
    name: str, limit: str, source: str, question: Question, is_met: Callable[[Found], bool]
) -> Aim[dict[tuple[str, Question], Found]]:
    def measure(found: dict[tuple[str, Question], Found]) -> Reading:
        one = found.get((source, question))
        return Reading("not there", "open") if one is None else judge(_row(one)["tactiled"], is_met(one))

    return Aim(name, limit, measure)


def _periods(most_wrong: int, least_right: int) -> Callable[[Found], bool]:
    def is_met(one: Found) -> bool:
        assert isinstance(one.ours, Periods)
        return one.ours.right >= least_right and one.ours.wrong <= most_wrong

    return is_met


def _slips(least: int, most_false: int) -> Callable[[Found], bool]:
    def is_met(one: Found) -> bool:
        assert isinstance(one.ours, Decisions)
        return one.ours.found >= least and one.ours.false <= most_false

    return is_met


def _beats_rule(one: Found) -> bool:
    assert isinstance(one.ours, Decisions)
    assert isinstance(one.rule, Decisions)
    return one.ours.found > one.rule.found and one.ours.false < one.rule.false


def _agrees(one: Found) -> bool:
    assert isinstance(one.ours, Contacts)
    return min(one.ours.agreement) >= _LEAST_AGREEMENT


def _below_ridge(one: Found) -> bool:
    assert not isinstance(one.ours, Periods | Decisions | Contacts)
    return all((e.ours < e.ridge).all() and (np.abs(e.inside - 0.9) <= 0.05).all() for e in one.ours)


def _at_most_trees(one: Found) -> bool:
    assert not isinstance(one.ours, Periods | Decisions | Contacts)
    assert isinstance(one.trees, list)
    return all(bool((e.ours <= trees).all()) for e, trees in zip(one.ours, one.trees, strict=True))


_LEAST_AGREEMENT = 0.95
AIMS = (
    _aim("gratings", "24 of 24, 0 wrong", "FabricSlide", "period", _periods(0, 24)),
    _aim(
        "materials, of which two are woven",
        "at most 3 of 40 with a period, the machine's included",
        "BioTac_slide_20_50",
        "period",
        _periods(3, 0),
    ),
    _aim("slips of an electrode finger", "235 of 262, 4 of 44 false", "BioTacSP-DoS", "slip", _slips(235, 4)),
    _aim("tugs of a magnetic skin", "95 of 103, 2 false", "eFlesh tugs", "slip", _slips(95, 2)),
    _aim("slips of a hand of pads", "better than the rule in both", "SDH-2", "slip", _beats_rule),
    _aim("presses", "below ridge, intervals 85 to 95 %", "eFlesh presses", "force", _below_ridge),
    _aim("contact of presses", "0.95 in each run", "eFlesh presses", "contact", _agrees),
    _aim("shears", "below ridge, intervals 85 to 95 %", "eFlesh shears", "force", _below_ridge),
    _aim("contact of shears", "0.95 in each run", "eFlesh shears", "contact", _agrees),
    _aim("poses of a magnetic chip", "at or below trees on each axis", "Tactaxis", "poses", _at_most_trees),
)

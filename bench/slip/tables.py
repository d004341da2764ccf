"""Tables of ``./run bench slip``."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from bench.report import NONE, grouped, ratio, table
from bench.slip.announced import as_announced
from bench.slip.faults import FaultEvents
from bench.slip.replay import (
    GROSS_PS,
    INCIPIENT_PS,
    N_BINS,
    NAMES,
    CaseEvents,
    Reliability,
    gross_curve_at,
    incipient_curve_at,
)
from bench.slip.resting import LOADS
from bench.slip.scenes import ALL_QUIET, ALL_SLIPPING
from bench.slip.score import (
    AHEAD_S,
    LEADS_TO_S,
    Reported,
    announced_soon,
    directions,
    ended_while_it_slides,
    falling,
    false_onsets_per_hour,
    gross_reported,
    latency_s,
    onsets_that_lead,
    reported_early,
    rests_called_gross,
    slow_reported_ahead,
    usual,
)
from tactiled.detect.contact.slip_detector import SETTINGS
from tactiled.detect.contact.slips_by_threshold import SlipThresholds
from tactiled.emulator.scene.families import HELD_OUT_QUIET, HELD_OUT_SLIPPING

DEFAULT = "balanced"
_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip

Question = Callable[[Sequence[Reported]], str]


def by_name(events: Sequence[CaseEvents], name: str) -> list[Reported]:
    """Events of a setting or of another detector."""
    return [Reported(one.case, one.by_name[name]) for one in events]


def by_threshold(events: Sequence[CaseEvents], at: SlipThresholds) -> list[Reported]:
    """Events of the contact model at some thresholds."""
    return [Reported(one.case, one.by_threshold[at]) for one in events]


def _direction(kind: str, reported: Sequence[Reported]) -> str:
    found = directions(usual(reported), kind)
    if not len(found.error_deg):
        return NONE
    median = f"{np.median(np.abs(found.error_deg)):.1f} deg"
    return f"{median}, {ratio(found.inside)} inside, {found.n_reversed} reversed"


def _early(reported: Sequence[Reported]) -> str:
    return f"{len(reported_early(usual(reported)))} of {sum(one.case.slips for one in usual(reported))}"


def _early_at(reported: Sequence[Reported]) -> str:
    used = reported_early(usual(reported))
    return f"{np.median(used):.2f}" if used else NONE


def _latency(reported: Sequence[Reported]) -> str:
    found = latency_s(reported)
    if not len(found):
        return NONE
    median = float(np.median(found))
    return f"{1e3 * median:.0f} ms" if np.isfinite(median) else "missed"


QUESTIONS: Mapping[str, Question] = {
    f"slow slips reported {1e3 * AHEAD_S:.0f} ms ahead": lambda found: ratio(
        slow_reported_ahead(usual(found))
    ),
    "onsets an hour where nothing slips": lambda found: f"{false_onsets_per_hour(found):.0f}",
    f"onsets that gross slip follows in {LEADS_TO_S:g} s": lambda found: ratio(
        onsets_that_lead(usual(found))
    ),
    "gross reported in 100 ms": lambda found: ratio(gross_reported(usual(found), 0.1)),
    "gross reported in 300 ms": lambda found: ratio(gross_reported(usual(found), 0.3)),
    f"gross reported more than {1e3 * AHEAD_S:.0f} ms early": _early,
    "utilisation at these, median": _early_at,
    "gross reported in 300 ms where friction falls": lambda found: ratio(gross_reported(falling(found), 0.3)),
    "rests called gross": lambda found: ratio(rests_called_gross(found)),
    f"rests below {_CLEAR:.0%} of the limit called gross": lambda found: ratio(
        rests_called_gross(found, _CLEAR)
    ),
    "ended while it slides": lambda found: ratio(ended_while_it_slides(found)),
    "direction at onset": partial(_direction, "incipient"),
    "direction at gross slip": partial(_direction, "gross"),
    "first event since shear begins, median": _latency,
}


_NOT_IN_SUMMARY = (
    "direction at onset",
    "direction at gross slip",
    "gross reported in 300 ms where friction falls",
)


def summary_table(groups: Mapping[str, Sequence[CaseEvents]]) -> str:
    """Answers to most questions for each setting, the groups one after the other in a cell."""
    return table(
        {"question": question}
        | {
            _head(name): "; ".join(answer(by_name(events, name)) for events in groups.values())
            for name in NAMES
        }
        for question, answer in QUESTIONS.items()
        if question not in _NOT_IN_SUMMARY
    )


def settings_table(events: Sequence[CaseEvents]) -> str:
    """Answers to all questions, a column for each setting."""
    columns = {_head(name): by_name(events, name) for name in NAMES}
    return table(
        {"question": question} | {head: answer(found) for head, found in columns.items()}
        for question, answer in QUESTIONS.items()
    )


def _head(name: str) -> str:
    at = SETTINGS.get(name)
    return name if at is None else f"{name}, p {at.incipient:g} / {at.gross:g}"


def _by_noise(events: Sequence[CaseEvents], answer: Callable[[list[Reported]], list[bool]], name: str) -> str:
    """``5 / 4 / 3 of 5``, by noise."""
    found = [answer(by_name(some, name)) for some in grouped(events, lambda e: e.case.group).values()]
    counts = " / ".join(f"{sum(cases)}" for cases in found)
    return f"{counts} of {max(map(len, found))}" if any(found) else NONE


def slips_table(events: Sequence[CaseEvents]) -> str:
    """Answers of the default setting, by family with slip and noise."""
    families = grouped([one for one in events if one.case.name in ALL_SLIPPING], lambda one: one.case.name)
    columns: Mapping[str, Callable[[list[Reported]], list[bool]]] = {
        "announced": announced_soon,
        "gross in 100 ms": partial(gross_reported, within_s=0.1),
        "gross in 300 ms": partial(gross_reported, within_s=0.3),
        "ended while it slides": ended_while_it_slides,
    }
    return table(
        {"family": f"{name}, held out" if name in HELD_OUT_SLIPPING else name}
        | {head: _by_noise(some, answer, DEFAULT) for head, answer in columns.items()}
        | {"first event since shear begins": _latency(by_name(some, DEFAULT))}
        for name, some in families.items()
    )


def quiet_table(events: Sequence[CaseEvents]) -> str:
    """Onsets an hour where nothing slips, by family, without and with announcements."""
    quiet = [one for one in events if one.case.name in ALL_QUIET]

    def cell(some: Sequence[CaseEvents], name: str) -> str:
        found = by_name(some, name)
        announced = [
            Reported(case, [e for e in marked if e.valid])
            for case, reported in found
            for marked in [as_announced(case.array, case.block, reported, case.announcements)]
        ]
        return f"{false_onsets_per_hour(found):.0f} / {false_onsets_per_hour(announced):.0f}"

    rows = grouped(quiet, lambda one: one.case.name) | {"all": quiet}

    def hours(some: Sequence[CaseEvents]) -> float:
        return sum(float(one.case.nothing.sum()) / one.case.block.rate_hz for one in some) / 3600

    return table(
        {
            "family": f"{family}, held out" if family in HELD_OUT_QUIET else family,
            "hours": f"{hours(some):.2f}",
        }
        | {name: cell(some, name) for name in NAMES}
        for family, some in rows.items()
    )


def resting_table(events: Sequence[CaseEvents]) -> str:
    """Resting and swinging loads that are reported as gross slip, by noise."""
    return table(
        {"load": load}
        | {
            name: _by_noise([one for one in events if one.case.name == load], rests_called_gross, name)
            for name in NAMES
        }
        for load in LOADS
    )


def fault_table(faults: Sequence[FaultEvents]) -> str:
    """Valid onsets in holds, by fault."""

    def cell(some: Iterable[FaultEvents], name: str) -> str:
        onsets = [e for one in some for e in one.by_name[name] if e.state == "onset" and e.valid]
        gross = sum(e.kind == "gross" for e in onsets)
        return f"{len(onsets)}" + (f", {gross} gross" if gross else "")

    return table(
        {"fault": fault, "minutes": f"{sum(one.duration_s for one in some) / 60:.1f}"}
        | {name: cell(some, name) for name in NAMES}
        for fault, some in grouped(faults, lambda one: one.fault).items()
    )


def curves_table(events: Sequence[CaseEvents]) -> str:
    """False onsets and reported slips over each probability of the contact model."""
    return table(_curve_rows(events))


def _curve_rows(events: Sequence[CaseEvents]) -> Iterator[dict[str, str]]:
    for p in INCIPIENT_PS:
        yield _curve_row(f"incipient at p {p:g}", by_threshold(events, incipient_curve_at(p)))
    for p in GROSS_PS:
        yield _curve_row(f"gross at p {p:g}", by_threshold(events, gross_curve_at(p)))


def _curve_row(name: str, found: Sequence[Reported]) -> dict[str, str]:
    return {
        "reported": name,
        "onsets an hour where nothing slips": f"{false_onsets_per_hour(found):.0f}",
        "slow slips reported ahead": ratio(slow_reported_ahead(usual(found))),
        "onsets that gross slip follows": ratio(onsets_that_lead(usual(found))),
        "gross in 100 ms": ratio(gross_reported(usual(found), 0.1)),
        "reported early": f"{len(reported_early(usual(found)))}",
        "rests called gross": ratio(rests_called_gross(found)),
    }


def reliability_of(events: Sequence[CaseEvents]) -> Reliability:
    """Reliability of the probability that a tenth of the area slips."""
    return sum((one.partial for one in events), start=Reliability())


def reliability_table(events: Sequence[CaseEvents]) -> str:
    """Probability stated, and the share of the time in which it was so."""
    found = reliability_of(events)
    return table(
        {
            "stated": f"{found.said_s[k] / found.time_s[k]:.2f}",
            "seen": f"{found.seen_s[k] / found.time_s[k]:.2f}",
            "time (s)": f"{found.time_s[k]:.1f}",
        }
        for k in range(N_BINS)
        if found.time_s[k] > 0
    )

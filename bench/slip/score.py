"""A controller's questions about slip events, and their answers by the truth of the cases."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from bench.report import NONE, ratio, table
from bench.slip.cases import NAMES, Case, CaseEvents
from tactiled.array import FloatArray
from tactiled.detect.contact.filter import SETTINGS
from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent

SLOW_S = 0.2  # from a tenth of the area to all of it
AHEAD_S = 0.1  # before gross slip, in time for a gripper; a gross slip reported before that is early
LEADS_TO_S = 1.0  # an onset that gross slip follows within this time announced it
_REOPENS_S = 0.1  # a slip that ends and begins anew within this time (a turn, a swing) went on
_REVERSED_DEG, _SURE_DEG = 90.0, 30.0
_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip


class Reported(NamedTuple):
    """One case and the slip events of one setting."""

    case: Case
    events: Sequence[SlipEvent]


def open_at(events: Sequence[SlipEvent], time_s: float) -> SlipEvent | None:
    """Return the newest onset of the slip that is open at an instant."""
    before = [e for e in events if e.detected_s <= time_s]
    return before[-1] if before and before[-1].state == "onset" else None


def onsets(events: Sequence[SlipEvent], kind: str) -> list[SlipEvent]:
    """Return the onsets of a kind."""
    return [e for e in events if (e.state, e.kind) == ("onset", kind)]


def usual(reported: Sequence[Reported]) -> list[Reported]:
    """Return the cases but those whose friction falls at constant load."""
    return [t for t in reported if not t.case.is_falling]


def falling(reported: Sequence[Reported]) -> list[Reported]:
    """Return the cases whose friction falls at constant load."""
    return [t for t in reported if t.case.is_falling]


def gross_reported(reported: Sequence[Reported], within_s: float) -> list[bool]:
    """Return, for each gross slip, True if one was open, or was reported up to a time after its beginning."""
    return [
        is_gross_at(events, case.gross_s - AHEAD_S)
        or any(
            case.gross_s - AHEAD_S <= e.detected_s <= case.gross_s + within_s for e in onsets(events, "gross")
        )
        for case, events in reported
        if case.slips
    ]


def is_gross_at(events: Sequence[SlipEvent], time_s: float) -> bool:
    """Return True if a gross slip is open at an instant."""
    slip = open_at(events, time_s)
    return slip is not None and slip.kind == "gross"


def reported_early(reported: Sequence[Reported]) -> list[float]:
    """Return the true utilisation at each report of gross slip that came more than `AHEAD_S` before it."""
    found = []
    for case, events in reported:
        slip = open_at(events, case.gross_s - AHEAD_S) if case.slips else None
        if slip is not None and slip.kind == "gross":
            found.append(case.utilisation_at(slip.detected_s))
    return found


def rests_called_gross(reported: Sequence[Reported], most_used: float = 1.0) -> list[bool]:
    """Return, for each case without gross slip, True if one was reported; of cases up to a utilisation."""
    return [
        bool(onsets(events, "gross"))
        for case, events in reported
        if not case.slips and case.utilisation.max() <= most_used
    ]


def slow_reported_ahead(reported: Sequence[Reported]) -> list[bool]:
    """Return, for each slow slip, True if an event was open `AHEAD_S` before it became gross."""
    return [
        open_at(events, case.gross_s - AHEAD_S) is not None
        for case, events in reported
        if case.slips and case.gross_s - case.tenth_s >= SLOW_S
    ]


def false_onsets_per_hour(reported: Sequence[Reported]) -> float:
    """Return the onsets of both kinds in an hour in which nothing slips."""
    n, hours = 0, 0.0
    for case, events in reported:
        nothing = case.nothing
        hours += float(nothing.sum()) / case.block.rate_hz / 3600
        for event in events:
            row = round((event.detected_s - float(case.block.time_s[0])) * case.block.rate_hz)
            n += event.state == "onset" and bool(nothing[row])
    return n / max(hours, 1e-9)


def onsets_that_lead(reported: Sequence[Reported]) -> list[bool]:
    """Return, for each onset of incipient slip before the first gross one, True if that follows soon."""
    return [
        case.gross_s - event.detected_s <= LEADS_TO_S
        for case, events in reported
        for event in onsets(events, "incipient")
        if event.detected_s <= case.gross_s
    ]


def ended_while_it_slides(reported: Sequence[Reported]) -> list[bool]:
    """Return, for each gross slip, True if its end was reported while it went on."""
    out = []
    for case, events in reported:
        if case.slips:
            until_s = min(case.gross_end_s, float(case.block.time_s[-1])) - _REOPENS_S
            ends_s = [
                e.detected_s for e in events if e.state == "end" and case.gross_s < e.detected_s < until_s
            ]
            out.append(any(open_at(events, end_s + _REOPENS_S) is None for end_s in ends_s))
    return out


class Directions(NamedTuple):
    """Errors of direction and stated standard deviations, in degrees."""

    error_deg: FloatArray
    sd_deg: FloatArray

    @property
    def inside(self) -> list[bool]:
        """Errors within one stated standard deviation."""
        return [bool(one) for one in np.abs(self.error_deg) <= self.sd_deg]

    @property
    def n_reversed(self) -> int:
        """Number of errors beyond 90 degrees that claim to be within 30."""
        return int(((np.abs(self.error_deg) > _REVERSED_DEG) & (self.sd_deg < _SURE_DEG)).sum())


def directions(reported: Sequence[Reported], kind: str) -> Directions:
    """Return the directions of the onset that belongs to each gross slip.

    Incipient: the newest up to gross slip. Gross: the first within 0.1 s before and 0.3 s after.
    """
    errors, sds = [], []
    for case, events in reported:
        if not case.slips or not np.isfinite(case.direction_deg):
            continue
        some = onsets(events, kind)
        if kind == "gross":
            near = [e for e in some if -AHEAD_S <= e.detected_s - case.gross_s <= 0.3][:1]
        else:
            near = [e for e in some if case.tenth_s - SLOW_S <= e.detected_s <= case.gross_s][-1:]
        for event in near:
            if event.direction_sd_deg < UNKNOWN_SD_DEG:
                errors.append((event.direction_deg - case.direction_deg + 180.0) % 360.0 - 180.0)
                sds.append(event.direction_sd_deg)
    return Directions(np.array(errors), np.array(sds))


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


QUESTIONS: Mapping[str, Callable[[Sequence[Reported]], str]] = {
    f"slow slips reported {1e3 * AHEAD_S:.0f} ms ahead": lambda found: ratio(
        slow_reported_ahead(usual(found))
    ),
    "onsets an hour where nothing slips": lambda found: f"{false_onsets_per_hour(found):.0f}",
    f"onsets that gross slip follows in {LEADS_TO_S:g} s": lambda found: ratio(
        onsets_that_lead(usual(found))
    ),
    "gross reported in 100 ms": lambda found: ratio(gross_reported(usual(found), 0.1)),
    "gross reported in 300 ms": lambda found: ratio(gross_reported(usual(found), 0.3)),
    "gross reported in 300 ms where friction falls": lambda found: ratio(gross_reported(falling(found), 0.3)),
    f"gross reported more than {1e3 * AHEAD_S:.0f} ms early": _early,
    "utilisation at these, median": _early_at,
    "rests called gross": lambda found: ratio(rests_called_gross(found)),
    f"rests below {_CLEAR:.0%} of the limit called gross": lambda found: ratio(
        rests_called_gross(found, _CLEAR)
    ),
    "ended while it slides": lambda found: ratio(ended_while_it_slides(found)),
    "direction at onset": partial(_direction, "incipient"),
    "direction at gross slip": partial(_direction, "gross"),
}


def settings_table(events: Sequence[CaseEvents]) -> str:
    """Answers to all questions, a column for each setting."""
    columns = {_head(name): [Reported(one.case, one.by_name[name]) for one in events] for name in NAMES}
    return table(
        {"question": question} | {head: answer(found) for head, found in columns.items()}
        for question, answer in QUESTIONS.items()
    )


def _head(name: str) -> str:
    at = SETTINGS.get(name)
    return name if at is None else f"{name}, p {at.incipient:g} / {at.gross:g}"

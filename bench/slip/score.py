"""A controller's questions about slip events, and their answers by the truth of the cases."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bench.report import NONE, ratio, table
from bench.slip.cases import NAMES, Case, Reported
from tactiled.array import FloatArray
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent

SLOW_S = 0.2  # from a tenth of the area to all of it
AHEAD_S = 0.1  # before gross slip, in time for a gripper; a gross slip reported before that is early
_REOPENS_S = 0.1  # a slip that ends and begins anew within this time (a turn, a swing) went on
_REVERSED_DEG, _SURE_DEG = 90.0, 30.0
_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip


def open_at(events: Sequence[SlipEvent], time_s: float) -> SlipEvent | None:
    """Return the newest onset of the slip that is open at an instant."""
    before = [e for e in events if e.detected_s <= time_s]
    return before[-1] if before and before[-1].state == "onset" else None


def gross_onsets(events: Sequence[SlipEvent]) -> list[SlipEvent]:
    """Return the onsets of gross slip."""
    return [e for e in events if (e.state, e.kind) == ("onset", "gross")]


def is_early(case: Case, events: Sequence[SlipEvent]) -> bool:
    """Return True if a gross slip is open `AHEAD_S` before that of a case."""
    slip = open_at(events, case.gross_s - AHEAD_S)
    return slip is not None and slip.kind == "gross"


def is_reported(case: Case, events: Sequence[SlipEvent], within_s: float) -> bool:
    """Return True if a gross slip is reported at most `AHEAD_S` early, and at most some time late."""
    from_s, until_s = case.gross_s - AHEAD_S, case.gross_s + within_s
    return any(from_s <= e.detected_s <= until_s for e in gross_onsets(events))


def is_reported_ahead(case: Case, events: Sequence[SlipEvent]) -> bool:
    """Return True if an event of a slip was open `AHEAD_S` before it became gross.

    An event that was reported more than `AHEAD_S` before a tenth of the area slipped is of no slip.
    """
    slip = open_at(events, case.gross_s - AHEAD_S)
    return slip is not None and slip.detected_s >= case.tenth_s - AHEAD_S


def is_ended(case: Case, events: Sequence[SlipEvent]) -> bool:
    """Return True if the end of a gross slip was reported while it went on."""
    until_s = min(case.gross_end_s, float(case.block.time_s[-1])) - _REOPENS_S
    ends_s = [e.detected_s for e in events if e.state == "end" and case.gross_s < e.detected_s < until_s]
    return any(open_at(events, end_s + _REOPENS_S) is None for end_s in ends_s)


def false_onsets(reported: Sequence[Reported]) -> tuple[int, float]:
    """Return the onsets of both kinds while nothing slips, and the hours of contact in which nothing does."""
    n, hours = 0, 0.0
    for case, events in reported:
        nothing = case.nothing
        hours += float((nothing & case.touching).sum()) / case.block.rate_hz / 3600
        for event in events:
            row = round((event.detected_s - float(case.block.time_s[0])) * case.block.rate_hz)
            n += event.state == "onset" and bool(nothing[row])
    return n, hours


def directions(reported: Sequence[Reported]) -> FloatArray:
    """Return errors and stated standard deviations (n, 2) of direction, in degrees.

    They are those of the first onset of gross slip from 0.1 s before each gross slip to 0.3 s after it.
    """
    found = []
    for case, events in _slides(reported):
        near = [e for e in gross_onsets(events) if -AHEAD_S <= e.detected_s - case.gross_s <= 0.3]
        if near and np.isfinite(case.direction_deg) and near[0].direction_sd_deg < UNKNOWN_SD_DEG:
            error_deg = (near[0].direction_deg - case.direction_deg + 180.0) % 360.0 - 180.0
            found.append((error_deg, near[0].direction_sd_deg))
    return np.array(found).reshape(-1, 2)


def _direction(reported: Sequence[Reported]) -> str:
    off_deg, sd_deg = np.abs(directions(reported)).T
    if not len(off_deg):
        return NONE
    reversed_ = (off_deg > _REVERSED_DEG) & (sd_deg < _SURE_DEG)
    return f"{np.median(off_deg):.1f} deg, {ratio(off_deg <= sd_deg)} inside, {reversed_.sum()} reversed"


def _onsets(reported: Sequence[Reported]) -> str:
    n, hours = false_onsets(reported)
    return f"{n / hours:.0f} ({n} in {hours:.3f} h)" if hours else NONE


def _slides(reported: Sequence[Reported], *, falls: bool = False) -> list[Reported]:
    """Return the cases with gross slip, but for those whose friction falls at constant load, or these."""
    return [one for one in reported if one.case.slips and one.case.is_falling == falls]


def _rests(reported: Sequence[Reported], most_used: float) -> list[Reported]:
    """Return the cases without gross slip that use at most a part of the limit."""
    return [one for one in reported if not one.case.slips and one.case.utilisation.max() <= most_used]


_MS = f"{1e3 * AHEAD_S:.0f} ms"
QUESTIONS: Mapping[str, Callable[[Sequence[Reported]], str]] = {
    f"slow slips reported {_MS} ahead": lambda found: ratio(
        is_reported_ahead(*one) for one in _slides(found) if one.case.gross_s - one.case.tenth_s >= SLOW_S
    ),
    "onsets an hour where nothing slips": _onsets,
    "gross reported in 100 ms": lambda found: ratio(is_reported(*one, 0.1) for one in _slides(found)),
    "gross reported in 300 ms": lambda found: ratio(is_reported(*one, 0.3) for one in _slides(found)),
    "gross reported in 300 ms where friction falls": lambda found: ratio(
        is_reported(*one, 0.3) for one in _slides(found, falls=True)
    ),
    f"gross reported more than {_MS} early": lambda found: ratio(is_early(*one) for one in _slides(found)),
    "rests called gross": lambda found: ratio(bool(gross_onsets(of.events)) for of in _rests(found, 1.0)),
    f"rests below {_CLEAR:.0%} of the limit called gross": lambda found: ratio(
        bool(gross_onsets(one.events)) for one in _rests(found, _CLEAR)
    ),
    "ended while it slides": lambda found: ratio(is_ended(*one) for one in found if one.case.slips),
    "direction at gross slip": _direction,
}


def settings_table(by_name: Sequence[Mapping[str, Reported]]) -> str:
    """Answers to all questions, a column for each setting."""
    columns = {_head(name): [one[name] for one in by_name] for name in NAMES}
    return table(
        {"question": question} | {head: answer(found) for head, found in columns.items()}
        for question, answer in QUESTIONS.items()
    )


def _head(name: str) -> str:
    at = SETTINGS.get(name)
    return name if at is None else f"{name}, p {at.incipient:g} / {at.gross:g}"

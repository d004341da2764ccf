"""Tables of ``./run bench slip``."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from bench.report import NONE, ratio, table
from bench.slip.cases import NAMES, CaseEvents
from bench.slip.score import (
    AHEAD_S,
    LEADS_TO_S,
    Reported,
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

_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip

Question = Callable[[Sequence[Reported]], str]


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

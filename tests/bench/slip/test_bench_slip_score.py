"""Answers of the slip bench, from events made by hand."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from slips import slip_at

from bench.slip.cases import Case, Reported
from bench.slip.score import (
    QUESTIONS,
    directions,
    false_onsets,
    is_early,
    is_ended,
    is_reported,
    is_reported_ahead,
)
from bench.worlds.world import INCIPIENT_USED
from tactiled.events.types import SlipEvent
from tactiled.samples.block import regular_block

RATE_HZ = 100.0


def case(*, slips: bool = True) -> Case:
    """Utilisation that rises from 2 s, to gross slip from 4 s to 6 s, or to 0.7."""
    t = np.arange(800) / RATE_HZ
    used = np.interp(t, [2.0, 4.0, 6.0, 6.1], [0.0, 1.0, 1.0, 0.0])
    return Case(
        block=regular_block(np.zeros((len(t), 36)), RATE_HZ),
        utilisation=used if slips else 0.7 * used,
        touching=t >= 0.5,
        gross_s=4.0 if slips else np.inf,
        gross_end_s=6.0 if slips else np.inf,
        tenth_s=2.3 if slips else np.inf,
        direction_deg=170.0,
    )


def event(
    kind: Literal["incipient", "gross"], detected_s: float, state: Literal["onset", "end"] = "onset"
) -> SlipEvent:
    return replace(slip_at(detected_s, -175.0, 10.0), state=state, kind=kind)


TRUE = [event("incipient", 2.5), event("gross", 4.01), event("gross", 6.05, "end")]


def test_events_of_the_truth_answer_every_question() -> None:
    reported = [Reported(case(), TRUE), Reported(case(slips=False), [])]
    assert is_reported_ahead(case(), TRUE)
    assert false_onsets(reported)[0] == 0
    assert is_reported(case(), TRUE, 0.1)
    assert not is_early(case(), TRUE)
    assert not is_ended(case(), TRUE)
    assert directions(reported).tolist() == [[15.0, 10.0]]
    answers = {question: answer(reported) for question, answer in QUESTIONS.items()}
    assert answers["slow slips reported 100 ms ahead"] == answers["gross reported in 300 ms"] == "1 of 1"
    assert answers["gross reported in 300 ms where friction falls"] == "0 of 0"
    assert answers["rests called gross"] == answers["ended while it slides"] == "0 of 1"
    assert answers["direction at gross slip"] == "15.0 deg, 0 of 1 inside, 0 reversed"


def test_an_event_that_was_reported_before_anything_slips_is_of_no_slip() -> None:
    for kind in ("incipient", "gross"):
        early = [event(kind, 1.0)]
        assert not is_reported_ahead(case(), early)
        assert not is_reported(case(), early, 0.3)
    assert is_early(case(), early)
    assert false_onsets([Reported(case(), early)])[0] == 1


def test_hours_are_of_contact_and_an_onset_without_contact_is_false() -> None:
    untouched = [Reported(case(slips=False), [event("incipient", 0.2)])]
    n, hours = false_onsets(untouched)
    slipping_s = float((case(slips=False).utilisation >= INCIPIENT_USED).sum()) / RATE_HZ + 0.1
    assert n == 1
    assert hours == pytest.approx((8.0 - 0.5 - slipping_s) / 3600, abs=0.03 / 3600)


def test_no_events_miss_everything() -> None:
    assert not is_reported_ahead(case(), [])
    assert not is_reported(case(), [], 0.3)


def test_events_at_the_wrong_time_count_against_the_detector() -> None:
    early = Reported(case(), [event("incipient", 1.0), event("gross", 3.0), event("gross", 5.0, "end")])
    nothing_s = float((case().nothing & case().touching).sum()) / RATE_HZ
    n, hours = false_onsets([early])
    assert (n, hours) == (1, nothing_s / 3600)
    assert QUESTIONS["onsets an hour where nothing slips"]([early]) == "997 (1 in 0.001 h)"
    assert is_early(*early)
    assert is_ended(*early)
    assert not is_ended(case(), [*early.events, event("incipient", 5.05)])
    called = [Reported(case(slips=False), TRUE)]
    assert QUESTIONS["rests called gross"](called) == "1 of 1"
    assert QUESTIONS["rests below 80% of the limit called gross"](called) == "1 of 1"
    most_used = Reported(replace(called[0].case, utilisation=np.full(800, 0.9)), TRUE)
    assert QUESTIONS["rests below 80% of the limit called gross"]([most_used]) == "0 of 0"

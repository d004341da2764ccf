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
    ended_while_it_slides,
    false_onsets,
    gross_reported,
    reported_early,
    rests_called_gross,
    slow_reported_ahead,
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
    assert slow_reported_ahead(reported) == [True]
    assert false_onsets(reported)[0] == 0
    assert gross_reported(reported, 0.1) == [True]
    assert reported_early(reported) == [False]
    assert rests_called_gross(reported) == [False]
    assert ended_while_it_slides(reported) == [False]
    assert directions(reported).tolist() == [[15.0, 10.0]]
    assert QUESTIONS["direction at gross slip"](reported) == "15.0 deg, 0 of 1 inside, 0 reversed"


def test_an_event_that_was_reported_before_anything_slips_is_of_no_slip() -> None:
    for kind in ("incipient", "gross"):
        early = [Reported(case(), [event(kind, 1.0)])]
        assert slow_reported_ahead(early) == gross_reported(early, 0.3) == [False]
    assert reported_early(early) == [True]
    assert false_onsets(early)[0] == 1


def test_hours_are_of_contact_and_an_onset_without_contact_is_false() -> None:
    untouched = [Reported(case(slips=False), [event("incipient", 0.2)])]
    n, hours = false_onsets(untouched)
    slipping_s = float((case(slips=False).utilisation >= INCIPIENT_USED).sum()) / RATE_HZ + 0.1
    assert n == 1
    assert hours == pytest.approx((8.0 - 0.5 - slipping_s) / 3600, abs=0.03 / 3600)


def test_no_events_miss_everything() -> None:
    reported = [Reported(case(), [])]
    assert slow_reported_ahead(reported) == gross_reported(reported, 0.3) == [False]


def test_events_at_the_wrong_time_count_against_the_detector() -> None:
    early = Reported(case(), [event("incipient", 1.0), event("gross", 3.0), event("gross", 5.0, "end")])
    nothing_s = float((case().nothing & case().touching).sum()) / RATE_HZ
    n, hours = false_onsets([early])
    assert (n, hours) == (1, nothing_s / 3600)
    assert QUESTIONS["onsets an hour where nothing slips"]([early]) == "997 (1 in 0.001 h)"
    assert reported_early([early]) == [True]
    assert ended_while_it_slides([early]) == [True]
    turned = Reported(case(), [*early.events, event("incipient", 5.05)])
    assert ended_while_it_slides([turned]) == [False]
    assert rests_called_gross([Reported(case(slips=False), TRUE)]) == [True]
    assert rests_called_gross([Reported(case(slips=False), TRUE)], 0.6) == []

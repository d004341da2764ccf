"""Questions of the settings bench, answered by the truth and by detectors on a world."""

from typing import Literal

import numpy as np
import pytest

from bench.grip.worlds import World, draw_worlds
from bench.settings.bench import POSTERIOR_SETTINGS, settings_table
from bench.settings.cases import Case, from_world
from bench.settings.replay import CaseEvents, Reliability, all_thresholds, run_posterior
from bench.settings.score import (
    Told,
    directions,
    ended_while_it_slides,
    false_onsets_per_hour,
    gross_told,
    onsets_that_lead,
    rests_called_gross,
    slow_told_ahead,
    told_early,
)
from tactiled.array import load_array
from tactiled.detect.grip.detector import GripParams
from tactiled.detect.grip.slip_detector import GripSlip
from tactiled.detect.grip.thresholds import SlipThresholds
from tactiled.detect.slip.detector import SETTINGS
from tactiled.events.types import SlipEvent
from tactiled.samples.block import regular_block

RATE_HZ = 100.0


@pytest.fixture(scope="module")
def world() -> World:
    return next(one for one in draw_worlds(range(20_000, 20_012)) if one.slips)


def case(*, slips: bool = True) -> Case:
    """Utilisation that rises from 2 s, to gross slip from 4 s to 6 s, or to 0.7."""
    t = np.arange(800) / RATE_HZ
    used = np.interp(t, [2.0, 4.0, 6.0, 6.1], [0.0, 1.0, 1.0, 0.0])
    return Case(
        group="by hand",
        array=load_array("wang2019-3x3"),
        block=regular_block(np.zeros((len(t), 36)), RATE_HZ),
        utilisation=used if slips else 0.7 * used,
        gross_s=4.0 if slips else np.inf,
        gross_end_s=6.0 if slips else np.inf,
        tenth_s=2.3 if slips else np.inf,
        direction_deg=170.0,
    )


def event(
    kind: Literal["incipient", "gross"], detected_s: float, state: Literal["onset", "end"] = "onset"
) -> SlipEvent:
    return SlipEvent(
        time_s=detected_s,
        state=state,
        kind=kind,
        onset_s=detected_s,
        onset_sd_s=0.0,
        direction_deg=-175.0,
        direction_sd_deg=10.0,
        confidence=1.0,
        taxels=(),
        detector="",
        statistic=1.0,
        threshold=1.0,
        valid=True,
        detected_s=detected_s,
    )


TRUE = [event("incipient", 2.5), event("gross", 4.01), event("gross", 6.05, "end")]


def test_events_of_the_truth_answer_every_question() -> None:
    told = [Told(case(), TRUE), Told(case(slips=False), [])]
    assert slow_told_ahead(told) == [True]
    assert false_onsets_per_hour(told) == 0
    assert gross_told(told, 0.1) == [True]
    assert told_early(told) == []
    assert rests_called_gross(told) == [False]
    assert ended_while_it_slides(told) == [False]
    found = directions(told, "gross")
    assert found.error_deg.tolist() == [15.0]
    assert (found.inside, found.n_reversed) == ([False], 0)


def test_no_events_miss_everything() -> None:
    told = [Told(case(), [])]
    assert slow_told_ahead(told) == gross_told(told, 0.3) == [False]


def test_events_at_the_wrong_time_count_against_the_detector() -> None:
    early = Told(case(), [event("incipient", 1.0), event("gross", 3.0), event("gross", 5.0, "end")])
    nothing_s = float(case().nothing.sum()) / RATE_HZ
    assert false_onsets_per_hour([early]) == pytest.approx(3600 / nothing_s)
    assert told_early([early]) == [pytest.approx(0.5)]
    assert onsets_that_lead([early]) == [False]
    assert ended_while_it_slides([early]) == [True]
    turned = Told(case(), [*early.events, event("incipient", 5.05)])
    assert ended_while_it_slides([turned]) == [False]
    assert rests_called_gross([Told(case(slips=False), TRUE)]) == [True]
    assert rests_called_gross([Told(case(slips=False), TRUE)], 0.6) == []


def test_reliability_counts_time() -> None:
    found = Reliability()
    for p, is_true in ((0.25, True), (0.25, False), (1.0, True)):
        found.take(p, is_true, 0.1)
    assert found.time_s[2] == pytest.approx(0.2)
    assert found.seen_s[2] == pytest.approx(0.1)
    both = found + found
    assert both.said_s[9] == pytest.approx(0.2)


def test_thresholds_on_one_posterior_are_the_detectors_of_these_settings(world: World) -> None:
    settings = [*POSTERIOR_SETTINGS.values(), SlipThresholds(0.2, 0.2)]
    found, _ = run_posterior(from_world(world), settings)
    assert found[settings[0]]
    for at in settings:
        params = GripParams(incipient_p=at.incipient, gross_p=at.gross)
        events = GripSlip(world.array, params).process(world.block)
        assert found[at] == [one for one in events if isinstance(one, SlipEvent)]


def test_the_table_has_a_column_for_each_setting_of_both() -> None:
    posterior = dict.fromkeys(all_thresholds(list(POSTERIOR_SETTINGS.values())), TRUE)
    some = CaseEvents(case(), posterior, dict.fromkeys(SETTINGS, TRUE), Reliability())
    rows = settings_table([some]).splitlines()
    assert rows[0].count("|") == 2 + len(POSTERIOR_SETTINGS) + len(SETTINGS)
    assert "1 of 1" in rows[2]

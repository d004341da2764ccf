"""Scores of events that are made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.slip.scenes import SCAN_SPAN_S, PlayedScene
from bench.slip.score import (
    GRACE_S,
    SETTLE_S,
    count_alarms,
    coverage,
    median,
    quantile,
    score_slip,
)
from bench.slip.truth import GRID_S, FirstSlip, LoadHistory
from tactiled.emulator.scene.phases import FlatPlate
from tactiled.emulator.scene.truth import TrueSlip
from tactiled.events.types import UNKNOWN_SD_DEG, SlipEvent

SLIP = FirstSlip(shear_s=5.0, incipient_s=5.1, gross_s=5.4, end_s=7.0, direction_deg=170.0)
PLAYED = PlayedScene(
    "by-hand", 1, np.zeros((800, 36)), 1.0, SLIP, ((3.0, 3.5), (5.0, 7.0)), (), np.zeros(800)
)


def onset(detected_s: float, kind: str = "incipient", **changes: float | bool | str) -> SlipEvent:
    """An onset whose scan is complete at `detected_s`."""
    event = SlipEvent(
        time_s=0.0, state="onset", kind="incipient", onset_s=5.01, onset_sd_s=0.02, direction_deg=-170.0,
        direction_sd_deg=15.0, confidence=1.0, taxels=(), detector="hand", statistic=1.0, threshold=1.0,
        valid=True, detected_s=detected_s - SCAN_SPAN_S,
    )  # fmt: skip
    return replace(event, kind="gross" if kind == "gross" else "incipient", **changes)  # type: ignore[arg-type]


def test_score_of_a_slip_that_is_detected() -> None:
    found = score_slip([onset(5.2), onset(5.45, "gross", onset_s=5.41)], PLAYED, SLIP)
    assert found.latency_s == pytest.approx(0.2)
    assert found.lead_s == pytest.approx(0.2)
    assert found.incipient_latency_s == pytest.approx(0.1)
    assert found.gross_latency_s == pytest.approx(0.05)
    assert found.onset_error_s == pytest.approx(0.01)
    assert found.onset_sd_s == 0.02
    assert found.gross_onset_error_s == pytest.approx(0.01)
    assert found.direction_error_deg == pytest.approx(20.0)  # across 180
    assert (found.n_early, found.n_on_press) == (0, 0)


def test_an_end_during_the_slip_without_gross_event_is_ended_early() -> None:
    ended, later = onset(5.8, state="end"), onset(7.2, state="end")
    assert score_slip([onset(5.2), ended], PLAYED, SLIP).is_ended_early
    assert not score_slip([onset(5.2), later], PLAYED, SLIP).is_ended_early
    assert not score_slip([onset(5.2), onset(5.45, "gross"), ended], PLAYED, SLIP).is_ended_early


def test_no_event_is_a_miss() -> None:
    found = score_slip([], PLAYED, SLIP)
    assert np.isnan(
        [found.latency_s, found.gross_latency_s, found.onset_error_s, found.direction_error_deg]
    ).all()
    assert (found.n_early, found.n_on_press) == (0, 0)


def test_an_event_before_the_shear_is_a_false_alarm_and_no_detection() -> None:
    found = score_slip([onset(4.999)], PLAYED, SLIP)
    assert np.isnan(found.latency_s)
    assert found.n_early == 1
    assert score_slip([onset(5.0)], PLAYED, SLIP).latency_s == pytest.approx(0.0)


def test_an_event_between_growth_of_the_load_and_shear_detects_the_slip() -> None:
    swells = replace(SLIP, grown_for_s=0.04)
    found = score_slip([onset(4.97), onset(5.2)], PLAYED, swells)
    assert found.latency_s == pytest.approx(-0.03)
    assert found.n_early == 0
    before = onset(4.95, onset_s=5.0, onset_sd_s=1.0)  # whatever it states
    found = score_slip([before, onset(5.2)], PLAYED, swells)
    assert found.latency_s == pytest.approx(0.2)
    assert found.n_early == 1


@given(st.floats(0.5, 3.0), st.sampled_from([1, 2, 3]))
def test_growth_of_a_load_begins_at_the_end_of_its_rest(swells_for_s: float, power: int) -> None:
    time_s = np.arange(0.0, 6.0, GRID_S)
    shear_n = np.where(time_s < 1.0, time_s, 1.0)  # it has come and stays
    shear_n += 5.0 * (np.maximum(time_s - 3.0, 0.0) / swells_for_s) ** power
    load = LoadHistory(time_s, shear_n, np.full(len(time_s), 10.0))
    begins_s = load.shear_s(TrueSlip(5.9, np.inf, 0.0, FlatPlate(friction=0.5), shear_s=0.0))
    grown_for_s = load.grown_for_s(begins_s)
    before_n, at_n, grown_n = np.interp([begins_s - 0.1, begins_s - grown_for_s, begins_s], time_s, shear_n)
    assert grown_n - before_n <= 0.002 * 10.0 + 1e-9  # not yet growth
    assert begins_s - grown_for_s >= 3.0 - GRID_S
    assert grown_for_s == pytest.approx(0.1) or at_n - 1.0 <= 1e-3  # a twentieth of that: it leaves rest


def test_an_alarm_on_the_press_is_counted_separately() -> None:
    found = score_slip([onset(0.5, "gross"), onset(1.0 + SETTLE_S + 0.01, "gross")], PLAYED, SLIP)
    assert (found.n_on_press, found.n_early) == (1, 1)


def test_an_earlier_partial_slip_may_be_reported_as_incipient_only() -> None:
    assert score_slip([onset(3.2)], PLAYED, SLIP).n_early == 0
    assert score_slip([onset(3.2, "gross")], PLAYED, SLIP).n_early == 1


def test_an_event_after_the_slip_is_a_miss() -> None:
    assert np.isnan(score_slip([onset(7.001)], PLAYED, SLIP).latency_s)
    short = replace(SLIP, end_s=5.41)
    assert score_slip([onset(5.4 + GRACE_S - 0.01)], PLAYED, short).latency_s > 0
    assert np.isnan(score_slip([onset(5.4 + GRACE_S + 0.01)], PLAYED, short).latency_s)


def test_suppressed_events_and_ends_are_no_detection() -> None:
    found = score_slip([onset(5.2, valid=False), replace(onset(5.2), state="end")], PLAYED, SLIP)
    assert np.isnan(found.latency_s)


def test_no_direction_error_where_no_direction_is_stated_or_true() -> None:
    unknown = onset(5.2, direction_sd_deg=UNKNOWN_SD_DEG)
    assert np.isnan(score_slip([unknown], PLAYED, SLIP).direction_error_deg)
    assert score_slip([unknown, onset(5.3)], PLAYED, SLIP).direction_error_deg == pytest.approx(20.0)
    assert np.isnan(score_slip([onset(5.2)], PLAYED, replace(SLIP, direction_deg=None)).direction_error_deg)


def test_counts_of_a_scene_without_gross_slip() -> None:
    events = [onset(2.0), onset(3.1), onset(3.1, "gross"), replace(onset(2.0), valid=False)]
    assert count_alarms(events, replace(PLAYED, slip=None)) == (2, 1, 0, 1)
    assert count_alarms([onset(0.5)], replace(PLAYED, slip=None)) == (1, 0, 1, 0)


def test_a_miss_is_later_than_any_latency() -> None:
    assert median([0.1, np.nan, 0.3]) == 0.3
    assert median([0.1, np.nan, np.nan]) == np.inf
    assert quantile([0.1, 0.2, 0.3, np.nan], 0.75) == 0.3


@given(st.lists(st.floats(0, 1), min_size=1), st.integers(1, 20))
def test_another_miss_never_improves_a_quantile(latency: list[float], misses: int) -> None:
    for part in (0.1, 0.5, 0.95):
        assert quantile(latency + [np.nan] * misses, part) >= quantile(latency, part)


def test_coverage_counts_stated_sigmas_only() -> None:
    error, sd = np.array([0.5, -2.0, np.nan, 1.0]), np.array([1.0, 1.0, 1.0, np.nan])
    assert coverage(error, sd) == 0.5
    assert np.isnan(coverage(error[2:], sd[2:]))

"""Force events beside those of the detectors: order, tare, gaps."""

import dataclasses
import itertools

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.events.types import Event, ForceEvent
from tactiled.force.calibration import load_calibration
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import Gap, regular_block

ARRAY = load_array("wang2019-3x3")


def suite() -> TunedSuite:
    force = ForceEstimator(ARRAY, load_calibration("wang2019-3x3"))
    return TunedSuite(ARRAY, DetectParams(), force=force)


def volts(n: int, level: float = 0.0) -> np.ndarray:
    return np.asarray(level + 1e-3 * np.random.default_rng(0).standard_normal((n, 36)))


def forces(events: list[Event]) -> list[ForceEvent]:
    return [event for event in events if isinstance(event, ForceEvent)]


def test_each_scan_has_a_force_and_events_keep_their_order() -> None:
    readings = volts(600)
    readings[200:] += np.clip(np.arange(400) / 50, 0, 1)[:, np.newaxis]
    events = suite().process(regular_block(readings, 100.0))
    assert len(forces(events)) == 600
    assert len(events) > 600  # the contact
    assert all(a.evidence_s <= b.evidence_s for a, b in itertools.pairwise(events))


def test_a_tare_sets_the_force_to_zero() -> None:
    tuned = suite()
    before = forces(tuned.process(regular_block(volts(200, 0.05), 100.0)))
    assert before[-1].fz_n > 1.0
    assert tuned.tare(force=True)[0] == ""
    after = forces(tuned.process(regular_block(volts(10, 0.05), 100.0, start_s=2.0, index=200)))
    assert after[-1].fz_n == pytest.approx(0.0, abs=0.05)


def test_a_gap_keeps_zero_and_contact() -> None:
    tuned = suite()
    held = forces(tuned.process(regular_block(volts(300, 0.5), 100.0)))
    tuned.process(Gap(500, "missing", 300))
    again = forces(tuned.process(regular_block(volts(10, 0.5), 100.0, start_s=8.0, index=800)))
    assert again[0].fz_n == pytest.approx(held[-1].fz_n, rel=0.02)
    assert len(again) == 10


def test_a_channel_that_dies_in_a_hold_is_left_out_and_widens_the_interval() -> None:
    readings = volts(600, 0.5)
    readings[300:, 8] = 0.0
    found = forces(suite().process(regular_block(readings, 100.0)))
    assert all(event.valid for event in found[:300])
    assert {event.channels_missing for event in found[:300]} == {0}
    assert {event.channels_missing for event in found[341:]} == {1}
    assert found[-1].fx_sd_n > found[299].fx_sd_n
    assert found[-1].fz_n == pytest.approx(found[299].fz_n, rel=0.01)


@pytest.mark.parametrize("size", [1, 7, 400])
def test_forces_do_not_depend_on_chunks_when_a_new_clock_fit_moves_the_times(size: int) -> None:
    """After a replug the clock is fitted anew; its times may jump between two scans."""
    block = regular_block(volts(400, 0.5), 100.0)
    block = dataclasses.replace(block, time_s=block.time_s + 3.6 * (np.arange(400) >= 150))
    whole = forces(suite().process(block))
    tuned = suite()
    parts = [forces(tuned.process(block[first : first + size])) for first in range(0, 400, size)]
    assert list(itertools.chain.from_iterable(parts)) == whole


def test_a_stuck_channel_is_missing_and_not_saturated() -> None:
    """It stays at its largest calibrated reading while the press ends."""
    top = float(load_calibration("wang2019-3x3").largest_reading[0])
    readings = (
        volts(900, 0.0) + np.interp(np.arange(900), [0, 100, 500, 700], [0, top, top, 0])[:, np.newaxis]
    )
    readings[400:, 0] = top
    last = forces(suite().process(regular_block(readings, 100.0)))[-1]
    assert (last.channels_missing, last.saturated) == (1, False)
    assert abs(last.fz_n) < 0.1


def test_the_zero_is_followed_beside_a_dead_channel() -> None:
    """Drift of 30 mV in 2000 s, which as a force is 1.3 N."""
    readings = volts(2000) + 0.03 * np.linspace(0, 1, 2000)[:, np.newaxis]
    valid = np.ones(readings.shape, dtype=np.bool_)
    valid[:, 3] = False
    force = ForceEstimator(ARRAY, load_calibration("wang2019-3x3"))
    assert abs(force.process(regular_block(readings, 1.0, valid=valid))[-1].fz_n) < 0.2

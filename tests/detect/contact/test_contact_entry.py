"""Beginnings of contacts: pulls in the press, contacts that were not seen to begin, gaps, scan rates."""

import math
from dataclasses import replace

import numpy as np
import pytest
from touches import contact_states, onsets, slips

from tactiled.array import FloatArray, load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.contact.press_zero import PressZero
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
PAD = replace(ARRAY, shear_per_friction=1.0)
SIDES = np.sign(ARRAY.shear_weights().sum(axis=1))  # (2, channels)
DIRECTION_DEG = 25.0
GRIP_FAST = GripParams(incipient_p=SETTINGS["fast"].incipient)
FIRST, LAST = 398, 418  # scans that are lost


def ramp(start_s: float, takes_s: float, rate_hz: float = 100.0, duration_s: float = 8.0) -> FloatArray:
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    return np.asarray(np.clip((time_s - start_s) / takes_s, 0, 1))


def touch(shear: FloatArray, pressure: FloatArray, rate_hz: float = 100.0, seed: int = 3) -> ScanBlock:
    """Shear (n,) in volts of opposed sides, in `DIRECTION_DEG`, and pressure (n,) in volts of all."""
    angle = math.radians(DIRECTION_DEG)
    motion = shear[:, np.newaxis] * (math.cos(angle) * SIDES[0] + math.sin(angle) * SIDES[1])
    volts = pressure[:, np.newaxis] + motion
    return regular_block(volts + 1e-3 * np.random.default_rng(seed).normal(size=volts.shape), rate_hz)


PRESSED = 1.2 * ramp(0.5, 0.5)


def grips(events: list[Event]) -> list[GripEvent]:
    return [event for event in events if isinstance(event, GripEvent) and event.state != "none"]


# --- the first instants


@pytest.mark.parametrize("pull_s", [0.6, 0.8, 1.0])
def test_a_pull_during_the_press_is_told_in_its_direction(pull_s: float) -> None:
    events = GripDetector(ARRAY).process(touch(0.6 * ramp(pull_s, 0.4), PRESSED))
    first = onsets(events)[0]
    assert pull_s < first.detected_s < pull_s + 0.4
    assert abs(first.direction_deg - DIRECTION_DEG) < max(2.0, 2 * first.direction_sd_deg)


def test_a_press_without_a_pull_is_no_slip() -> None:
    for seed in range(5):
        assert slips(GripDetector(ARRAY).process(touch(0 * PRESSED, PRESSED, seed=seed))) == []


def test_the_interval_of_utilisation_holds_what_a_slanted_press_bears() -> None:
    """Nothing tells shear that comes with the load from a zero, but that no zero is as large."""
    ratio = 0.5  # shear over load: side channels read 2 * 0.25 * 1.2 over 1.2
    events = grips(GripDetector(ARRAY).process(touch(ratio / 2 * PRESSED, PRESSED)))
    after = [event for event in events if event.time_s > 1.2]
    shear = [math.hypot(event.shear_x, event.shear_y) / event.load for event in after]
    assert min(shear) > 0.6 * ratio
    assert all(ratio / (event.friction_high * 1.05) < event.utilisation_high for event in after)


def test_the_zero_of_unequal_sides_is_measured_and_is_no_shear() -> None:
    rng = np.random.default_rng(5)
    zero = PressZero(PAD, 100.0, 0.01, is_seen=True)
    parts = 0.04 * rng.normal(size=(2, 9))
    parts -= parts.mean(axis=1, keepdims=True)
    for k in range(60):
        assert not zero.is_measured
        load = np.full(9, (k + 1) / 60)
        zero.take(load, parts * load + 1e-3 * rng.normal(size=(2, 9)), 1e-3, 3e-3)
    assert zero.is_measured
    assert zero.parts == pytest.approx(parts, abs=1e-3)
    assert zero.whole_sd == 0.0


def test_shear_that_leaves_the_zero_is_no_part_of_it_and_leaves_it_uncertain() -> None:
    zero, load = PressZero(PAD, 100.0, 0.01, is_seen=True), np.ones(9)
    for _ in range(20):
        zero.take(load, np.zeros((2, 9)), 1e-3, 3e-3)
    assert not zero.pull_began
    for _ in range(40):
        zero.take(load, np.full((2, 9), 0.2), 1e-3, 3e-3)
        assert zero.pull_began
    assert zero.is_measured
    assert zero.parts == pytest.approx(np.zeros((2, 9)), abs=1e-9)
    assert 0.01 < zero.whole_sd < 0.04


@pytest.mark.parametrize("in_counts", [True, False])
def test_a_press_of_chips_in_counts_may_make_more_shear_than_one_in_newtons(in_counts: bool) -> None:
    array = replace(PAD, unit="count") if in_counts else PAD
    zero, load = PressZero(array, 100.0, 0.01, is_seen=True), np.ones(9)
    crosstalk = np.stack([0.1 * load, np.zeros(9)])
    for k in range(60):
        zero.take((1 + k / 20) * load, (1 + k / 20) * crosstalk, 1e-3, 3e-3)
    left = float((crosstalk - zero.parts)[0].mean())
    assert left < 0.01 if in_counts else left > 0.02


def test_a_zero_that_was_left_is_measured_anew_at_larger_loads_unless_shear_is_a_pull() -> None:
    for ratio, is_pull in ((0.0, False), (0.2, True)):
        zero, load = PressZero(PAD, 100.0, 0.01, is_seen=True), np.full(9, 0.1)
        zero.take(load, 0 * load * np.ones((2, 1)), 1e-3, 3e-3)
        zero.take(load, 0.2 * load * np.ones((2, 1)), 1e-3, 3e-3)
        assert zero.pull_began
        for k in range(58):
            zero.take((1 + k / 20) * load, ratio * (1 + k / 20) * load * np.ones((2, 1)), 1e-3, 3e-3)
        assert zero.pull_began == is_pull
        assert zero.is_measured


def test_the_zero_of_the_first_small_loads_does_not_last() -> None:
    """Of a taxel that is hardly touched, noise is many times the load."""
    zero, rng = PressZero(PAD, 100.0, 0.01, is_seen=True), np.random.default_rng(6)
    depth = np.linspace(0.0, 0.06, 9)
    for k in range(60):
        load = depth + 1e-4 + 0.05 * k
        # The noise floor is not yet known: it says a thousandth of the noise.
        zero.take(load, 5e-3 * rng.normal(size=(2, 9)), 5e-6, 15e-6)
        assert not zero.pull_began
    assert zero.is_measured
    assert np.hypot(*zero.parts.mean(axis=1)) < 0.01


def test_a_press_right_after_the_start_bears_no_shear() -> None:
    """A contact begins three scans after the board does, when nothing is known of its noise."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        time_s = np.arange(150) / 100.0
        depth = np.repeat(np.linspace(0.0, 0.1, 9), 4)
        pressed = np.minimum(5 * np.maximum(time_s - 0.02, 0.0), 1.0)[:, np.newaxis] + depth
        volts = np.where(time_s[:, np.newaxis] > 0.025, pressed - 0.05, 0.0)
        volts = np.maximum(volts, 0.0) + 2e-3 * rng.standard_normal((150, 36))
        events = grips(GripDetector(ARRAY).process(regular_block(volts, 100.0)))
        assert not [event for event in events if event.state == "gross"]
        assert all(event.utilisation_low < 0.05 for event in events)
        assert all(math.hypot(event.shear_x, event.shear_y) < 0.1 * event.load for event in events[10:])


# --- contacts that were not seen to begin


def test_a_contact_from_the_first_scan_on_is_uncertain_and_its_slips_are_told() -> None:
    events = GripDetector(ARRAY).process(touch(0.2 + 0.5 * ramp(4.0, 0.3), 1.2 + 0 * PRESSED))
    before = [event for event in grips(events) if 2.0 < event.time_s < 3.9]
    ratio = 2 * 0.2 / 1.2
    assert all(event.utilisation_low == 0.0 for event in before)
    assert all(event.utilisation_high > ratio / event.friction for event in before)
    told = onsets(GripDetector(ARRAY).process(touch(0.2 + 0.5 * ramp(4.0, 0.3), 1.2 + 0 * PRESSED)))
    assert 4.0 < told[0].detected_s < 4.3
    assert abs(told[0].direction_deg - DIRECTION_DEG) < 2.0


@pytest.mark.parametrize("shear_volts", [0.05, 0.2, 0.4])
def test_a_steady_contact_from_the_first_scan_on_is_no_slip(shear_volts: float) -> None:
    """Neither while nothing is known of the noise, nor later."""
    for seed in range(5):
        steady = touch(shear_volts + 0 * PRESSED, 1.2 + 0 * PRESSED, seed=seed)
        assert slips(GripDetector(ARRAY).process(steady)) == []


def test_a_contact_that_was_not_seen_to_begin_bears_what_the_same_one_bears_that_was() -> None:
    """An object is filled while the hand tightens by less than a half: shear keeps what was there before."""
    filled = ramp(5.0, 1.0)
    block = touch(0.15 * ramp(2.0, 0.5) + 0.1 * filled, PRESSED * (1 + 0.4 * filled))
    seen = {event.time_s: event for event in grips(GripDetector(ARRAY).process(block))}
    unseen = grips(GripDetector(ARRAY).process(block[400:]))
    assert {event.state for event in unseen if event.time_s < 5.0} == {"unknown"}
    for event in unseen:
        whole = seen[event.time_s]
        assert (event.shear_x, event.shear_y) == pytest.approx((whole.shear_x, whole.shear_y), rel=0.03)
        assert event.needed_load >= 0.95 * whole.needed_load


def test_the_first_shear_of_a_contact_that_was_not_seen_to_begin_is_no_zero() -> None:
    zero, load = PressZero(PAD, 100.0, 0.01, is_seen=False), np.full(9, 0.1)
    for k in range(60):
        zero.take((1 + k / 100) * load, 0.5 * load * np.ones((2, 1)), 1e-3, 3e-3)
        assert not zero.parts.any()
        assert 0.03 < zero.whole_sd < 0.05
        assert not zero.is_seen
    assert zero.is_measured


def test_a_contact_whose_load_doubles_after_the_first_scan_was_seen_to_begin() -> None:
    zero, load = PressZero(PAD, 100.0, 0.01, is_seen=False), np.full(9, 0.1)
    zero.take(load, 0.5 * load * np.ones((2, 1)), 1e-3, 3e-3)
    crosstalk = 0.03 * np.stack([np.ones(9), np.zeros(9)])
    for _ in range(59):
        zero.take(10 * load, 10 * load * crosstalk, 1e-3, 3e-3)
    assert zero.is_seen
    assert zero.whole_sd < 0.002
    assert zero.parts == pytest.approx(crosstalk, abs=1e-3)


def test_shear_that_grows_with_most_of_the_load_of_a_contact_is_no_zero() -> None:
    zero, load = PressZero(PAD, 100.0, 0.01, is_seen=False), np.full(9, 0.1)
    for k in range(30):
        zero.take((1 + k / 10) * load, 0.2 * (1 + k / 10) * load * np.ones((2, 1)), 1e-3, 3e-3)
    assert zero.pull_began
    assert not zero.parts.any()


# --- gaps


@pytest.mark.parametrize("shear_volts", [0.0, 0.4])
def test_a_lift_within_one_scan_ends_the_contact(shear_volts: float) -> None:
    held = ramp(1.0, 0.5) * (np.arange(800) < 500)
    events = GripDetector(ARRAY).process(touch(shear_volts * held * ramp(2.0, 0.5), held))
    assert [e.time_s for e in events if isinstance(e, GripEvent) and e.state == "none"] == [5.0]
    assert grips(events)[-1].time_s == pytest.approx(4.99)


def through_a_gap(block: ScanBlock, detector: GripDetector) -> list[Event]:
    events = detector.process(block[:FIRST])
    events += detector.process(Gap(LAST - FIRST, "missing", int(block.index[LAST])))
    return events + detector.process(block[LAST:])


def test_friction_and_its_interval_are_kept_over_a_gap() -> None:
    block = touch(0.3 * ramp(2.0, 1.0), PRESSED)
    detector = GripDetector(ARRAY)
    before = grips(detector.process(block[:FIRST]))[-1]
    end = detector.process(Gap(LAST - FIRST, "missing", int(block.index[LAST])))
    assert [(e.state, e.valid) for e in end if isinstance(e, GripEvent)] == [("none", False)]
    after = grips(detector.process(block[LAST:]))[0]
    for name in ("friction_low", "friction", "friction_high", "utilisation_low", "utilisation_high"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=0.1)


def test_other_loads_after_a_gap_are_another_contact() -> None:
    pressure = PRESSED * np.where(np.arange(800) < 408, 1.0, 0.3)
    block = touch(0.2 * ramp(2.0, 1.0) * np.where(np.arange(800) < 408, 1.0, 0.3), pressure)
    after = [event for event in grips(through_a_gap(block, GripDetector(ARRAY))) if event.time_s > 4.2]
    assert (after[0].state, after[0].utilisation_low, after[0].utilisation_high) == ("unknown", 0.0, 1.0)
    assert after[0].utilisation_low == 0.0


def test_a_contact_that_ended_in_a_gap_is_told_after_it() -> None:
    """A cut-off contact is not valid as an end; that it is over is known only at the scan after the gap."""
    held = np.where(np.arange(800) < 408, 1.0, 0.02)
    block = touch(0.2 * ramp(2.0, 1.0) * held, PRESSED * held)
    after = [
        event
        for event in through_a_gap(block, GripDetector(ARRAY))
        if isinstance(event, GripEvent) and event.time_s > 4.1
    ]
    assert [(event.state, event.valid) for event in after] == [("none", True)]


def test_states_of_the_contact_over_a_gap() -> None:
    states = contact_states(through_a_gap(touch(0 * PRESSED, PRESSED), GripDetector(ARRAY)))
    assert states == ["loading", "holding", "none", "unknown"]


# --- scan rates


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 5.0, 10.0, 50.0, 1000.0])
def test_a_slip_is_told_at_any_rate(rate_hz: float) -> None:
    """Also where the press takes less than a scan."""
    takes_s = max(0.3, 2.0 / rate_hz)
    n_s = 8.0 if rate_hz >= 10 else 40.0 / rate_hz
    pressed = 1.2 * ramp(0.5, 0.5, rate_hz, n_s)
    start_s = n_s / 2
    block = touch(0.6 * ramp(start_s, takes_s, rate_hz, n_s), pressed, rate_hz)
    first = onsets(GripDetector(ARRAY).process(block))[0]
    assert start_s < first.detected_s < start_s + takes_s + 1.0 / rate_hz
    assert abs(first.direction_deg - DIRECTION_DEG) < 3.0
    assert slips(GripDetector(ARRAY).process(touch(0 * pressed, pressed, rate_hz))) == []


@pytest.mark.parametrize("rate_hz", [1.0, 3.0])
def test_a_contact_that_is_pressed_and_pulled_within_a_scan_is_told(rate_hz: float) -> None:
    pressed = np.repeat([0.0, 1.2], [6, 14])
    block = touch(0.5 * pressed, pressed, rate_hz)
    first = onsets(GripDetector(ARRAY).process(block))[0]
    assert first.detected_s == pytest.approx(6 / rate_hz, abs=2.1 / rate_hz)
    assert abs(first.direction_deg - DIRECTION_DEG) < max(3.0, first.direction_sd_deg)


# --- faults of channels


@pytest.mark.parametrize("channels", [1, 3, 6])
@pytest.mark.parametrize("jump", [-1.0, 0.3, 1.0])
@pytest.mark.parametrize("scans", [1, 20, 300])
def test_neighbouring_channels_that_jump_are_no_slip(channels: int, jump: float, scans: int) -> None:
    """A spark beside the cable, a bit that sticks, a wire that comes loose."""
    block = touch(0.05 * ramp(1.5, 0.5), PRESSED)
    volts = block.volts.copy()
    struck = (7 * scans + round(10 * jump) + np.arange(channels)) % ARRAY.n_channels
    volts[400 : 400 + scans, struck] = np.clip(volts[400 : 400 + scans, struck] + jump, 0, 3)
    plain, events = (
        slips(GripDetector(ARRAY, GRIP_FAST).process(regular_block(readings[:750], 100.0)))
        for readings in (block.volts, volts)
    )
    assert [event.kind for event in plain] in ([], ["incipient"])  # of the rest itself, after seconds
    assert [event.kind for event in events] in ([], [event.kind for event in plain])
    assert all(event.detected_s > plain[0].detected_s - 0.03 for event in events)


@pytest.mark.parametrize("volts", [None, 0.0, 2.9])
def test_channels_that_stick_take_their_taxels_out_and_hide_no_slip(volts: float | None) -> None:
    block = touch(0.6 * ramp(6.0, 0.3), PRESSED)
    stuck = block.volts.copy()
    stuck[350:, [0, 18]] = stuck[350, [0, 18]] if volts is None else volts
    told = onsets(GripDetector(ARRAY).process(regular_block(stuck, 100.0)))
    assert 6.0 < told[0].detected_s < 6.3
    assert set(told[-1].taxels) <= {1, 2, 3, 5, 6, 7, 8}
    assert abs(told[0].direction_deg - DIRECTION_DEG) < 3.0


def test_a_slip_of_all_taxels_within_a_scan_is_no_jump_of_channels() -> None:
    first = onsets(GripDetector(ARRAY).process(touch(0.6 * ramp(4.0, 0.01), PRESSED)))[0]
    assert 4.0 < first.detected_s < 4.05
    assert first.valid

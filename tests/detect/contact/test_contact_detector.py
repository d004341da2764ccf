"""Laws of the grip detector: chunking, reset, unit, finiteness, and that it follows a known contact."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mindlin import slid_to, travel_for

from tactiled.array import Array, ArrayFile, FloatArray, Grid, TaxelChannel, build, load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

MU = 0.7
RATE_HZ = 100.0
PLACES = (-4.0, 0.0, 4.0)
PART = np.array([0.4, 0.8, 0.5, 0.9, 1.8, 1.1, 0.6, 1.2, 0.7])


def xyz(full_scale: float = 8.0) -> Array:
    channels = [
        TaxelChannel(name="x", kind="shear_x"),
        TaxelChannel(name="y", kind="shear_y"),
        TaxelChannel(name="z", kind="normal"),
    ]
    return build(
        ArrayFile(
            name="xyz",
            grids=[Grid(x_mm=list(PLACES), y_mm=list(PLACES))],
            taxel_channels=channels,
            range=(-full_scale, full_scale),
        )
    )


def pull(target: float, duration_s: float = 4.0, noise: float = 0.002) -> tuple[FloatArray, FloatArray]:
    """Readings (n, 27) of a pull along -x up to a utilisation, and the utilisation of each scan."""
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    load = PART * np.interp(t, [0.5, 1.0], [0.0, 1.0])[:, np.newaxis]
    used = np.interp(t, [2.0, 3.5], [0.0, target])
    shear = slid_to(load, travel_for(PART, used), MU, (-np.ones(9), np.zeros(9)))
    readings = np.zeros((len(t), 27))
    readings[:, 0::3], readings[:, 2::3] = shear[:, 0], load
    return readings + noise * np.random.default_rng(3).normal(size=readings.shape), used


def grips(events: list[Event]) -> list[GripEvent]:
    return [event for event in events if isinstance(event, GripEvent)]


def assert_finite(events: list[Event]) -> None:
    for event in grips(events):
        for field in dataclasses.fields(event):
            value = getattr(event, field.name)
            assert not isinstance(value, float) or math.isfinite(value), f"{field.name} of {event}"
        assert 0 <= event.utilisation_low <= event.utilisation <= event.utilisation_high <= 1
        assert event.friction_low <= event.friction <= event.friction_high
        assert 0 <= event.p_gross_50ms <= event.p_gross_100ms <= event.p_gross_300ms <= 1


def test_follows_utilisation_and_friction_of_an_ideal_contact() -> None:
    readings, used = pull(0.75)
    events = grips(GripDetector(xyz()).process(regular_block(readings, RATE_HZ)))
    late = [(e, used[round(e.time_s * RATE_HZ)]) for e in events if e.time_s > 3.2]
    assert len(late) == 79
    for event, truth in late:
        assert event.utilisation_low - 0.02 <= truth <= event.utilisation_high + 0.02
        assert event.utilisation == pytest.approx(truth, abs=0.2)
    assert events[-1].friction_low < MU < events[-1].friction_high
    assert events[-1].shear_x == pytest.approx(0.75 * MU * PART.sum(), rel=0.05)
    assert abs(events[-1].shear_y) < 0.05
    assert events[-1].load == pytest.approx(PART.sum(), rel=0.02)


def test_channels_that_are_read_one_after_the_other_tell_the_same_as_all_at_once() -> None:
    readings, _ = pull(0.9, noise=0.0)
    offset_s = np.linspace(0.0, 0.009, 27)
    at_s = np.arange(len(readings)) / RATE_HZ
    read = np.stack([np.interp(at_s + d, at_s, v) for d, v in zip(offset_s, readings.T, strict=True)], axis=1)

    def shear(volts: FloatArray, channel_offset_s: FloatArray | None) -> FloatArray:
        detector = GripDetector(xyz())
        detector.process(regular_block(volts[:300], RATE_HZ, channel_offset_s=channel_offset_s))
        assert detector.contact is not None
        return np.asarray(detector.contact.over_load)[:9]

    at_once = shear(readings, None)
    off_together = np.abs(shear(read, offset_s) - at_once).max()
    assert off_together < 0.15 * np.abs(shear(read, None) - at_once).max()


def test_every_scan_in_contact_has_an_event_whose_interval_narrows_while_the_zero_is_measured() -> None:
    readings, _ = pull(0.5)
    events = grips(GripDetector(xyz()).process(regular_block(readings, RATE_HZ)))
    times = [round(event.time_s * RATE_HZ) for event in events]
    assert times == list(range(times[0], len(readings)))
    assert 50 <= times[0] <= 56
    # The first ones may be of a load that is too small to tell.
    told = [event for event in events if event.valid]
    assert len(events) - len(told) <= 3
    assert all(event.valid or event.state == "unknown" for event in events)
    assert told == events[-len(told) :]
    widths = [event.utilisation_high - event.utilisation_low for event in told[:140]]
    assert widths[0] > widths[70]


def test_the_end_of_the_contact_is_said_once_and_the_friction_is_carried_on() -> None:
    readings, _ = pull(1.3)
    lifted = np.concatenate([readings, np.zeros((40, 27)), readings])
    events = grips(GripDetector(xyz()).process(regular_block(lifted, RATE_HZ)))
    states = [event.state for event in events]
    assert states.count("none") == 1
    again = events[states.index("none") + 1 :]
    spread = [math.log(e.friction_high / e.friction_low) for e in (events[0], again[0])]
    assert spread[1] < spread[0]


def test_a_contact_whose_load_is_too_small_to_tell_is_nothing_to_act_on() -> None:
    readings, _ = pull(1.3, noise=1e-5)
    events = grips(GripDetector(xyz()).process(regular_block(1e-2 * readings, RATE_HZ)))
    assert {(event.state, event.valid) for event in events} == {("unknown", False)}
    assert all(event.needed_load >= event.load for event in events)


@pytest.mark.parametrize("unit", [1e-3, 250.0])
def test_the_unit_of_the_readings_changes_nothing_but_the_unit(unit: float) -> None:
    readings, _ = pull(0.8)
    one = grips(GripDetector(xyz()).process(regular_block(readings, RATE_HZ)))
    other = grips(GripDetector(xyz(8.0 * unit)).process(regular_block(readings * unit, RATE_HZ)))
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert b.utilisation == pytest.approx(a.utilisation, abs=0.01)
        assert b.load == pytest.approx(a.load * unit, rel=1e-3)


def test_reset_and_a_board_that_begins_anew_equal_new() -> None:
    block = regular_block(pull(0.9)[0], RATE_HZ)
    detector = GripDetector(xyz())
    detector.process(block[:250])
    detector.reset()
    fresh = GripDetector(xyz()).process(block)
    assert detector.process(block) == fresh
    ends = detector.process(Gap(5, "restart", 400))
    assert [(event.topic, getattr(event, "state", ""), getattr(event, "valid", None)) for event in ends] == [
        ("slip", "end", False), ("contact", "none", False), ("grip", "none", False)
    ]  # fmt: skip
    assert detector.process(Gap(5, "missing", 400)) == []
    assert detector.process(block) == fresh


@pytest.mark.parametrize("value", [0.0, 1.2, -5.0, 1e308, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["wang2019-3x3", "normal-4x4", "xyz-two-pads-4x4"])
def test_constant_readings_are_never_gross(name: str, value: float) -> None:
    array = load_array(name)
    block = regular_block(np.full((300, array.n_channels), value), RATE_HZ)
    events = GripDetector(array).process(block)
    assert_finite(events)
    assert not any(event.state in ("gross", "partial") for event in grips(events))
    if not array.has_shear:
        assert grips(events) == []


@given(st.integers(0, 10**6), st.sampled_from([1e-6, 1e-3, 0.1, 10.0]), st.floats(0, 0.2))
@settings(max_examples=10, deadline=None)
def test_steps_noise_and_dropouts_give_finite_events(seed: int, size: float, dropped: float) -> None:
    rng = np.random.default_rng(seed)
    readings = 1.0 + size * np.sign(rng.normal(size=(200, 27))).cumsum(axis=0)
    readings[rng.random(readings.shape) < dropped] = np.nan
    valid = rng.random(readings.shape) >= dropped
    assert_finite(GripDetector(xyz()).process(regular_block(readings, RATE_HZ, valid=valid)))


def test_late_scans_and_missing_readings_are_not_valid() -> None:
    block = regular_block(pull(0.5)[0], RATE_HZ)
    late, valid = np.zeros(len(block), dtype=np.bool_), block.valid.copy()
    late[300:], valid[200, 4] = True, False
    block = ScanBlock(
        volts=block.volts, time_s=block.time_s, time_sd_s=block.time_sd_s, index=block.index, valid=valid,
        rate_hz=block.rate_hz, channel_offset_s=block.channel_offset_s, late=late,
    )  # fmt: skip
    events = {round(e.time_s * RATE_HZ): e for e in grips(GripDetector(xyz()).process(block))}
    assert not events[200].valid
    assert events[201].valid
    assert [events[299].late, events[300].late, events[300].valid] == [False, True, False]


def test_a_dead_channel_takes_its_taxel_out_and_the_rest_goes_on() -> None:
    readings, used = pull(0.9)
    valid = np.ones(readings.shape, dtype=np.bool_)
    valid[250:, 3] = False
    events = grips(GripDetector(xyz()).process(regular_block(readings, RATE_HZ, valid=valid)))
    by_scan = {round(e.time_s * RATE_HZ): e for e in events}
    assert [by_scan[k].valid for k in (249, 250, 254, 255, 256, 399)] == [
        True,
        False,
        False,
        True,
        True,
        True,
    ]
    assert by_scan[300].load == pytest.approx(PART.sum() - PART[1], rel=0.02)
    for scan in range(320, 399):
        event = by_scan[scan]
        assert event.utilisation_low - 0.05 <= used[scan] <= event.utilisation_high + 0.05
    assert events[-1].friction_low < MU < events[-1].friction_high


def test_too_many_dead_channels_are_not_valid() -> None:
    readings, _ = pull(0.9)
    valid = np.ones(readings.shape, dtype=np.bool_)
    valid[250:, [0, 4, 8]] = False
    events = grips(GripDetector(xyz()).process(regular_block(readings, RATE_HZ, valid=valid)))
    assert not any(e.valid for e in events if e.time_s > 2.505)


def test_a_narrow_prior_stays_narrow() -> None:
    widths = []
    for used in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        readings, _ = pull(used)
        wide, narrow = (
            grips(GripDetector(xyz(), params).process(regular_block(readings, RATE_HZ)))[-1]
            for params in (GripParams(), GripParams(friction=MU, friction_log_sd=0.1))
        )
        for event in (narrow, wide):
            assert event.utilisation_low <= used <= event.utilisation_high
        assert math.log(narrow.friction_high / narrow.friction_low) < 0.5
        widths.append([event.utilisation_high - event.utilisation_low for event in (narrow, wide)])
    of_narrow, of_wide = np.mean(widths, axis=0)
    assert of_narrow < 0.85 * of_wide


def test_another_rate_ends_the_contact() -> None:
    readings, _ = pull(0.5)
    detector = GripDetector(xyz())
    detector.process(regular_block(readings, RATE_HZ))
    first = grips(detector.process(regular_block(readings, 2 * RATE_HZ)))[0]
    assert (first.state, first.valid) == ("none", False)


def test_newtons_are_called_newtons() -> None:
    array = dataclasses.replace(xyz(), unit="N")
    events = grips(GripDetector(array).process(regular_block(pull(0.5)[0], RATE_HZ)))
    assert {event.unit for event in events} == {"N"}

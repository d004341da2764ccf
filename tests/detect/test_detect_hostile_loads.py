"""Loads that no healthy contact makes: zero, negative, tiny and huge pressures, channels that fail.

Every suite answers with finite numbers or says nothing; warnings of numpy are errors here.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import Touch, assert_sound, slips

from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.samples.block import Gap, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
ARRAYS = [ARRAY, load_array("normal-4x4"), load_array("xyz-two-pads-4x4")]
RATES_HZ = [0.1, 5.0, 35.7, 100.0, 1000.0, 20_000.0]
# Volts: nothing, less than a step of the grid, one step, noise, touches, full scale, beyond it.
LEVELS_VOLTS = [0.0, 1e-9, 1e-6, 1e-3, 0.1, 0.26, 0.6, 1.2, 3.0, 7.9, 8.0, 1e6]
ALL = 2**16 - 1


class Load(NamedTuple):
    """What the array reads at one instant: pressure of each taxel, and shear along x and y, in volts."""

    n_scans: int  # in which it comes
    level: float
    other: float  # of taxels that are not `pressed`
    pressed: int  # bit k: taxel k; counted round
    shear_x: float
    shear_y: float


class Fault(NamedTuple):
    """Readings that are bad for some scans."""

    value: float
    is_flagged: bool
    first: float  # part of all scans
    length: int
    every: int  # so many channels


signed = st.sampled_from([*LEVELS_VOLTS, *(-volts for volts in LEVELS_VOLTS)])
loads = st.lists(
    st.builds(Load, st.integers(1, 120), signed, signed, st.just(ALL) | st.integers(0, ALL), signed, signed),
    min_size=2,
    max_size=7,
)
# A healthy touch, so that the contact's beginning is seen and what follows can be slip.
TOUCH = [
    Load(n_scans, volts, volts, ALL, 0.0, 0.0)
    for n_scans, volts in ((1, 0.0), (60, 0.0), (60, 1.2), (60, 1.2))
]
courses = st.builds(
    lambda begin, course, times: begin + course * times,
    st.sampled_from([[], TOUCH]),
    loads,
    st.sampled_from([1, 1, 4]),
)
faults = st.lists(
    st.builds(
        Fault,
        st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 3.0, 8.0, 1e300]),
        st.booleans(),
        st.floats(0, 1),
        st.integers(1, 150),
        st.integers(1, 5),
    ),
    max_size=3,
)


def pressures(array: Array, load: Load) -> FloatArray:
    is_pressed = np.array([load.pressed >> taxel % 16 & 1 for taxel in range(array.n_taxels)], dtype=np.bool_)
    return np.where(is_pressed, load.level, load.other)


def readings(array: Array, course: Sequence[Load], noise: float, seed: int) -> FloatArray:
    """Volts (n, channels) that go in straight lines from one load to the next."""
    normal = array.normal_weights() != 0
    shear = np.sign(array.shear_weights()).sum(axis=1)
    knots = [
        pressures(array, load) @ normal + load.shear_x * shear[0] + load.shear_y * shear[1] for load in course
    ]
    at = np.cumsum([load.n_scans for load in course]) - course[0].n_scans
    scans = np.arange(at[-1] + 1)
    volts = np.stack([np.interp(scans, at, channel) for channel in np.array(knots).T], axis=1)
    return np.asarray(volts + noise * np.random.default_rng(seed).normal(size=volts.shape))


def with_faults(volts: FloatArray, rate_hz: float, broken: Sequence[Fault]) -> ScanBlock:
    volts, valid = volts.copy(), np.ones(volts.shape, dtype=np.bool_)
    for fault in broken:
        first = int(fault.first * len(volts))
        part = np.s_[first : first + fault.length, :: fault.every]
        volts[part] = fault.value
        valid[part] &= not fault.is_flagged
    return regular_block(volts, rate_hz, valid=valid)


def with_gap(block: ScanBlock, at: float, n_missing: int) -> list[ScanBlock | Gap]:
    cut = int(at * len(block))
    if not 0 < cut < len(block):
        return [block]
    after = block[cut:]
    late = dataclasses.replace(
        after, time_s=after.time_s + n_missing / block.rate_hz, index=after.index + n_missing
    )
    return [block[:cut], Gap(n_missing, "missing", int(late.index[0])), late]


def one_taxel_up_eight_down(shear_volts: float = 0.4, n: int = 1200) -> FloatArray:
    """The log that ended in a traceback: one taxel at 0.6 V, eight at -0.3 V, then shear grows on all."""
    pressed = np.where(np.arange(9) == 4, 0.6, -0.3) @ (ARRAY.normal_weights() != 0)
    shear = np.sign(ARRAY.shear_weights()).sum(axis=1)[0]
    t = np.arange(n) / 100
    grown = shear_volts * (1 - np.exp(-np.clip(t - 6, 0, None) / 0.3))
    noise = np.random.default_rng(0).normal(0, 3e-4, (n, 36))
    return np.asarray(np.outer(np.clip((t - 0.5) / 1.0, 0, 1), pressed) + np.outer(grown, shear) + noise)


@pytest.mark.parametrize("setting", ["fast", "balanced", "quiet", "wang2019"])
def test_a_mean_pressure_below_zero_is_no_load_that_shear_could_be_compared_with(setting: str) -> None:
    suite = build_suite(ARRAY, DetectParams(setting=setting))
    events = suite.process(regular_block(one_taxel_up_eight_down(), 100.0))
    assert_sound(events)
    assert [event.topic for event in events][:1] == ["contact"]
    if setting != "wang2019":
        assert slips(events) == []


@given(
    array=st.sampled_from(ARRAYS),
    setting=st.sampled_from(["fast", "balanced", "quiet", "wang2019"]),
    rate_hz=st.sampled_from(RATES_HZ),
    course=courses,
    noise=st.sampled_from([0.0, 1e-6, 3e-4, 0.05]),
    seed=st.integers(0, 10**6),
    broken=faults,
    cut=st.floats(0, 1),
    n_missing=st.sampled_from([1, 4, 20, 150]),
    speed_mm_s=st.sampled_from([0.0, 1.0, 50.0]),
)
@settings(max_examples=30, deadline=None)
def test_any_course_of_loads_gives_finite_events(
    array: Array,
    setting: str,
    rate_hz: float,
    course: list[Load],
    noise: float,
    seed: int,
    broken: list[Fault],
    cut: float,
    n_missing: int,
    speed_mm_s: float,
) -> None:
    suite = build_suite(array, DetectParams(setting=setting))
    assert suite.texture is not None
    suite.texture.set_speed(speed_mm_s, 0)
    block = with_faults(readings(array, course, noise, seed), rate_hz, broken)
    for item in with_gap(block, cut, n_missing):
        assert_sound(suite.process(item))


def test_swings_are_followed_over_scans_in_which_no_taxel_is_read() -> None:
    """A slip that goes back and forth, while every reading is invalid for a while."""
    t = np.arange(900) / 100
    swings = 0.5 * np.sin(2 * np.pi * 1.5 * t) * (t > 2)
    pressed = np.outer(np.clip((t - 0.5) / 0.5, 0, 1), (ARRAY.normal_weights() != 0).any(axis=0))
    volts = pressed + np.outer(swings, np.sign(ARRAY.shear_weights()).sum(axis=1)[0])
    volts += np.random.default_rng(0).normal(0, 3e-4, volts.shape)
    valid = np.ones(volts.shape, dtype=np.bool_)
    valid[620:640] = False
    events = build_suite(ARRAY, DetectParams(setting="fast")).process(
        regular_block(volts, 100.0, valid=valid)
    )
    assert_sound(events)
    onsets_s = [event.detected_s for event in slips(events) if event.state == "onset"]
    assert onsets_s[0] < 2.2
    assert any(6.4 < onset_s < 6.6 for onset_s in onsets_s)


@pytest.mark.parametrize("rate_hz", [1000.0, 20_000.0])
def test_slip_is_told_where_scans_come_faster_than_filters_reach(rate_hz: float) -> None:
    touch = Touch(
        press_s=0.1, press_takes_s=0.1, slide_s=0.4, stop_s=9, lift_s=9, end_s=0.8, shear_takes_s=0.02
    )
    events = build_suite(ARRAY, DetectParams()).process(touch.block(ARRAY, rate_hz))
    assert slips(events)
    assert_sound(events)


@pytest.mark.parametrize("setting", ["balanced", "wang2019"])
def test_a_turn_is_told_where_scans_come_fast(setting: str) -> None:
    t = np.arange(12_000) / 5000.0
    pressed = np.outer(np.clip((t - 0.05) / 0.1, 0, 1), (ARRAY.normal_weights() != 0).any(axis=0))
    x, y = np.clip((t - 0.6) / 0.05, 0, 1) * (t < 1.2) * 0.5, np.clip((t - 1.2) / 0.005, 0, 1) * 0.5
    volts = pressed + np.stack([x, y], axis=1) @ np.sign(ARRAY.shear_weights()).sum(axis=1)
    volts += np.random.default_rng(0).normal(0, 1e-4, volts.shape)
    events = build_suite(ARRAY, DetectParams(setting=setting)).process(regular_block(volts, 5000.0))
    assert slips(events)
    assert_sound(events)


def test_a_gap_that_a_wrong_rate_makes_shorter_than_nothing_tells_nothing() -> None:
    """Rows 10 ms apart that are said to come at 20 Hz, and 75 ms between two of them."""
    block = dataclasses.replace(Touch(stop_s=5.0, lift_s=5.5, end_s=6.0).block(ARRAY, 100.0), rate_hz=20.0)
    before, after = block[:400], block[408:]
    after = dataclasses.replace(after, index=after.index + 1)
    suite = build_suite(ARRAY, DetectParams(setting="fast"))
    events = [
        e for item in (before, Gap(9, "missing", int(after.index[0])), after) for e in suite.process(item)
    ]
    assert_sound(events)
    assert [e for e in slips(events) if e.onset_s < before.time_s[-1]] == []


def test_readings_that_are_no_numbers_beside_a_short_gap() -> None:
    block = regular_block(np.full((60, 36), 0.6), 100.0)
    volts = block.volts.copy()
    volts[29], volts[30] = np.inf, -np.inf
    block = dataclasses.replace(block, volts=volts, valid=np.isfinite(volts))
    after = dataclasses.replace(block[30:], index=block.index[30:] + 2)
    suite = build_suite(ARRAY, DetectParams())
    for item in (block[:30], Gap(2, "missing", int(after.index[0])), after):
        assert_sound(suite.process(item))

"""Slip without a load to compare with: growth of shear or field beyond what the hold before had."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from touches import pieces, run, splits

from tactiled.array import Array, ArrayFile, FloatArray, build
from tactiled.detect.base import Detector
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.tomlfile import parse

RATE_HZ = 100.0
N = 1200
T = np.arange(N) / RATE_HZ
SHEAR, FIELD = ("shear_x", "shear_y"), ("shear_x", "shear_y", "normal")
UNITS = {SHEAR: ("N", -20, 20), FIELD: ("uT", -5000, 5000)}
kinds_of = pytest.mark.parametrize("kinds", [SHEAR, FIELD], ids=["shear alone", "magnetic"])


@functools.cache
def skin(kinds: tuple[str, ...]) -> Array:
    unit, low, high = UNITS[kinds]
    channels = [{"name": kind, "kind": kind} for kind in kinds]
    document = {"name": "skin", "unit": unit, "range": [low, high], "taxel_count": 5}
    return build(parse({**document, "taxel_channels": channels}, ArrayFile, "test"))


def held(kinds: tuple[str, ...], seed: int, shear: FloatArray, normal: FloatArray | float = 0.0) -> ScanBlock:
    """Return a hold with creep, tremor and noise, and what is added to shear_x and to the normal channels."""
    rng = np.random.default_rng(seed)
    unit = 1.0 if kinds == FIELD else 0.005  # of the noise
    tremor = np.convolve(rng.standard_normal(N + 40), np.hanning(40), "valid")[:N]
    n_channels = 5 * len(kinds)
    still = 5 * rng.standard_normal(n_channels) * np.log1p(T)[:, np.newaxis]
    still = still + 0.5 * tremor[:, np.newaxis] * rng.standard_normal(n_channels)
    added = {"shear_x": shear, "shear_y": 0.3 * shear, "normal": normal + 0.2 * shear}
    gains = rng.uniform(0.5, 1.5, 5)
    moved = np.stack([added[kind] for kind in kinds], axis=-1)[:, np.newaxis] * gains[:, np.newaxis]
    noise = rng.standard_normal((N, n_channels))
    return regular_block(unit * (300 + still + moved.reshape(N, -1) + noise), RATE_HZ)


def detector(kinds: tuple[str, ...]) -> Detector:
    return build_suite(skin(kinds), DetectParams(), topics=("slip", "contact"))


def slips(events: list[Event]) -> list[SlipEvent]:
    return [event for event in events if isinstance(event, SlipEvent)]


def onset_after(time_s: float, events: list[Event]) -> SlipEvent | None:
    onsets = [event for event in slips(events) if event.state == "onset" and event.detected_s > time_s]
    return onsets[0] if onsets else None


def tug(sign: float = 1.0) -> FloatArray:
    return np.asarray(sign * 100 * np.clip((T - 6) / 0.5, 0, 1))


@kinds_of
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tug_is_one_slip_of_either_sign(kinds: tuple[str, ...], sign: float) -> None:
    onset, end = slips(detector(kinds).process(held(kinds, 1, tug(sign))))
    assert (onset.state, onset.kind, end.state) == ("onset", "incipient", "end")
    assert 6 < onset.detected_s < 6.4
    assert abs(onset.onset_s - 6) < 4 * onset.onset_sd_s
    assert 0.5 < onset.confidence < 1.0
    assert 6.5 < end.detected_s < 7.5


@kinds_of
@pytest.mark.parametrize("seed", range(4))
def test_creep_tremor_and_taps_are_no_slip(kinds: tuple[str, ...], seed: int) -> None:
    taps = 60.0 * (np.abs(T[:, np.newaxis] - np.array([4.0, 7.0, 9.5])) < 0.03).any(axis=1)
    assert slips(detector(kinds).process(held(kinds, seed, taps))) == []


@kinds_of
@pytest.mark.parametrize("takes_s", [0.01, 1.5])
def test_a_step_of_one_channel_is_no_slip(kinds: tuple[str, ...], takes_s: float) -> None:
    """A loose contact or a chip at fault: a tug shows in more channels than one."""
    unit, n_channels = (1.0 if kinds == FIELD else 0.005), 5 * len(kinds)
    readings = 300 + np.random.default_rng(1).standard_normal((2 * N, n_channels))
    readings[:, 4] += 100 * np.clip((np.arange(2 * N) / RATE_HZ - 12) / takes_s, 0, 1)
    assert slips(detector(kinds).process(regular_block(unit * readings, RATE_HZ))) == []


@kinds_of
def test_a_press_in_the_hold_does_not_hide_a_slow_tug(kinds: tuple[str, ...]) -> None:
    press = 1000 * np.clip((T - 0.5) / 0.5, 0, 1)
    slow = 100 * np.clip((T - 5.5) / 3, 0, 1)
    after = [
        onset_after(3.0, detector(kinds).process(held(kinds, 3, added))) for added in (press, press + slow)
    ]
    assert after[0] is None
    assert after[1] is not None
    assert 5.5 < after[1].detected_s < 6.5


def test_a_press_is_no_slip_where_normal_channels_show_it() -> None:
    press = 150 * np.clip((T - 6) / 0.5, 0, 1)
    assert slips(detector(FIELD).process(held(FIELD, 2, 0.3 * press, press))) == []
    assert slips(detector(FIELD).process(held(FIELD, 2, press))) != []


@kinds_of
def test_a_tug_a_second_after_the_log_begins_is_found_and_a_weak_one_waits_for_the_hold(
    kinds: tuple[str, ...],
) -> None:
    """Of a hold that is not known yet, creep and tremor are taken to be large."""
    strong, weak = (size * np.clip((T - 1.0) / 0.5, 0, 1) for size in (200.0, 12.0))
    onset = slips(detector(kinds).process(held(kinds, 1, strong)))[0]
    assert 1.0 < onset.detected_s < 1.5
    assert onset_after(0.0, detector(kinds).process(held(kinds, 1, weak))) is None


def test_a_slip_is_found_in_scans_that_are_a_second_apart() -> None:
    time_s = np.arange(120.0)[:, np.newaxis]
    field = 300 + np.random.default_rng(0).standard_normal((120, 15)) + 100 * np.clip((time_s - 60) / 3, 0, 1)
    onset, end = slips(detector(FIELD).process(regular_block(field, 1.0)))
    assert (onset.state, onset.detected_s) == ("onset", 61.0)
    assert (end.state, end.detected_s) == ("end", 64.0)


@pytest.mark.parametrize("rate_hz", [9.5, 31.0, 400.0])
def test_times_are_seconds_at_any_rate(rate_hz: float) -> None:
    rng, n = np.random.default_rng(0), round(12 * rate_hz)
    time_s = np.arange(n)[:, np.newaxis] / rate_hz
    field = 300 + rng.standard_normal((n, 15)) + 100 * np.clip((time_s - 6) / 0.5, 0, 1)
    onset, end = slips(detector(FIELD).process(regular_block(field, rate_hz)))
    assert (onset.state, end.state) == ("onset", "end")
    assert 6.0 < onset.detected_s < 6.6
    assert 6.5 < end.detected_s < 7.8


@kinds_of
def test_any_chunking_and_a_restart_give_the_same_slips(kinds: tuple[str, ...]) -> None:
    block = held(kinds, 1, tug())
    whole = detector(kinds).process(block)
    seen = detector(kinds)
    seen.process(block[:640])
    assert [event.valid for event in slips(seen.process(Gap(5, "restart", 5000)))] == [False]
    assert seen.process(block) == whole

    @given(splits(len(block)))
    @settings(max_examples=5, deadline=None)
    def check(cuts: list[int]) -> None:
        assert run(detector(kinds), pieces(block, cuts)) == whole

    check()


def test_a_field_has_no_grip_message_because_it_is_no_load() -> None:
    pull = 200 * np.clip(T - 6, 0, 1)
    block = held(FIELD, 0, pull, normal=1000 * np.clip(T - 1, 0, 1))
    events = build_suite(skin(FIELD), DetectParams()).process(block)
    assert {event.topic for event in events} == {"contact", "slip", "texture"}

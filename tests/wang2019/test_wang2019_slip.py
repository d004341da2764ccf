"""The published slip rule on touches with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from touches import LSB, Touch, contact_states, onsets, run, slips

from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.signal.wavelet import border_scans
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.wang2019.slip import WaveletSlip, level_at

WANG = load_array("wang2019-3x3")
XYZ = load_array("xyz-two-pads-4x4")
PLAIN = load_array("normal-4x4")
START_S = 100.0  # of every block of a Touch


def detect(block: ScanBlock, array: Array = WANG) -> list[Event]:
    return WaveletSlip(array).process(block)


def hold(n: int, array: Array = WANG, seed: int = 0, noise: float = 0.3e-3, level: float = 1.2) -> FloatArray:
    volts = level + noise * np.random.default_rng(seed).normal(size=(n, array.n_channels))
    quantised: FloatArray = np.floor(volts / LSB + 0.5) * LSB
    return quantised


def off(angle_deg: float, truth_deg: float) -> float:
    return abs((angle_deg - truth_deg + 180) % 360 - 180)


@pytest.mark.parametrize("array", [WANG, XYZ], ids=lambda array: array.name)
@pytest.mark.parametrize("direction_deg", range(-135, 181, 45))
def test_press_hold_slide_stop_is_one_slip_in_its_direction(array: Array, direction_deg: float) -> None:
    touch = Touch(direction_deg=direction_deg)
    events = detect(touch.block(array), array)
    onset, end = slips(events)
    assert (onset.state, end.state) == ("onset", "end")
    assert off(onset.direction_deg, direction_deg) <= max(1.0, 3 * onset.direction_sd_deg)
    assert abs(onset.onset_s - START_S - touch.slide_s) <= 3 * onset.onset_sd_s
    assert onset.time_s == onset.onset_s <= onset.detected_s <= START_S + touch.slide_s + 0.2
    assert onset.statistic >= onset.threshold == 0.002
    assert onset.valid
    assert end.valid
    assert abs(end.time_s - START_S - touch.stop_s) <= 0.2
    assert contact_states(events) == ["loading", "holding", "sliding", "holding", "none"]


def test_onset_sigma_covers_onsets_of_other_shapes() -> None:
    errors = []
    for seed, takes_s in enumerate([0.02, 0.05, 0.1, 0.2, 0.4, 0.8]):
        for at in (4.0, 4.003, 4.007):
            touch = Touch(shear_takes_s=takes_s, slide_s=at, seed=seed)
            (onset,) = onsets(detect(touch.block(WANG)))
            errors.append((onset.onset_s - START_S - at) / onset.onset_sd_s)
    assert np.sqrt(np.mean(np.square(errors))) <= 1.0
    assert np.abs(errors).max() <= 3.0


@pytest.mark.parametrize("array", [WANG, XYZ, PLAIN], ids=lambda array: array.name)
@pytest.mark.parametrize("takes_s", [0.2, 1.0, 3.0])
def test_loading_to_holding_is_not_slip(array: Array, takes_s: float) -> None:
    touch = Touch(press_takes_s=takes_s, slide_s=99.0, stop_s=100.0)
    events = detect(touch.block(array), array)
    assert slips(events) == []
    assert contact_states(events) == ["loading", "holding", "none"]


@pytest.mark.parametrize("array", [WANG, XYZ, PLAIN], ids=lambda array: array.name)
def test_a_change_of_load_in_a_hold_is_not_slip(array: Array) -> None:
    touch = Touch(slide_s=99.0, stop_s=100.0, lift_s=99.0, more_s=5.0)
    events = detect(touch.block(array), array)
    assert slips(events) == []
    assert contact_states(events) == ["loading", "holding", "loading", "holding"]


@pytest.mark.parametrize("rate_hz", [20.0, 35.7, 60.0, 250.0, 1000.0])
def test_works_at_other_rates(rate_hz: float) -> None:
    touch = Touch(direction_deg=90.0)
    (onset,) = onsets(detect(touch.block(WANG, rate_hz)))
    assert abs(onset.onset_s - START_S - touch.slide_s) <= 3 * onset.onset_sd_s
    assert off(onset.direction_deg, 90.0) < 2.0
    # One level's span in seconds is never far from level 3's at 100 Hz.
    assert 0.15 <= border_scans(level_at(rate_hz)) / rate_hz <= 0.6


def test_an_array_without_shear_has_no_slip() -> None:
    events = detect(Touch().block(PLAIN, 35.7), PLAIN)
    assert slips(events) == []
    assert contact_states(events)[0] == "loading"


@pytest.mark.parametrize(
    "volts",
    [
        np.zeros((3000, 36)),
        np.full((3000, 36), 1.2),
        np.full((3000, 36), 3.0),
        np.full((3000, 36), np.nan),
        1.2 + LSB * (np.random.default_rng(1).random((3000, 36)) < 0.5),
        1.2 + LSB * ((np.arange(3000)[:, np.newaxis] // 7 + np.arange(36)) % 2),
        1.2 + 0.3 * np.arange(3000)[:, np.newaxis] / 3000 * np.where(np.arange(36) % 4 == 0, 1.0, -1.0),
        hold(60_000),
    ],
    ids=["zeros", "constant", "full-scale", "nan", "random-lsb", "regular-lsb", "opposed-drift", "noise"],
)
def test_does_not_fire_on(volts: FloatArray) -> None:
    assert slips(detect(regular_block(volts, 100.0))) == []


def test_below_half_a_volt_nothing_is_analysed() -> None:
    assert detect(Touch(level=0.45, shear=0.2).block(WANG)) == []


def test_a_lift_ends_a_slip() -> None:
    touch = Touch(stop_s=99.0, lift_s=8.0)
    onset, end = slips(detect(touch.block(WANG)))
    assert (onset.state, end.state) == ("onset", "end")
    assert end.time_s == pytest.approx(START_S + 8.0, abs=0.011)


def test_a_steady_slide_goes_on_and_two_slides_are_two() -> None:
    touch = Touch(stop_s=60.0, lift_s=63.0, end_s=64.0)
    onset, end = slips(detect(touch.block(WANG)))
    assert end.time_s - onset.time_s == pytest.approx(56.0, abs=0.2)
    first = touch.volts(WANG, 100.0)[: round(62.9 * 100)]
    again = replace(Touch(slide_s=0.4, stop_s=5.0, lift_s=99.0), press_s=-9.0).volts(WANG, 100.0)
    # The second slide builds on the shear that the first has left.
    second = again - again[0] + first[-1]
    states = [e.state for e in slips(detect(regular_block(np.concatenate([first, second]), 100.0)))]
    assert states == ["onset", "end", "onset", "end"]


@pytest.mark.parametrize("period_mm", [0.9, 1.2, 1.5, 3.0])
@pytest.mark.parametrize("speed_mm_s", [0.25, 1.0, 5.0])
def test_ripple_of_grooves_does_not_end_or_repeat_a_slip(period_mm: float, speed_mm_s: float) -> None:
    touch = Touch(grooves=(period_mm, 20.0), speed_mm_s=speed_mm_s, stop_s=30.0, lift_s=33.0, end_s=34.0)
    onset, end = slips(detect(touch.block(WANG)))
    assert abs(onset.onset_s - START_S - 4.0) <= 3 * onset.onset_sd_s
    assert abs(end.time_s - START_S - 30.0) <= 0.5


@pytest.mark.parametrize("dead", [[0], [0, 1, 2, 3], [5, 9, 22], list(range(0, 36, 4))])
@pytest.mark.parametrize("since_s", [0.0, 4.3])
def test_channels_that_drop_out_take_their_taxel_with_them(dead: list[int], since_s: float) -> None:
    touch = Touch()
    volts = touch.volts(WANG, 100.0)
    volts[round(since_s * 100) :, dead] = np.nan
    found = slips(detect(regular_block(volts, 100.0)))
    if len(dead) == WANG.n_taxels and since_s == 0.0:
        assert found == []  # no taxel is whole: nothing opposes anything
        return
    onset, end = found
    assert off(onset.direction_deg, 0.0) < 2.0
    assert abs(onset.onset_s - touch.slide_s) <= 3 * onset.onset_sd_s
    assert abs(end.time_s - touch.stop_s) <= 0.2


def test_saturated_channels_do_not_hide_the_contact() -> None:
    volts = Touch().volts(WANG, 100.0) * 4
    clipped = np.minimum(volts, 3.0)
    block = regular_block(clipped, 100.0, valid=clipped < 3.0)
    events = detect(block)
    assert contact_states(events)[0] == "loading"
    assert contact_states(events)[-1] == "none"


def test_late_scans_raise_nothing_fresh() -> None:
    block = replace(Touch().block(WANG), late=np.ones(1100, dtype=np.bool_))
    events = detect(block)
    assert len(slips(events)) == 2
    assert not any(event.valid for event in slips(events))


def test_a_gap_ends_a_slip_invalidly_and_forgets() -> None:
    block = Touch().block(WANG)
    detector = WaveletSlip(WANG)
    assert onsets(detector.process(block[:500]))
    end, lost = detector.process(Gap(3, "missing", 510))
    assert slips([end])[0].state == "end"
    assert not slips([end])[0].valid
    assert end.time_s == block.time_s[499]
    assert contact_states([lost]) == ["none"]
    assert detector.contact_state == "none"
    assert detector.process(Gap(3, "missing", 520)) == []
    assert detector.process(block) == WaveletSlip(WANG).process(block)


def test_a_new_rate_without_a_gap_is_a_gap() -> None:
    detector = WaveletSlip(WANG)
    detector.process(Touch().block(WANG)[:500])
    slow = Touch().block(WANG, 50.0)
    events = detector.process(slow)
    assert [event.state for event in slips(events)] == ["end", "onset", "end"]
    assert events[2:] == WaveletSlip(WANG).process(slow)


def test_onset_comes_with_its_scan_not_with_its_block() -> None:
    block = Touch().block(WANG)
    live = WaveletSlip(WANG)
    for scan in range(len(block)):
        if found := onsets(run(live, [block[scan : scan + 1]])):
            assert found[0].detected_s == block.time_s[scan]
            return
    pytest.fail("no slip")

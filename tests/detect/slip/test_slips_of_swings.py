"""Events of one slip and of several in a row: no chatter, no repetition, no loss."""

import numpy as np
import pytest
from hypothesis import given, settings
from touches import pieces, run, slip_detector, slips, splits

from tactiled.array import ArrayFile, FloatArray, Grid, TaxelChannel, build, load_array
from tactiled.detect.grip.slip_detector import SETTINGS
from tactiled.events.types import SlipEvent
from tactiled.samples.block import ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
SHEAR = np.sign(ARRAY.shear_weights().sum(axis=1))  # (2, channels)


def held(shear: FloatArray, direction_deg: float = 30.0, seed: int = 2) -> ScanBlock:
    """A press of 1.2 V over half a second, and shear (n,) in volts by which opposed channels move."""
    theta = np.radians(direction_deg)
    t = np.arange(len(shear))[:, np.newaxis] / 100.0
    volts = 1.2 * np.clip((t - 0.5) / 0.5, 0, 1)
    volts = volts + shear[:, np.newaxis] * (np.cos(theta) * SHEAR[0] + np.sin(theta) * SHEAR[1])
    return regular_block(volts + 1e-3 * np.random.default_rng(seed).normal(size=volts.shape), 100.0)


def said(block: ScanBlock, setting: str = "balanced") -> list[SlipEvent]:
    return slips(slip_detector(ARRAY, setting).process(block))


def words(events: list[SlipEvent]) -> list[str]:
    return [event.kind if event.state == "onset" else "end" for event in events]


def ramp(t: FloatArray, start_s: float, takes_s: float) -> FloatArray:
    return np.asarray(np.clip((t - start_s) / takes_s, 0, 1))


T = np.arange(1000) / 100.0


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize(("hz", "volts"), [(0.5, 0.3), (2.0, 0.15), (2.0, 0.3), (7.0, 0.3), (1.0, 0.6)])
def test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip(
    hz: float, volts: float, setting: str
) -> None:
    t = np.arange(3000) / 100.0
    events = said(held(volts * np.sin(2 * np.pi * hz * t) * (t > 5) * (t < 25)), setting)
    onsets = [event for event in events if event.state == "onset"]
    assert 0 < len(onsets) <= 8
    assert onsets[-1].detected_s < 9.5
    assert events[-1].state == "end"
    assert events[-1].time_s == pytest.approx(25, abs=0.3)


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("hz", [0.2, 0.35, 0.5])
def test_a_load_that_sways_below_friction_is_reported_at_most_twice(hz: float, setting: str) -> None:
    t = np.arange(3000) / 100.0
    sway = 0.15 * np.sin(2 * np.pi * hz * (t - 5)) * (t > 5)
    events = said(held(sway), setting)
    onsets = [event for event in events if event.state == "onset"]
    assert len(onsets) <= 2
    assert all(event.kind == "incipient" and event.detected_s < 8 for event in onsets)
    slides = said(held(sway + 0.9 * ramp(t, 25, 0.3)), setting)
    assert any(event.kind == "gross" and 25 < event.detected_s < 25.5 for event in slides)


@pytest.mark.parametrize("hz", [2.5, 3.0, 3.5])
@pytest.mark.parametrize("swing", [0.1, 0.15, 0.2])
def test_a_shake_that_is_outgrown_has_not_hidden_the_slip(swing: float, hz: float) -> None:
    """The slip is found both after reported and after unreported swings."""
    t = np.arange(1400) / 100.0
    shake = swing * np.sin(2 * np.pi * hz * t) * (t > 5)
    events = said(held(shake + 0.9 * ramp(t, 12, 0.3)))
    late = [event for event in events if event.state == "onset" and event.detected_s > 11.9]
    assert late
    assert late[0].detected_s < 12.3


@pytest.mark.parametrize("takes_s", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("setting", SETTINGS)
def test_a_load_that_is_taken_off_after_gross_slip_is_no_slip(takes_s: float, setting: str) -> None:
    slides = 0.6 * ramp(T, 4, 0.2) * (1 - ramp(T, 7, takes_s))
    assert words(said(held(slides), setting)) == ["incipient", "gross", "end"]


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("seed", range(5))
def test_gross_slip_is_said_within_50_ms_where_shear_leaves_no_doubt(setting: str, seed: int) -> None:
    drag = 0.6 * (1 - (1 - ramp(T, 4, 0.3)) ** 1.5)  # Mindlin's curve: nine tenths slip at 4.27 s
    (gross,) = (event for event in said(held(drag, seed=seed), setting) if event.kind == "gross")
    assert 4.27 <= gross.detected_s < 4.32
    assert abs(gross.onset_s - 4.27) < 2 * gross.onset_sd_s < 0.04


def test_a_slide_that_turns_back_ends_and_is_another() -> None:
    events = said(held(0.6 * ramp(T, 4, 0.2) - 1.2 * ramp(T, 7, 0.2)))
    assert words(events) == ["incipient", "gross", "end", "incipient", "gross"]
    assert events[3].detected_s < 7.2


def test_a_slip_after_the_load_was_taken_off_is_another() -> None:
    slides = 0.6 * ramp(T, 4, 0.2) * (1 - ramp(T, 6, 0.2)) + 0.6 * ramp(T, 8, 0.2)
    events = said(held(slides))
    assert words(events) == ["incipient", "gross", "end", "incipient", "gross"]
    assert 8 < events[3].detected_s < 8.1


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_load_that_rested_where_it_looked_gross_and_grows_again_is_told(setting: str) -> None:
    events = said(held(0.42 * ramp(T, 4, 1.0) + 0.12 * ramp(T, 7, 0.2)), setting)
    assert any(event.state == "onset" and 7 < event.detected_s < 7.25 for event in events)


def test_two_slips_50_ms_apart_are_two_where_the_skin_springs_back_in_between() -> None:
    """Without a recoil nothing in the signal says that the first has stopped."""
    first, second = 0.3 * ramp(T, 4, 0.05) - 0.2 * ramp(T, 4.1, 0.03), 0.3 * ramp(T, 4.18, 0.05)
    events = said(held(first + second))
    assert words(events) == ["incipient", "gross", "end", "incipient", "gross"]
    assert events[3].detected_s < 4.25
    without = 0.3 * ramp(T, 4, 0.05) + 0.3 * ramp(T, 4.1, 0.05)
    assert words(said(held(without))) == ["incipient", "gross"]


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("shear", [0.6, 1.2])
def test_many_taxels_are_gross_with_and_without_noise(noise: float, shear: float) -> None:
    """Equal loads and no noise: no slope over the loads may come of rounding."""
    sides = [TaxelChannel(name=f"R{k}", kind="side", azimuth_deg=180.0 + 90 * k) for k in range(4)]
    places = [3.5 * k for k in range(8)]
    array = build(ArrayFile(name="square", grids=[Grid(x_mm=places, y_mm=places)], taxel_channels=sides))
    t = T[:600, np.newaxis]
    along = np.sign(array.shear_weights().sum(axis=1))[0]
    volts = 1.2 * np.clip((t - 0.5) / 0.5, 0, 1) + shear * np.clip((t - 4) / 0.2, 0, 1) * along
    volts = volts + noise * np.random.default_rng(1).normal(size=volts.shape)
    events = slips(slip_detector(array).process(regular_block(volts, 100.0)))
    assert words(events) == ["incipient", "gross"]


SHAKE = held(0.3 * np.sin(2 * np.pi * 2 * T) * (T > 4) * (T < 7))


@given(cuts=splits(len(SHAKE)))
@settings(deadline=None, max_examples=5)
def test_a_shake_is_the_same_however_it_is_cut(cuts: list[int]) -> None:
    pieced = run(slip_detector(ARRAY), pieces(SHAKE, cuts))
    assert pieced == slip_detector(ARRAY).process(SHAKE)

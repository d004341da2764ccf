"""Slips in a row, slips that turn back, and swings: each onset has one end, and never two slips are open."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from touches import onsets, pieces, run, slip_detector, slips, splits, uneven_friction

from tactiled.array import FloatArray, load_array
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import SlipEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.wire.layout import load_layout

LAYOUT = load_layout("board-v1")
ARRAY = load_array("wang2019-3x3")
SHEAR = np.sign(ARRAY.shear_weights().sum(axis=1))  # (2, channels)
T = np.arange(1000) / 100.0


def ramp(start_s: float, takes_s: float) -> FloatArray:
    return np.asarray(np.clip((T - start_s) / takes_s, 0, 1))


def held(shear: FloatArray, slides_s: tuple[tuple[float, float], ...] = (), seed: int = 2) -> ScanBlock:
    """A press of 1.2 V, shear (n,) in volts, and the intervals in which the contact slides."""
    theta = np.radians(30.0)
    motion = shear[:, np.newaxis] * (np.cos(theta) * SHEAR[0] + np.sin(theta) * SHEAR[1])
    slid_s = np.array([np.clip(T - start, 0, stop - start) for start, stop in slides_s]).sum(axis=0)
    if slides_s:
        motion = motion * (1 + uneven_friction(ARRAY, slid_s[:, np.newaxis] / 0.1, 0.05))
    volts = 1.2 * np.clip((T - 0.5) / 0.5, 0, 1)[:, np.newaxis] + motion
    return regular_block(volts + 1e-3 * np.random.default_rng(seed).normal(size=volts.shape), 100.0)


def said(block: ScanBlock, setting: str = "balanced") -> list[SlipEvent]:
    return slips(slip_detector(ARRAY, setting).process(block))


def words(events: list[SlipEvent]) -> list[str]:
    return [event.kind if event.state == "onset" else "end" for event in events]


@pytest.mark.parametrize("takes_s", [0.1, 1.0])
@pytest.mark.parametrize("setting", SETTINGS)
def test_a_load_that_is_taken_off_after_gross_slip_ends_it(takes_s: float, setting: str) -> None:
    events = said(held(0.6 * ramp(4, 0.2) * (1 - ramp(7, takes_s)), ((4.1, 7.0),)), setting)
    assert words(events)[:3] == ["incipient", "gross", "end"]
    assert 7 < events[2].time_s < 7.3 + takes_s
    # Skin that springs back slips at the edge of the contact.
    assert all(event.kind == "incipient" for event in events[3:])


def test_a_slide_that_turns_back_is_reported_again() -> None:
    events = said(held(0.6 * ramp(4, 0.2) - 1.2 * ramp(7, 0.2), ((4.1, 7.0), (7.15, 10.0))))
    assert words(events)[:3] == ["incipient", "gross", "end"]
    assert 7 < events[3].detected_s < 7.3
    assert words(events)[-1] == "gross"


def test_a_slip_after_the_load_was_taken_off_is_another() -> None:
    shear = 0.6 * ramp(4, 0.2) * (1 - ramp(6, 0.2)) + 0.6 * ramp(8, 0.2)
    events = said(held(shear, ((4.1, 6.0), (8.1, 10.0))))
    assert words(events) == ["incipient", "gross", "end", "incipient", "gross"]
    assert 8 < events[3].detected_s < 8.25  # all of it slides from 8.2 s on


def test_two_slips_in_quick_succession_are_both_told() -> None:
    """The shear is gone for a quarter of a second between a jerk that was gross and the next."""
    shear = 0.6 * ramp(3, 0.05) * (1 - ramp(3.3, 0.05)) + 0.6 * ramp(3.6, 0.05)
    events = said(held(shear, ((3.05, 3.3), (3.65, 10.0))))
    assert words(events) == ["incipient", "gross", "end", "incipient", "gross"]
    assert 3.6 < events[3].detected_s < 3.8


@pytest.mark.parametrize("setting", ["fast", "balanced"])  # `quiet` waits for more than an even surface shows
def test_a_load_that_rested_and_grows_until_it_slides_is_reported(setting: str) -> None:
    events = said(held(0.42 * ramp(4, 1.0) + 0.12 * ramp(7, 0.2), ((7.1, 10.0),)), setting)
    assert any(event.kind == "gross" and 7 < event.detected_s < 7.6 for event in onsets(events))


SHAKES = {
    (hz, volts): held(volts * np.sin(2 * np.pi * hz * T) * (T > 4) * (T < 8))
    for hz, volts in [(0.5, 0.15), (2.0, 0.3), (7.0, 0.3), (1.0, 0.6)]
}


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("shake", SHAKES)
def test_onsets_and_ends_of_a_shaking_hand_alternate(shake: tuple[float, float], setting: str) -> None:
    """Each swing in which a tenth of the area slips may be reported; all have ended when the shear rests."""
    events = said(SHAKES[shake], setting)
    kinds: list[str] = []
    is_open = False
    for event in events:
        if event.state == "end":
            assert is_open
            is_open, kinds = False, []
        else:
            assert event.kind not in kinds
            assert not is_open or (kinds, event.kind) == (["incipient"], "gross")
            kinds.append(event.kind)
            is_open = True
    assert not is_open
    n_half_swings = 2 * shake[0] * 4  # in each, the edge slips back and then the other way
    assert len([e for e in onsets(events) if e.kind == "incipient"]) <= 2 * n_half_swings
    assert all(event.detected_s < 9 for event in onsets(events))


@given(cuts=splits(len(T)))
@settings(deadline=None, max_examples=4)
def test_a_shake_is_the_same_however_it_is_cut(cuts: list[int]) -> None:
    shake = SHAKES[2.0, 0.3]
    assert run(slip_detector(ARRAY), pieces(shake, cuts)) == slip_detector(ARRAY).process(shake)


def test_the_ripple_of_a_slide_that_is_over_is_no_second_slide() -> None:
    """Grooves pass until 6.8 s; what is told afterwards is of a skin that rests, and of its lift at 8.8 s."""
    phases = (
        {"kind": "press", "duration_s": 0.8, "force_n": 14.0},
        {"kind": "hold", "duration_s": 1.0},
        {"kind": "slide", "duration_s": 5.0, "speed_mm_s": 2.5, "direction_deg": 0.0},
        {"kind": "hold", "duration_s": 2.0},
        {"kind": "lift", "duration_s": 0.3},
    )
    grooves = {"kind": "grooves", "period_mm": 1.2, "angle_deg": 30.0}
    scene = Scene.model_validate(
        {"name": "grooves", "contact": "mechanics", "seed": 994, "surface": grooves, "phases": phases}
    )
    simulation, pipeline = Simulation(scene, LAYOUT), Pipeline(LAYOUT, ARRAY, PipelineParams())
    received = (event for now_s, data in simulation for event in pipeline.receive_data(data, now_s))
    events = [event for event in received if isinstance(event, SlipEvent)]
    t0_s = simulation.truth.t0_s
    gross = [event for event in events if event.kind == "gross"]
    assert words(gross)[:2] == ["gross", "end"]
    assert gross[0].onset_s - t0_s < 2.2
    assert all(event.detected_s - t0_s > 8.8 for event in gross[2:])
    for ended, begun in pairwise(events):
        assert ended.state == "onset" or begun.onset_s >= ended.detected_s

"""Directions of slips and their changes, against the emulator's truth."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from touches import contact_states, onsets, pieces, published, run, slips, splits, textures

from tactiled.array import Array, load_array
from tactiled.detect.suite import Wang2019Params
from tactiled.detect.wang2019.slip import WaveletSlip
from tactiled.detect.wang2019.texture import TextureParams
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import Scene
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.tomlfile import parse

WANG = load_array("wang2019-3x3")
XYZ = load_array("xyz-two-pads-4x4")
PLAIN = load_array("normal-4x4")
PRESS = {"kind": "press", "duration_s": 2.0, "force_n": 20.0}
HOLD = {"kind": "hold", "duration_s": 2.0}
LIFT = {"kind": "lift", "duration_s": 1.0}
SLIDE_S = 4.0  # when the first slide begins
FLAT = {"kind": "flat"}


def slide(duration_s: float, speed_mm_s: float, direction_deg: float, **more: float) -> dict[str, Any]:
    return {
        "kind": "slide",
        "duration_s": duration_s,
        "speed_mm_s": speed_mm_s,
        "direction_deg": direction_deg,
    } | more


def felt(
    phases: Sequence[dict[str, Any]],
    *,
    seed: int,
    surface: dict[str, Any] = FLAT,
    array: Array = WANG,
    noise_v: float = 0.3e-3,
) -> ScanBlock:
    """Readings of a scene, with channels sampled 0.2 ms apart."""
    document = {"name": "turns", "array": array.name, "seed": seed, "surface": surface}
    scene = parse(document | {"electronics": {"noise_v": noise_v}, "phases": list(phases)}, Scene, "test")
    offsets_s = np.arange(float(array.n_channels)) * 200e-6
    time_s = np.arange(round(scene.duration_s * 100))[:, np.newaxis] / 100 + offsets_s
    counts = Sensor(scene, array, adc_bits=12, adc_reference_v=3.0).counts(0, time_s)
    return regular_block(counts * 3.0 / 4096, 100.0, channel_offset_s=offsets_s, valid=counts < 4095)


def off_deg(angle_deg: float, truth_deg: float) -> float:
    return (angle_deg - truth_deg + 180) % 360 - 180


def turns(events: Sequence[Event]) -> list[SlipEvent]:
    return [e for e in onsets(events) if e.detector == "wang2019-turn"]


def grooves(rng: np.random.Generator) -> dict[str, Any]:
    return {"kind": "grooves", "period_mm": rng.uniform(0.9, 2.0), "angle_deg": rng.uniform(-60, 60)}


def test_direction_sigma_covers_any_direction_at_any_speed() -> None:
    """Unequal taxels and a saturating divider, at directions without symmetry."""
    rng = np.random.default_rng(11)
    z = []
    for seed, speed_mm_s in enumerate([0.25, 1.0, 5.0, 20.0] * 6):
        direction_deg = float(rng.uniform(-180, 180))
        (onset,) = onsets(
            WaveletSlip(WANG).process(
                felt([PRESS, HOLD, slide(0.5, speed_mm_s, direction_deg)], seed=seed + 1)
            )
        )
        z.append(off_deg(onset.direction_deg, direction_deg) / onset.direction_sd_deg)
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.abs(z).max() < 3


def test_one_taxel_states_a_wider_direction_than_nine() -> None:
    volts = felt([PRESS, HOLD, slide(0.5, 1.0, 20.0)], seed=1).volts.copy()
    (nine,) = onsets(WaveletSlip(WANG).process(regular_block(volts, 100.0)))
    volts[:, 4:] = np.nan
    (one,) = onsets(WaveletSlip(WANG).process(regular_block(volts, 100.0)))
    assert nine.direction_sd_deg < 2 < 3 < one.direction_sd_deg < 5
    assert abs(off_deg(one.direction_deg, 20.0)) <= 3 * one.direction_sd_deg


@pytest.mark.parametrize("array", [WANG, XYZ], ids=lambda array: array.name)
@pytest.mark.parametrize("is_grooved", [False, True], ids=["flat", "grooves"])
@pytest.mark.parametrize("speed_mm_s", [0.1, 0.25, 1.0, 5.0, 20.0])
def test_a_turn_ends_a_slip_and_begins_another(array: Array, is_grooved: bool, speed_mm_s: float) -> None:
    rng = np.random.default_rng(round(100 * speed_mm_s) + is_grooved)
    for seed in range(2):
        first_deg = float(rng.uniform(-180, 180))
        second_deg = float(off_deg(first_deg + rng.choice([-1, 1]) * rng.uniform(40, 180), 0.0))
        phases = [PRESS, HOLD, slide(4.0, speed_mm_s, first_deg), slide(6.0, speed_mm_s, second_deg)]
        surface = grooves(rng) if is_grooved else FLAT
        events = WaveletSlip(array).process(felt(phases, seed=seed + 1, surface=surface, array=array))
        onset, end, again = slips(events)
        assert [onset.state, end.state, again.state] == ["onset", "end", "onset"]
        assert abs(off_deg(onset.direction_deg, first_deg)) <= 3 * onset.direction_sd_deg
        assert end.time_s == again.onset_s == again.time_s
        assert end.detected_s == again.detected_s
        assert abs(again.onset_s - SLIDE_S - 4.0) <= min(0.05, 3 * again.onset_sd_s)
        assert abs(off_deg(again.direction_deg, second_deg)) <= 3 * again.direction_sd_deg
        assert again.direction_sd_deg < 6
        assert again.statistic >= again.threshold == 30.0
        assert contact_states(events) == ["loading", "holding", "sliding"]


def test_reciprocating_motion_is_one_slip_per_stroke() -> None:
    way = [slide(2.0, 2.0, 10.0 + 180.0 * (k % 2)) for k in range(5)]
    events = WaveletSlip(WANG).process(felt([PRESS, HOLD, *way, HOLD, LIFT], seed=3))
    states = [e.state for e in slips(events)]
    assert states == ["onset", "end"] * 5
    for k, onset in enumerate(onsets(events)):
        assert onset.onset_s == pytest.approx(SLIDE_S + 2.0 * k, abs=0.05)
        assert abs(off_deg(onset.direction_deg, 10.0 + 180.0 * (k % 2))) <= 3 * onset.direction_sd_deg
    assert slips(events)[-1].time_s == pytest.approx(SLIDE_S + 10.0, abs=0.1)


@pytest.mark.parametrize(
    "phases",
    [
        [slide(5.0, 1.0, 25.0), {**HOLD, "duration_s": 4.0}, LIFT],
        [slide(5.0, 0.25, 25.0), HOLD, slide(4.0, 0.25, 25.0), HOLD, LIFT],
        [slide(6.0, 2.0, -70.0, ramp_s=1.0, ripple_mm_s=1.6, ripple_hz=1.5), LIFT],
        [slide(4.0, 1.0, 140.0), {**PRESS, "force_n": 8.0}, slide(3.0, 1.0, 140.0), LIFT],
        [slide(3.0, 1.0, 0.0), slide(3.0, 1.0, 20.0), LIFT],  # a small change of direction
    ],
    ids=["stop", "resume", "stutter", "load", "small"],
)
@pytest.mark.parametrize("is_grooved", [False, True], ids=["flat", "grooves"])
def test_stops_loads_and_lifts_are_no_turns(phases: list[dict[str, Any]], is_grooved: bool) -> None:
    surface = {"kind": "grooves", "period_mm": 3.5, "angle_deg": 10.0, "ripple": 0.1} if is_grooved else FLAT
    for seed in range(1, 4):
        events = WaveletSlip(WANG).process(felt([PRESS, HOLD, *phases], seed=seed, surface=surface))
        assert onsets(events)
        assert turns(events) == []


def test_a_false_slip_before_a_slide_is_corrected_and_one_after_it_does_not_turn() -> None:
    """At 0.5 mV of noise the rule raises false alarms in a hold; shear left by a slide is no motion."""
    n_put_right = 0
    for seed in range(1, 9):
        phases = [PRESS, HOLD, slide(4.0, 1.0, 70.0), {**HOLD, "duration_s": 12.0}]
        for turn in turns(WaveletSlip(WANG).process(felt(phases, seed=seed, noise_v=0.5e-3))):
            assert SLIDE_S - 0.05 < turn.onset_s < SLIDE_S + 4.0
            assert abs(off_deg(turn.direction_deg, 70.0)) <= 3 * turn.direction_sd_deg
            n_put_right += 1
    assert n_put_right > 0


def test_an_array_without_shear_sees_no_turn() -> None:
    phases = [PRESS, HOLD, slide(3.0, 1.0, 0.0), slide(6.0, 1.0, 180.0)]
    surface = {"kind": "grooves", "period_mm": 1.5}
    events = WaveletSlip(PLAIN).process(felt(phases, seed=1, surface=surface, array=PLAIN))
    assert turns(events) == []


@functools.cache
def turned_over_grooves() -> ScanBlock:
    phases = [PRESS, HOLD, slide(3.0, 1.0, 0.0), slide(24.0, 1.0, 180.0)]
    return felt(phases, seed=11, surface={"kind": "grooves", "period_mm": 1.2, "angle_deg": 15.0})


@given(splits(len(turned_over_grooves())))
@settings(max_examples=6, deadline=None)
def test_a_turn_does_not_depend_on_chunking(cuts: list[int]) -> None:
    block = turned_over_grooves()
    whole = WaveletSlip(WANG).process(block)
    assert turns(whole)
    assert run(WaveletSlip(WANG), pieces(block, cuts)) == whole


@pytest.mark.parametrize(("second_deg", "angle_deg"), [(180.0, 30.0), (180.0, 15.0), (45.0, 30.0)])
def test_a_turn_restarts_the_texture_window_in_its_direction(second_deg: float, angle_deg: float) -> None:
    texture = Wang2019Params(texture=TextureParams(speed_mm_s=1.0, agreement_mm=0.1))
    phases = [PRESS, HOLD, slide(3.0, 1.0, 0.0), slide(24.0, 1.0, second_deg)]
    surface = {"kind": "grooves", "period_mm": 1.2, "angle_deg": angle_deg}
    events = published(WANG, texture).process(felt(phases, seed=11, surface=surface))
    (turn,) = turns(events)
    cut_short, *found = textures(events)
    assert (cut_short.status, cut_short.time_s) == ("no-slip", turn.detected_s)
    assert [e.time_s for e in found] == pytest.approx(
        [turn.detected_s + 11.0 + 10 * k for k in (0, 1)], abs=0.02
    )
    for event in found:
        assert event.status == "ok"
        assert abs(event.angle_deg - angle_deg) <= 3 * event.angle_sd_deg

"""Friction that is stated from outside: from the next contact on, until another object is held."""

import math

import numpy as np
import pytest

from bench.worlds.arrays import square_array
from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
SCANS = 400  # of a touch and the rest after it
PRIOR = 0.6 * ARRAY.shear_per_friction


def touch(number: int, shear: float = 0.2) -> ScanBlock:
    """Return the scans of one touch: press from 0.5 s to 1 s, shear from 2 s, lift at 3 s."""
    t = np.arange(SCANS)[:, np.newaxis] / 100
    lifted = t < 3.0
    volts: FloatArray = np.clip((t - 0.5) / 0.5, 0, 1) * lifted * np.ones(36)
    volts = volts + shear * np.clip((t - 2.0) / 0.4, 0, 1) * lifted * np.tile([1.0, 0.0, -1.0, 0.0], 9)
    volts += 1e-4 * np.random.default_rng(number).standard_normal(volts.shape)
    return regular_block(volts, 100.0, start_s=number * SCANS / 100, index=number * SCANS)


def grips(events: list[Event]) -> list[GripEvent]:
    return [event for event in events if isinstance(event, GripEvent) and event.state != "none"]


def log_sd(event: GripEvent) -> float:
    return math.log(event.friction_high / event.friction_low) / (2 * 1.645)


def test_the_next_contact_begins_with_what_was_stated() -> None:
    detector = GripDetector(ARRAY)
    detector.state_friction(1.8, 0.1)
    first = grips(detector.process(touch(0)))[5]
    assert first.friction == pytest.approx(1.8, rel=0.02)
    assert 0.1 < log_sd(first) < 0.3  # what the model does not know is added


def slide(number: int, ratio: float) -> ScanBlock:
    """Return the scans of a touch that slides from 3 s on at a ratio of shear and load, unevenly."""
    rng, t = np.random.default_rng(number), np.arange(800)[:, np.newaxis] / 100
    walk = 0.01 * np.cumsum(rng.standard_normal((800, 9)), axis=0)
    uneven = np.repeat(np.where(t > 3.0, walk - walk[300], 0.0), 4, axis=1)
    shear = ratio / 2 * np.clip(t - 2.0, 0, 1) * (1 + uneven) * np.tile([1.0, 0.0, -1.0, 0.0], 9)
    volts = (np.clip((t - 0.5) / 0.5, 0, 1) + shear) * (t < 6.0)
    volts += 3e-4 * rng.standard_normal(volts.shape)
    return regular_block(volts, 100.0, start_s=number * 8.0, index=number * 800)


@pytest.mark.parametrize("stated", [False, True])
def test_a_friction_that_is_wrong_by_far_does_not_hide_every_slide(stated: bool) -> None:
    """Of another object, nobody said that it was one: sliding stays possible, and is believed at last."""
    detector = GripDetector(ARRAY, GripParams(gross_p=0.3))
    if stated:
        detector.state_friction(1.0 * ARRAY.shear_per_friction, 0.1)
    else:
        detector.process(slide(0, 1.5 * ARRAY.shear_per_friction))
    found = [detector.process(slide(k, 0.4 * ARRAY.shear_per_friction)) for k in range(1, 13)]
    likeliest = [max(event.p_sliding for event in grips(events)[250:]) for events in found]
    assert min(likeliest) > 0.05
    assert any(event.state == "gross" for events in found for event in grips(events))


def test_noise_that_the_gate_does_not_call_a_contact_tells_nothing_of_friction() -> None:
    pad = square_array("xyz", 2, 4.0, range=(-8.0, 8.0))
    load = np.where(np.arange(250) < 150, 0.0, 3.0)[:, np.newaxis] * np.tile([0.1, 0.0, 1.0], 4)
    for seed in range(12):
        detector = GripDetector(pad)
        detector.state_friction(0.2, 0.1)
        noise = 0.04 * np.random.default_rng(seed).standard_normal(load.shape)
        first = grips(detector.process(regular_block(load + noise, 100.0)))[5]
        assert first.friction == pytest.approx(0.2, rel=0.1), seed


def test_a_contact_that_goes_on_keeps_what_it_has_shown() -> None:
    plain, stated = GripDetector(ARRAY), GripDetector(ARRAY)
    block = touch(0)
    expected = plain.process(block[:200]) + plain.process(block[200:])
    found = stated.process(block[:200])
    stated.state_friction(0.2, 0.0)
    assert found + stated.process(block[200:]) == expected
    assert grips(stated.process(touch(1)))[5].friction == pytest.approx(0.2, rel=0.02)


def test_what_is_stated_in_a_light_touch_that_a_gap_ends_holds_for_the_next_contact() -> None:
    volts = np.zeros((150, 36))
    volts[50:, :4] = 0.3  # one taxel touches, and the mean load is too small to tell
    detector = GripDetector(ARRAY)
    light = detector.process(regular_block(volts, 100.0))
    assert {event.valid for event in light if isinstance(event, GripEvent)} == {False}
    detector.state_friction(1.8, 0.1)
    detector.process(Gap(n_missing=SCANS - 150, cause="missing", index=SCANS))
    assert grips(detector.process(touch(1)))[5].friction == pytest.approx(1.8, rel=0.02)


def test_friction_is_less_known_where_the_scale_of_shear_is_not_stated() -> None:
    """The prior of friction is of forces; readings of shear and load may have any scale of their own."""
    pads = {
        "scaled": square_array("xyz", 3, 4.0, unit="count", range=(-8.0, 8.0), shear_per_friction=1.0),
        "newtons": square_array("xyz", 3, 4.0, unit="N", range=(-8.0, 8.0)),
        "sides": square_array("sides", 3, 4.0, unit="count", range=(-8.0, 8.0)),
        "not scaled": square_array("xyz", 3, 4.0, unit="count", range=(-8.0, 8.0)),
    }
    assert {pad.shear_per_friction for pad in pads.values()} == {1.0}

    def pressed(pad: Array, params: GripParams | None = None) -> GripEvent:
        load = np.clip(np.arange(60)[:, np.newaxis] / 20 - 0.5, 0, 1) * pad.normal_weights().any(axis=0)
        noise = 1e-4 * np.random.default_rng(3).standard_normal(load.shape)
        return grips(GripDetector(pad, params).process(regular_block(load + noise, 100.0)))[0]

    found = {name: log_sd(pressed(pad)) for name, pad in pads.items()}
    assert found == pytest.approx({"scaled": 0.6, "newtons": 0.6, "sides": 0.6, "not scaled": 1.0}, rel=0.05)
    stated = pressed(pads["not scaled"], GripParams(friction=0.2))
    assert log_sd(stated) == pytest.approx(0.6, rel=0.05)


def test_another_object_has_the_friction_of_the_configuration() -> None:
    detector = GripDetector(ARRAY, GripParams(friction=2.0))
    detector.state_friction(0.5, 0.1)
    detector.process(touch(0)[:200])
    detector.change_object()
    detector.process(touch(0)[200:])
    assert grips(detector.process(touch(1)))[5].friction == pytest.approx(2.0, rel=0.05)


def test_a_contact_teaches_the_next_one_unless_the_object_changed() -> None:
    kept, changed = GripDetector(ARRAY), GripDetector(ARRAY)
    for detector in (kept, changed):
        detector.process(touch(0, shear=0.7))
    changed.change_object()
    after, anew = (grips(detector.process(touch(1)))[5] for detector in (kept, changed))
    assert after.friction > 1.1 * PRIOR  # it bore more than the prior expects
    assert anew.friction == pytest.approx(PRIOR, rel=0.05)


def test_thresholds_and_a_board_that_began_anew_change_nothing_of_it() -> None:
    suite = TunedSuite(ARRAY, DetectParams())
    assert suite.state_friction(0.9, 0.1) == ""
    suite.process(touch(0))
    assert suite.set_thresholds({"grip.incipient_p": 0.5})[0] == ""
    suite.process(Gap(0, "restart", 2 * SCANS))
    found = grips(suite.process(touch(2)))[5]
    assert found.friction == pytest.approx(0.9, rel=0.02)
    assert suite.friction == (0.9, 0.1)
    assert suite.change_object() == ""
    suite.process(Gap(0, "restart", 3 * SCANS))
    assert grips(suite.process(touch(3)))[5].friction == pytest.approx(PRIOR, rel=0.05)


@pytest.mark.parametrize(
    ("array", "setting"),
    [("normal-4x4", "balanced"), ("wang2019-3x3", "wang2019")],
    ids=["no shear", "paper"],
)
def test_detectors_that_learn_no_friction_refuse_it(array: str, setting: str) -> None:
    params = DetectParams.model_validate({"setting": setting})
    suite = TunedSuite(load_array(array), params)
    assert "takes friction or motion" in suite.state_friction(0.6, 0.1)
    assert "takes friction or motion" in suite.change_object()
    assert suite.friction is None

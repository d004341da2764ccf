"""Slips inside a gap are reported; a gap without a change of shear is not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from touches import pieces, run, slip_detector, slips, splits, uneven_friction

from bench.worlds.generators import draw
from tactiled.array import FloatArray, load_array
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import Gap, GapCause, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
SHEAR = np.sign(ARRAY.shear_weights().sum(axis=1))  # (2, channels)
T = np.arange(800) / 100.0
FIRST, LAST = 398, 418  # scans that are lost


def held(shear: FloatArray, pressure: FloatArray, slides_s: float = 99.0) -> ScanBlock:
    """Shear (n,) at 25 degrees and pressure (n,), in volts; from `slides_s` on, the contact slides."""
    theta = np.radians(25.0)
    motion = shear[:, np.newaxis] * (np.cos(theta) * SHEAR[0] + np.sin(theta) * SHEAR[1])
    motion = motion * (1 + uneven_friction(ARRAY, np.clip(T - slides_s, 0, None)[:, np.newaxis] / 0.1, 0.05))
    volts = pressure[:, np.newaxis] + motion
    return regular_block(volts + 1e-3 * np.random.default_rng(3).normal(size=volts.shape), 100.0)


def ramp(start_s: float, takes_s: float) -> FloatArray:
    return np.asarray(np.clip((T - start_s) / takes_s, 0, 1))


PRESSED = 1.2 * ramp(0.5, 0.5)
SLIPPED = held(0.6 * ramp(4.0, 0.1), PRESSED, slides_s=4.05)


def through_a_gap(block: ScanBlock, setting: str = "balanced", cause: GapCause = "missing") -> list[Event]:
    detector = slip_detector(ARRAY, setting)
    events = detector.process(block[:FIRST])
    events += detector.process(Gap(LAST - FIRST, cause, int(block.index[LAST])))
    return events + detector.process(block[LAST:])


def test_the_end_of_a_contact_is_told_after_any_number_of_gaps() -> None:
    detector = GripDetector(ARRAY)
    detector.process(SLIPPED[:300])
    for n in (300, 340):
        detector.process(Gap(40, "missing", n + 40))
    free = np.zeros((20, 36))
    events = detector.process(regular_block(free, 100.0, start_s=3.8, index=380))
    assert [event.state for event in events if isinstance(event, GripEvent)] == ["none"]


def test_times_before_zero_are_as_good_as_any() -> None:
    (world,) = draw("strokes", range(19, 20), 0.2)
    params = GripParams(gross_p=0.85)
    earlier = replace(world.block, time_s=world.block.time_s - 100.0)
    expected = slips(GripDetector(world.array, params).process(world.block))
    found = slips(GripDetector(world.array, params).process(earlier))
    assert any(event.kind == "gross" for event in expected)
    assert [event.onset_s for event in found] == pytest.approx([event.onset_s - 100.0 for event in expected])


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("cause", ["missing", "corrupt"])
def test_a_slip_inside_a_gap_is_reported(setting: str, cause: GapCause) -> None:
    first, gross = slips(through_a_gap(SLIPPED, setting, cause))[:2]
    assert (first.state, first.kind, first.valid) == ("onset", "incipient", True)
    assert first.detected_s < 4.18 + 0.1
    assert abs(first.onset_s - 4.0) <= 2 * first.onset_sd_s
    assert first.onset_sd_s > 0.2 / 12**0.5 - 0.01  # it may have begun anywhere in the gap of 0.2 s
    assert abs(first.direction_deg - 25.0) < 2
    assert gross.kind == "gross"
    assert 3.97 < gross.onset_s < 4.4


def test_the_contact_then_slides() -> None:
    states = [e.state for e in through_a_gap(SLIPPED) if e.topic == "contact"]  # type: ignore[attr-defined]
    assert states[-1] == "sliding"


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize(
    ("shear", "pressure"),
    [
        (0 * T, PRESSED),
        (0.2 * ramp(2.0, 0.8), PRESSED),  # a load that was there before
        (0.2 * PRESSED, PRESSED),  # a press at a slant
        (0.1 * (PRESSED + 0.4 * ramp(4.0, 0.1)), PRESSED + 0.4 * ramp(4.0, 0.1)),  # and a firmer grip
    ],
)
def test_a_gap_without_a_change_of_shear_is_not_reported(
    shear: FloatArray, pressure: FloatArray, setting: str
) -> None:
    said = slips(through_a_gap(held(shear, pressure), setting))
    assert [e for e in said if e.detected_s > 3.97] == []


@pytest.mark.parametrize("cause", ["restart", "disconnect", "rate", "command"])
def test_a_board_that_began_anew_is_not_compared_with_what_it_was(cause: GapCause) -> None:
    stepped = held(0.3 * ramp(4.0, 0.1), PRESSED)
    assert slips(through_a_gap(stepped, cause=cause)) == []
    assert slips(through_a_gap(stepped)) != []


def test_one_taxel_alone_that_jumps_in_a_gap_is_a_fault_of_its_own() -> None:
    block = held(0 * T, PRESSED)
    block.volts[LAST:, :4] += [0.5, 0.0, -0.5, 0.0]
    assert slips(through_a_gap(block)) == []


@given(cuts=splits(len(SLIPPED) - LAST))
@settings(deadline=None, max_examples=10)
def test_it_is_the_same_however_scans_come_after_the_gap(cuts: list[int]) -> None:
    detector = slip_detector(ARRAY)
    events = detector.process(SLIPPED[:FIRST])
    events += detector.process(Gap(LAST - FIRST, "missing", int(SLIPPED.index[LAST])))
    assert events + run(detector, pieces(SLIPPED[LAST:], cuts)) == through_a_gap(SLIPPED)

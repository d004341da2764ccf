"""Slip events of the contact filter: order, kinds, direction, ends, and the states of the contact."""

import dataclasses
import math

import numpy as np
import pytest
from mindlin import slid_to

from tactiled.array import ArrayFile, Grid, TaxelChannel, build
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import UNKNOWN_SD_DEG, ContactEvent, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

MU = 0.7
RATE_HZ = 100.0
PLACES = [-4.0, 0.0, 4.0]
LOADS = np.array([0.4, 0.8, 0.5, 0.9, 1.8, 1.1, 0.6, 1.2, 0.7])
ARRAY_CHANNELS = [
    TaxelChannel(name="x", kind="shear_x"),
    TaxelChannel(name="y", kind="shear_y"),
    TaxelChannel(name="z", kind="normal"),
]
ARRAY = build(
    ArrayFile(
        name="xyz",
        grids=[Grid(x_mm=PLACES, y_mm=PLACES)],
        taxel_channels=ARRAY_CHANNELS,
    )
)
KNOWN = GripParams(friction=0.95 * MU, friction_log_sd=0.1)
SLIPS_S, RELAXES_S = 2.5, 3.5


def slide(direction_deg: float = 30.0, turn: float = 0.0, noise: float = 0.001) -> ScanBlock:
    """Press, shear by Mindlin's curve from 2 s, slip of all of the contact from 2.5 s, relax from 3.5 s.

    `turn` is the turn about the centre of the loads, in place of the shift.
    """
    t = np.arange(450) / RATE_HZ
    load = LOADS * np.interp(t, [0.5, 1.0], [0.0, 1.0])[:, np.newaxis]
    angle = math.radians(direction_deg)
    x, y = np.full(9, math.cos(angle)), np.full(9, math.sin(angle))
    if turn:
        x, y = -turn * ARRAY.y_mm, turn * ARRAY.x_mm
    travel = np.interp(t, [2.0, SLIPS_S], [0.0, 1.0])
    shear = slid_to(load, travel, MU, (x, y)) * np.interp(t, [RELAXES_S, 3.8], [1.0, 0.3])[:, None, None]
    readings = np.zeros((len(t), 27))
    readings[:, 0::3], readings[:, 1::3], readings[:, 2::3] = shear[:, 0], shear[:, 1], load
    readings += noise * np.random.default_rng(3).normal(size=readings.shape)
    return regular_block(readings, RATE_HZ)


def slips(events: list[Event]) -> list[SlipEvent]:
    return [event for event in events if isinstance(event, SlipEvent)]


@pytest.fixture(scope="module")
def found() -> list[Event]:
    return GripDetector(ARRAY, KNOWN).process(slide())


def test_a_slip_is_incipient_then_gross_then_ends(found: list[Event]) -> None:
    told = slips(found)
    assert [(event.state, event.kind) for event in told] == [
        ("onset", "incipient"),
        ("onset", "gross"),
        ("end", "gross"),
    ]
    incipient, gross, end = told
    assert 2.0 < incipient.onset_s < SLIPS_S - 0.2
    assert abs(gross.onset_s - SLIPS_S) < 0.25  # the last taxel slips at 2.5 s, most of them before
    assert RELAXES_S < end.time_s < RELAXES_S + 0.3
    assert incipient.confidence >= incipient.threshold == KNOWN.incipient_p
    assert gross.confidence > gross.threshold == KNOWN.gross_p


def test_the_contact_shears_slides_and_holds(found: list[Event]) -> None:
    states = [event.state for event in found if isinstance(event, ContactEvent)]
    assert states == ["loading", "holding", "shearing", "sliding", "holding"]


@pytest.mark.parametrize("direction_deg", [-150.0, 0.0, 30.0, 90.0])
def test_the_direction_is_that_of_the_motion(direction_deg: float) -> None:
    told = slips(GripDetector(ARRAY, KNOWN).process(slide(direction_deg)[:350]))
    assert len(told) == 2
    for event in told:
        error_deg = (event.direction_deg - direction_deg + 180) % 360 - 180
        assert abs(error_deg) < 3 * event.direction_sd_deg + 0.2
        assert event.direction_sd_deg < 5


def test_the_direction_of_the_next_slip_is_its_own() -> None:
    """The object slides along +x, is let go at once, and slides along +y half a second later."""
    t = np.arange(430) / RATE_HZ
    load = LOADS * np.interp(t, [0.5, 1.0], [0.0, 1.0])[:, np.newaxis]
    readings = slide(0.0)[: len(t)].volts.copy()
    readings[t > 3.3, 0::3] = readings[:200, 0::3][: int((t > 3.3).sum())]
    readings[:, 1::3] += slid_to(load, np.interp(t, [3.7, 4.2], [0.0, 1.0]), MU, (np.zeros(9), np.ones(9)))[
        :, 1
    ]
    told = slips(GripDetector(ARRAY, KNOWN).process(regular_block(readings, RATE_HZ)))
    assert [(event.state, event.kind) for event in told[2:]] == [
        ("end", "gross"),
        ("onset", "incipient"),
        ("onset", "gross"),
    ]
    assert [event.direction_deg for event in told[3:]] == pytest.approx([90.0, 90.0], abs=2.0)


def test_the_instant_of_a_slip_is_no_surer_than_the_clock() -> None:
    block = slide()[:350]
    exact = slips(GripDetector(ARRAY, KNOWN).process(dataclasses.replace(block, time_sd_s=np.zeros(350))))
    told = slips(GripDetector(ARRAY, KNOWN).process(dataclasses.replace(block, time_sd_s=np.full(350, 0.05))))
    assert len(told) == 2
    assert [event.onset_sd_s for event in told] == pytest.approx(
        [math.hypot(event.onset_sd_s, 0.05) for event in exact]
    )


def test_a_skin_that_turns_on_the_spot_has_no_direction() -> None:
    told = slips(GripDetector(ARRAY, KNOWN).process(slide(turn=1.0)))
    assert told
    assert told[0].direction_sd_deg == UNKNOWN_SD_DEG


def test_a_higher_probability_is_reported_later() -> None:
    detected_s = [
        slips(GripDetector(ARRAY, GripParams(incipient_p=p)).process(slide()))[0].detected_s
        for p in (0.05, 0.3, 0.9)
    ]
    assert detected_s == sorted(detected_s)
    assert detected_s[0] < detected_s[-1]


def without(block: ScanBlock, channels: list[int], from_row: int = 0) -> ScanBlock:
    """Return the block with channels that cannot be read from a scan on."""
    volts, valid = block.volts.copy(), np.ones(block.volts.shape, dtype=np.bool_)
    volts[from_row:, channels], valid[from_row:, channels] = np.nan, False
    return regular_block(volts, RATE_HZ, valid=valid)


@pytest.mark.parametrize("from_row", [0, 220])
def test_a_taxel_that_is_lost_does_not_slip_and_the_rest_is_reported(from_row: int) -> None:
    told = slips(GripDetector(ARRAY, KNOWN).process(without(slide(), [4], from_row)))
    assert [(event.state, event.kind, event.valid) for event in told] == [
        ("onset", "incipient", True),
        ("onset", "gross", True),
        ("end", "gross", True),
    ]
    assert told[1].taxels == (0, 2, 3, 4, 5, 6, 7, 8)


def test_slips_of_a_pad_that_has_lost_a_third_are_not_valid() -> None:
    told = slips(GripDetector(ARRAY, KNOWN).process(without(slide(), [1, 12, 23])))
    assert told
    assert not any(event.valid for event in told)


def test_a_pad_that_cannot_be_read_any_more_ends_a_slip_with_an_event_that_is_not_valid() -> None:
    told = slips(GripDetector(ARRAY, KNOWN).process(without(slide(), list(range(27)), 300)))
    assert [(event.state, event.kind, event.valid) for event in told] == [
        ("onset", "incipient", True),
        ("onset", "gross", True),
        ("end", "gross", False),
    ]


def test_one_taxel_tells_incipient_slip_and_its_direction() -> None:
    array = build(
        ArrayFile(
            name="one",
            grids=[Grid(x_mm=[0.0], y_mm=[0.0])],
            taxel_channels=ARRAY_CHANNELS,
        )
    )
    volts = slide().volts.reshape(-1, 9, 3).sum(axis=1) / 2
    told = slips(GripDetector(array).process(regular_block(volts, RATE_HZ)))
    assert (told[0].state, told[0].kind) == ("onset", "incipient")
    assert 2.0 < told[0].detected_s < SLIPS_S
    assert abs(told[0].direction_deg - 30.0) < 2 * told[0].direction_sd_deg < 10


def test_an_array_without_shear_has_contact_events_only() -> None:
    array = build(
        ArrayFile(
            name="z",
            grids=[Grid(x_mm=PLACES, y_mm=PLACES)],
            taxel_channels=[TaxelChannel(name="z", kind="normal")],
        )
    )
    events = GripDetector(array).process(regular_block(slide().volts[:, 2::3], RATE_HZ))
    assert {event.topic for event in events} == {"contact"}


def test_a_gap_ends_a_slip_with_an_event_that_is_not_valid() -> None:
    detector = GripDetector(ARRAY, KNOWN)
    detector.process(slide()[:300])
    (end,) = slips(detector.process(Gap(5, "missing", 500)))
    assert (end.state, end.kind, end.valid) == ("end", "gross", False)


def test_the_setting_publishes_slips_and_grip_of_one_model() -> None:
    block = slide()[:300]
    events = build_suite(ARRAY, DetectParams(grip=KNOWN), topics=("slip", "grip")).process(block)
    assert {event.topic for event in events} == {"slip", "contact", "grip"}
    assert slips(events) == slips(GripDetector(ARRAY, KNOWN).process(block))
    assert sum(event.topic == "grip" for event in events) == len(
        {e.time_s for e in events if e.topic == "grip"}
    )


def test_a_setting_is_two_probabilities_and_given_ones_replace_them() -> None:
    quiet = DetectParams.model_validate({"setting": "quiet"}).grip
    assert (quiet.incipient_p, quiet.gross_p) == SETTINGS["quiet"]
    given = DetectParams.model_validate({"setting": "fast", "grip": {"gross_p": 0.45}}).grip
    assert (given.incipient_p, given.gross_p) == (SETTINGS["fast"].incipient, 0.45)
    assert DetectParams().grip == DetectParams.model_validate({"setting": "balanced"}).grip == GripParams()

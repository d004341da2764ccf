"""Slip events, grip messages and contact state say the same of a contact, on worlds of every generator."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from bench.worlds.generators import GENERATORS, draw
from bench.worlds.world import World
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.contact.posterior import INCIPIENT_USED, LEAST_GROSS_USED
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent
from tactiled.samples.block import Gap

HANDS = {
    "laws": ("pull", "ease"),
    "bristles": ("slow-pull", "ease"),
    "sheet": ("slow-pull", "reverse"),
    "strokes": ("strokes", "ease"),
    "grasps": ("ease", "dips"),
    "plates": ("slide", "gripped", "load"),
}

ROUNDING_S = 1e-9  # an onset is a mean of instants


@pytest.fixture(scope="module", params=sorted(GENERATORS))
def worlds(request: pytest.FixtureRequest) -> list[World]:
    n, minutes = (3 if request.param == "plates" else 4), 0.12  # plates are played one by one
    found = draw(request.param, range(7000, 7000 + n), minutes, HANDS[request.param])
    assert any(world.slips for world in found)
    return found


@functools.cache
def told(world: World, setting: str, has_gaps: bool) -> Sequence[Event]:
    """Events of a world, as it is or with a gap of four scans in every half a second."""
    at = SETTINGS[setting]
    detector = GripDetector(world.array, GripParams(incipient_p=at.incipient, gross_p=at.gross))
    if not has_gaps:
        return detector.process(world.block)
    events: list[Event] = []
    length = round(world.rate_hz / 2)
    for start in range(0, len(world.block), length):
        events += detector.process(world.block[start : start + length - 4])
        events += detector.process(Gap(4, "missing", start + length))
    return events


either_way = pytest.mark.parametrize(
    ("setting", "has_gaps"), [("balanced", False), ("quiet", False), ("fast", True)]
)


@either_way
def test_every_message_agrees_with_the_slip_that_is_open(
    worlds: list[World], setting: str, has_gaps: bool
) -> None:
    n_gross = 0
    for world in worlds:
        slip: SlipEvent | None = None
        contact = "none"
        for event in told(world, setting, has_gaps):
            if isinstance(event, SlipEvent):
                slip = event if event.state == "onset" else None
            elif isinstance(event, ContactEvent):
                contact = event.state
            elif isinstance(event, GripEvent) and event.state != "none":
                kind = "" if slip is None else slip.kind
                assert (contact == "sliding") == (kind == "gross")
                assert (event.state == "gross") == (kind == "gross")
                if kind == "gross":
                    n_gross += 1
                    assert event.utilisation >= LEAST_GROSS_USED
                    assert (event.p_gross_50ms, event.p_gross_300ms, event.slipping_share) == (1.0, 1.0, 1.0)
                    assert event.p_sliding >= SETTINGS[setting].gross / 3
                    assert event.friction_low <= event.friction <= event.friction_high
                    size = event.needed_load * 0.7 * event.friction_low
                    assert size >= 0.999 * math.hypot(event.shear_x, event.shear_y)
                else:
                    assert event.p_gross_50ms < 1.0
                    if kind == "incipient":
                        assert event.state == "partial"
                        assert event.utilisation >= INCIPIENT_USED
    assert n_gross > 0


@either_way
def test_a_slip_begins_after_the_one_before_has_ended(
    worlds: list[World], setting: str, has_gaps: bool
) -> None:
    """A contact whose slide has just ended shows a fall of shear, which is no growth towards another slip."""
    for world in worlds:
        ended_s = -math.inf
        for event in told(world, setting, has_gaps):
            if isinstance(event, SlipEvent):
                assert event.onset_s >= ended_s - ROUNDING_S or event.state == "end"
                ended_s = event.time_s if event.state == "end" else ended_s


@pytest.mark.parametrize("part", [1.0, 0.1, 0.02])
def test_grip_messages_come_for_as_long_as_the_contact(worlds: list[World], part: float) -> None:
    """Also where the load is so light that its ratio to shear tells nothing."""
    n_told = 0
    for world in worlds:
        rest = np.median(world.block.volts[~world.touching], axis=0)
        lighter = dataclasses.replace(world.block, volts=rest + part * (world.block.volts - rest))
        contact = grip = "none"
        events = GripDetector(world.array).process(lighter)
        for _, of_a_scan in itertools.groupby(events, key=lambda event: event.evidence_s):
            for event in of_a_scan:
                if isinstance(event, ContactEvent):
                    contact = event.state
                elif isinstance(event, GripEvent):
                    grip = event.state
                    n_told += grip != "none"
            assert (contact == "none") == (grip == "none")
    assert n_told > 0 or part < 1.0


def test_a_contact_whose_beginning_nobody_saw_is_unknown_until_it_slid() -> None:
    (world,) = draw("laws", range(7001, 7002), 0.2, ("pull",))
    first = int(np.flatnonzero(world.touching)[0]) + round(0.8 * world.rate_hz)
    events = GripDetector(world.array).process(world.block[first:])
    grips = [event for event in events if isinstance(event, GripEvent)]
    assert (grips[0].state, grips[0].utilisation_low, grips[0].utilisation_high) == ("unknown", 0.0, 1.0)
    assert all(event.needed_load >= event.load for event in grips if event.state == "unknown")
    states = [event.state for event in grips]
    if "gross" in states:
        assert "unknown" not in states[states.index("gross") :]

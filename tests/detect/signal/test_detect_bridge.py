"""A few lost scans hide no event; long gaps reach the detector."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import load_array
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import load_scene
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
ONSET, STOP = 600, 1100  # scans of the demo scene at which the first slide begins and ends


def recording() -> ScanBlock:
    sensor = Sensor(load_scene("prescribed"), ARRAY, adc_bits=12, adc_reference_v=3.0)
    time_s = np.repeat(np.arange(1300)[:, np.newaxis] / 100.0, ARRAY.n_channels, axis=1)
    volts = np.asarray(sensor.counts(0, time_s) * (3.0 / 4096), dtype=np.float64)
    return regular_block(volts, 100.0)


BLOCK = recording()


def with_holes(lost: set[int]) -> list[ScanBlock | Gap]:
    """The recording as an assembler gives it when these scans are lost."""
    items: list[ScanBlock | Gap] = []
    start = 0
    for scan in [*sorted(lost), len(BLOCK)]:
        if scan > start:
            items.append(BLOCK[start:scan])
        if scan < len(BLOCK):
            if items and isinstance(items[-1], Gap):
                items[-1] = Gap(items[-1].n_missing + 1, "corrupt", scan + 1)
            else:
                items.append(Gap(1, "corrupt", scan + 1))
        start = scan + 1
    return items


def events(items: list[ScanBlock | Gap]) -> list[Event]:
    suite = build_suite(ARRAY, DetectParams(setting="wang2019"))
    return [event for item in items for event in suite.process(item)]


@pytest.mark.parametrize("offset", [-40, -20, -10, -5, -1, 0, 1, 2, 3, 5, 8, 12, 20, 40, 200])
@pytest.mark.parametrize("n_lost", [1, 4])
def test_lost_scans_beside_the_onset_do_not_hide_the_slip(offset: int, n_lost: int) -> None:
    first = ONSET + offset
    slips = [e for e in events(with_holes(set(range(first, first + n_lost)))) if isinstance(e, SlipEvent)]
    assert [e.state for e in slips] == ["onset", "end"]
    assert slips[0].onset_s == pytest.approx(ONSET / 100, abs=0.06)
    assert abs(slips[0].direction_deg) < 5
    assert slips[1].time_s == pytest.approx(STOP / 100, abs=0.1)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 1000))
def test_one_scan_in_a_hundred_lost_gives_the_same_events(seed: int) -> None:
    lost = set(np.flatnonzero(np.random.default_rng(seed).random(len(BLOCK) - 20) < 0.01).tolist())

    def states(items: list[ScanBlock | Gap]) -> list[tuple[str, str]]:
        return [(e.topic, e.state) for e in events(items) if isinstance(e, SlipEvent | ContactEvent)]

    assert states(with_holes(lost)) == states([BLOCK])


def test_long_gaps_and_restarts_reach_the_detector() -> None:
    for gap in (Gap(6, "missing", 506), Gap(0, "restart", 500), Gap(2, "disconnect", 502)):
        after = BLOCK[500 + gap.n_missing : 520]
        found = events([BLOCK[:500], gap, after])
        lost = [e for e in found if isinstance(e, ContactEvent) and not e.valid]
        assert lost, gap


@pytest.mark.parametrize("start", [400, 700])
def test_a_contact_that_began_unseen_is_not_called_a_hold(start: int) -> None:
    """A daemon that starts in mid-contact cannot tell a hold from a steady slide, and says so."""
    found = events([BLOCK[start:1090]])
    contacts = [e for e in found if isinstance(e, ContactEvent)]
    assert contacts[0].state == "unknown"
    if start < ONSET:  # the slip is found all the same
        assert [e.state for e in found if isinstance(e, SlipEvent)] == ["onset"]
        assert [e.state for e in contacts] == ["unknown", "sliding"]
        sure = next(e for e in events([BLOCK[:1090]]) if isinstance(e, SlipEvent))
        (unsure,) = (e for e in found if isinstance(e, SlipEvent))
        assert unsure.confidence == pytest.approx(sure.confidence / 2, rel=0.05)
    else:
        assert len(contacts) == 1


def test_bridging_does_not_depend_on_chunks_and_reset_equals_new() -> None:
    items = with_holes({300, 301, 605, 1102})
    whole = events(items)
    suite = build_suite(ARRAY, DetectParams(setting="wang2019"))
    for _ in range(2):
        singles = [
            event
            for item in items
            for part in (
                [item[k : k + 1] for k in range(len(item))] if isinstance(item, ScanBlock) else [item]
            )
            for event in suite.process(part)
        ]
        assert singles == whole
        suite.reset()


def test_the_bridge_is_a_straight_line_between_what_was_read() -> None:
    volts = np.array([[0.0], [1.0], [9.0], [9.0], [4.0]])
    block = regular_block(volts, 100.0)
    bridge = GapBridge()
    first, nothing, seen = [bridge.process(item) for item in (block[:2], Gap(2, "missing", 4), block[4:])]
    assert isinstance(first, ScanBlock)
    assert len(first) == 2
    assert nothing is None
    assert isinstance(seen, ScanBlock)
    assert seen.volts[:, 0] == pytest.approx([2.0, 3.0, 4.0])
    assert seen.index.tolist() == [2, 3, 4]
    assert seen.time_s == pytest.approx([0.02, 0.03, 0.04])


def test_a_scan_that_was_lost_has_no_grip_message() -> None:
    suite = build_suite(ARRAY, DetectParams(), topics=("slip", "contact", "grip"))
    items = with_holes({700, 701, 702, 703})
    of_s = [e.time_s for item in items for e in suite.process(item) if isinstance(e, GripEvent)]
    lost_s = set(BLOCK.time_s[700:704].tolist())
    assert len(of_s) > 100
    assert not lost_s & set(of_s)


def test_two_gaps_in_a_row_are_one() -> None:
    bridge = GapBridge()
    bridge.process(BLOCK[:100])
    assert bridge.process(Gap(4, "missing", 104)) is None
    assert bridge.process(Gap(5, "corrupt", 109)) == Gap(9, "corrupt", 109)
    after = bridge.process(BLOCK[109:110])
    assert isinstance(after, ScanBlock)
    assert len(after) == 1

"""Run-time changes of zero, speed, thresholds and inhibited intervals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import LSB, Touch, contact_states, onsets, pieces, run, slips, splits, textures

from tactiled.array import load_array
from tactiled.detect.contact.grip_detector import GripParams
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams, Suite, build_suite
from tactiled.detect.tuning import TunedSuite
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block

WANG = load_array("wang2019-3x3")
TOUCH = Touch().block(WANG)  # from 100 s on, scan 7 on: press at 0.5, slide at 4, stop at 8, lift at 10
START_S = 100.0
SELDOM = JointParams(hop_s=2.0)  # fits over a plate without grooves
OFFSET = np.linspace(-0.3, 0.45, 36)  # a zero that has drifted


def suite(**params: Any) -> TunedSuite:
    return TunedSuite(WANG, DetectParams(setting="wang2019", **params))


def shifted(block: ScanBlock) -> ScanBlock:
    return replace(block, volts=block.volts + OFFSET)


def rest(n: int = 100) -> ScanBlock:
    volts = 0.3e-3 * np.random.default_rng(0).normal(size=(n, 36))
    return regular_block(np.rint(volts / LSB) * LSB, 100.0, start_s=START_S - n / 100, index=7 - n)


@given(cuts=splits(len(TOUCH)))
@settings(deadline=None, max_examples=10)
def test_untouched_it_passes_everything_through(cuts: list[int]) -> None:
    plain = build_suite(WANG, DetectParams(setting="wang2019"))
    blocks = pieces(TOUCH, cuts)
    assert run(suite(), blocks) == run(plain, blocks)


def test_a_tare_takes_a_drifted_zero_away() -> None:
    tuned = suite()
    assert run(tuned, [shifted(rest())]) == []
    assert tuned.tare(force=False) == ("", [])
    assert tuned.zero is not None
    assert np.abs(tuned.zero - OFFSET).max() < 0.0005
    events = run(tuned, [shifted(TOUCH)])
    assert contact_states(events) == ["loading", "holding", "sliding", "holding", "none"]
    (onset,) = onsets(events)
    assert abs(onset.onset_s - START_S - 4.0) <= 3 * onset.onset_sd_s


@pytest.mark.parametrize(("at_s", "says"), [(0.8, "still move"), (3.0, "lift"), (6.0, "lift")])
def test_a_tare_under_load_is_refused_and_changes_nothing(at_s: float, says: str) -> None:
    tuned, plain = suite(), suite()
    n = round(100 * at_s)
    before = run(tuned, [TOUCH[:n]])
    reason, events = tuned.tare(force=False)
    assert says in reason
    assert events == []
    assert tuned.baseline_volts is None
    assert before + run(tuned, [TOUCH[n:]]) == run(plain, [TOUCH])


def test_a_forced_tare_ends_the_contact_with_an_event_that_is_not_valid() -> None:
    tuned = suite()
    run(tuned, [TOUCH[:300]])
    reason, events = tuned.tare(force=True)
    assert reason == ""
    (lost,) = events
    assert isinstance(lost, ContactEvent)
    assert (lost.state, lost.valid) == ("none", False)
    assert contact_states(run(tuned, [TOUCH[300:350]])) == []


def test_a_tare_needs_enough_good_readings_at_rest() -> None:
    tuned = suite()
    assert "only 0 scans" in tuned.tare(force=False)[0]
    run(tuned, [rest(40)])
    assert "only 40 scans" in tuned.tare(force=False)[0]
    tuned.process(Gap(0, "restart", 7))
    run(tuned, [rest(20)])
    assert "only 20 scans" in tuned.tare(force=False)[0]
    moving = rest(100)
    run(tuned, [replace(moving, volts=moving.volts + np.linspace(0, 0.1, 100)[:, np.newaxis])])
    assert "still move" in tuned.tare(force=False)[0]
    assert tuned.tare(force=True)[0] == ""
    invalid = rest(100)
    invalid.valid[50:56, 3] = False
    tuned = suite()
    run(tuned, [invalid])
    assert "channels [3]" in tuned.tare(force=True)[0]


@given(places=st.lists(st.integers(50, 99), max_size=5, unique=True), value=st.sampled_from([np.nan, 5.0]))
@settings(deadline=None, max_examples=20)
def test_readings_that_are_not_valid_are_no_part_of_a_zero(places: list[int], value: float) -> None:
    block = shifted(rest())
    block.volts[places, 3], block.valid[places, 3] = value, False
    tuned = suite()
    run(tuned, [block])
    assert tuned.tare(force=False) == ("", [])
    assert tuned.zero is not None
    assert tuned.zero[3] == pytest.approx(OFFSET[3], abs=0.0005)


def test_the_zero_is_the_mean_of_the_newest_scans_however_they_came() -> None:
    zeros = []
    for size in (1, 7, 300):
        tuned = suite()
        run(tuned, pieces(rest(300), list(range(size, 300, size))))
        assert len(tuned._recent) <= 50  # noqa: SLF001 (memory bound has no public sign)
        tuned.tare(force=False)
        assert tuned.baseline_volts is not None
        zeros.append(tuned.baseline_volts.tolist())
    assert zeros[0] == zeros[1] == zeros[2]


@pytest.mark.parametrize(
    ("from_s", "duration_s", "valid"),
    [(3.5, 1.0, False), (3.9, 0.2, False), (4.05, 0.5, False), (1.0, 1.0, True), (4.5, 1.0, True)],
)
def test_slips_that_begin_while_inhibited_are_published_as_not_valid(
    from_s: float, duration_s: float, valid: bool
) -> None:
    tuned = suite()
    n = round(100 * from_s)
    events = run(tuned, [TOUCH[:n]])
    tuned.inhibit(START_S + from_s, duration_s)
    events += run(tuned, [TOUCH[n:]])
    (onset,) = onsets(events)
    assert onset.valid is valid
    assert slips(events)[-1].valid is valid  # the end, at 8 s, goes with it
    assert {e.suppressed for e in slips(events)} == {"" if valid else "inhibit"}
    assert [replace(e, valid=True, suppressed="") for e in slips(events)] == slips(run(suite(), [TOUCH]))


def test_an_inhibited_interval_can_be_extended_and_ended() -> None:
    tuned = suite()
    tuned.inhibit(10.0, 2.0)
    assert tuned.inhibited_s(11.0) == 1.0
    tuned.inhibit(11.0, 5.0)
    assert tuned.inhibited_s(11.0) == 5.0
    tuned.inhibit(12.0, 0.0)
    assert tuned.inhibited_s(12.0) == 0.0
    tuned.inhibit(12.5, 1.0)  # ended, so this is another
    assert tuned.inhibited_s(12.5) == 1.0


class ScriptedSlips:
    """Report an incipient slip, its transition to gross slip and its end at given instants."""

    hidden_below = 0.0

    def __init__(self, onset_s: float) -> None:
        self._onset_s = onset_s

    def reset(self) -> None: ...

    def process(self, _: ScanBlock | Gap) -> list[Event]:
        first = SlipEvent(
            time_s=self._onset_s, state="onset", kind="incipient", onset_s=self._onset_s, onset_sd_s=0.01,
            direction_deg=0.0, direction_sd_deg=1.0, confidence=1.0, taxels=(0,), detector="test",
            statistic=1.0, threshold=1.0, valid=True, detected_s=self._onset_s + 0.05,
        )  # fmt: skip
        deeper = replace(first, kind="gross", onset_s=first.onset_s + 0.3, detected_s=first.onset_s + 0.4)
        return [first, deeper, replace(deeper, state="end", detected_s=first.onset_s + 1)]


@pytest.mark.parametrize(
    ("onset_s", "valid"),
    [
        (9.0, (True, True, True)),
        (9.99, (False, True, True)),  # found in it
        (10.5, (False, True, True)),  # a slide is one, whatever load was expected
        (12.1, (True, True, True)),
    ],
)
def test_while_a_change_of_load_is_expected_incipient_slips_are_not_valid(
    onset_s: float, valid: tuple[bool, ...]
) -> None:
    tuned = TunedSuite(WANG, DetectParams(), lambda *_: Suite(ScriptedSlips(onset_s), None))
    tuned.expect_load_change(10.0, 1.0)
    tuned.expect_load_change(10.9, 1.1)
    said = [e for e in tuned.process(rest(1)) if isinstance(e, SlipEvent)]
    assert tuple(event.valid for event in said) == valid
    assert [e.suppressed for e in said] == ["" if told else "load-change" for told in valid]


def test_every_published_onset_is_followed_by_a_published_end() -> None:
    tuned = TunedSuite(WANG, DetectParams(), lambda *_: Suite(ScriptedSlips(10.0), None))
    tuned.inhibit(10.1, 2.0)  # said at 10.05 already; gross at 10.4
    first, gross, end = (e for e in tuned.process(rest(1)) if isinstance(e, SlipEvent))
    assert (first.valid, first.suppressed) == (True, "")
    assert (gross.valid, gross.suppressed) == (False, "inhibit")
    assert (end.state, end.valid, end.suppressed) == ("end", True, "")
    tuned.reset()
    tuned.expect_load_change(9.0, 1.0)  # told of none before its gross slip
    tuned.inhibit(10.35, 1.0)
    said = [e for e in tuned.process(rest(1)) if isinstance(e, SlipEvent)]
    assert [e.suppressed for e in said] == ["load-change", "inhibit", "inhibit"]
    assert not any(e.valid for e in said)


def test_a_slip_whose_onset_came_late_has_no_valid_end() -> None:
    block = replace(TOUCH, late=(TOUCH.time_s > START_S + 3.9) & (TOUCH.time_s < START_S + 6.0))
    found = slips(run(suite(), [block]))
    assert [(event.state, event.valid) for event in found] == [("onset", False), ("end", False)]


def test_thresholds_are_checked_by_name_and_bound() -> None:
    tuned = suite()
    before = tuned.params
    for values, says in (
        ({"grip.gros_p": 0.4}, "grip.gros_p: unknown key; did you mean gross_p?"),
        ({"grip.gross_p": -1.0}, "grip.gross_p: "),
        ({"texture.max_harmonics": 2.5}, "texture.max_harmonics: "),
        ({"grip": 1.0}, "grip: "),
        ({"grip.gross_p.x": 1.0}, "gross_p is no table"),
        ({"": 1.0}, "begin with grip or texture"),
        ({"setting.x": 1.0}, "begin with grip or texture"),
        ({"grip.gross_p": 0.4, "grip.contact.nonsense": 1.0}, "grip.contact.nonsense"),
    ):
        reason, events = tuned.set_thresholds(values)
        assert says in reason, values
        assert events == []
        assert tuned.params is before


def test_a_threshold_holds_from_the_next_scan_on() -> None:
    params = DetectParams(texture=SELDOM, grip=GripParams(publish=False))
    tuned = TunedSuite(WANG, params)
    events = run(tuned, [TOUCH[:300]])
    wanted = {"grip.incipient_p": 0.999999, "grip.gross_p": 0.999999, "grip.contact.contact_volts": 0.6}
    reason, brought = tuned.set_thresholds(wanted)
    assert reason == ""
    assert contact_states(brought) == ["none"]
    events += brought + run(tuned, [TOUCH[300:]])
    assert onsets(events) == []
    assert tuned.params.grip.contact.contact_volts == 0.6
    assert tuned.set_thresholds({"grip.gross_p": 0.999999}) == ("", [])  # as it is already
    tuned.reset()
    assert tuned.params == params


def test_speed_holds_through_a_change_of_thresholds() -> None:
    touch = Touch(grooves=(1.2, 0.0), stop_s=26.0, lift_s=27.0, end_s=28.0).block(WANG)

    def speeds(events: list[Event]) -> set[float]:
        return {event.speed_mm_s for event in textures(events)}

    tuned = suite()
    assert speeds(run(tuned, [touch])) == {0.0}
    tuned.reset()
    tuned.set_speed(1.0)
    tuned.set_thresholds({"grip.gross_p": 0.49})
    events = run(tuned, [touch])
    assert speeds(events) == {1.0}
    assert any(event.status == "ok" for event in textures(events))


@pytest.mark.parametrize("configured", [0.0, 1.0])
def test_the_newest_of_speed_and_its_threshold_holds(configured: float) -> None:
    touch = Touch(grooves=(1.2, 0.0), stop_s=26.0, lift_s=27.0, end_s=28.0).block(WANG)
    tuned = suite(texture=JointParams(speed_mm_s=configured))
    tuned.set_speed(2.0)
    assert tuned.set_thresholds({"texture.speed_mm_s": 1.0}) == ("", [])
    assert {event.speed_mm_s for event in textures(run(tuned, [touch]))} == {1.0}


def test_the_newest_of_friction_and_its_threshold_holds() -> None:
    def frictions(*commands: str) -> list[Event]:
        tuned = TunedSuite(WANG, DetectParams())
        for command in commands:
            if command == "friction":
                assert tuned.state_friction(0.9, 0.1) == ""
            else:
                assert tuned.set_thresholds({"grip.friction": 0.3}) == ("", [])
        return run(tuned, [TOUCH])

    assert frictions("threshold", "friction", "threshold") == frictions("threshold")
    assert frictions("friction", "threshold") == frictions("threshold")
    assert frictions("threshold", "friction") != frictions("threshold")


def test_another_board_discards_the_zero() -> None:
    tuned = suite()
    run(tuned, [rest()])
    tuned.tare(force=False)
    tuned.forget_zero()
    assert tuned.baseline_volts is None


calls = st.lists(
    st.one_of(
        st.tuples(st.just("tare"), st.booleans()),
        st.tuples(st.just("speed"), st.floats(0, 10)),
        st.tuples(st.just("inhibit"), st.floats(0, 2)),
        st.tuples(st.just("thresholds"), st.floats(0.3, 0.7)),
    ),
    max_size=4,
)


@given(
    cuts=splits(len(TOUCH)), calls=calls, places=st.lists(st.integers(0, len(TOUCH)), min_size=4, max_size=4)
)
@settings(deadline=None, max_examples=10)
def test_the_same_calls_between_the_same_scans_bring_the_same_events(
    cuts: list[int], calls: list[tuple[str, Any]], places: list[int]
) -> None:
    def play(all_cuts: list[int]) -> list[Event]:
        tuned = suite()
        events: list[Event] = []
        at = sorted(zip(places, calls, strict=False), key=lambda entry: entry[0])
        bounds = sorted({*all_cuts, *(place for place, _ in at), 0, len(TOUCH)})
        for begin, end in zip(bounds, [*bounds[1:], len(TOUCH)], strict=True):
            for place, (name, value) in at:
                if place == begin:
                    if name == "tare":
                        events += tuned.tare(force=value)[1]
                    elif name == "speed":
                        tuned.set_speed(value)
                    elif name == "inhibit":
                        tuned.inhibit(START_S + begin / 100, value)
                    else:
                        events += tuned.set_thresholds({"grip.gross_p": value})[1]
            if end > begin:
                events += tuned.process(TOUCH[begin:end])
        return events

    assert play(cuts) == play([])


@pytest.fixture(scope="module")
def with_grip() -> list[Event]:
    return TunedSuite(WANG, DetectParams(texture=SELDOM)).process(TOUCH)


def test_an_inhibition_covers_grip_messages_of_its_time_only(with_grip: list[Event]) -> None:
    plain = [e for e in with_grip if isinstance(e, GripEvent)]
    tuned = TunedSuite(WANG, DetectParams(texture=SELDOM))
    tuned.inhibit(103.0, 0.5)
    marked = [e for e in tuned.process(TOUCH) if isinstance(e, GripEvent)]
    assert len(plain) == len(marked) > 800
    for before, after in zip(plain, marked, strict=True):
        covered = 103.0 <= before.time_s <= 103.5
        assert after == (replace(before, valid=False, suppressed="inhibit") if covered else before)


def test_grip_messages_leave_the_other_events_alone(with_grip: list[Event]) -> None:
    others = [e for e in with_grip if not isinstance(e, GripEvent)]
    without = DetectParams(texture=SELDOM, grip=GripParams(publish=False))
    assert others == TunedSuite(WANG, without).process(TOUCH)
    assert [e.evidence_s for e in with_grip] == sorted(e.evidence_s for e in with_grip)


@pytest.mark.parametrize(
    ("from_s", "duration_s", "hidden"), [(2.0, 0.0, ""), (1.9, 0.05, ""), (1.9, 0.15, "load-change")]
)
def test_a_slip_is_suppressed_only_if_it_begins_or_is_detected_in_the_interval(
    from_s: float, duration_s: float, hidden: str
) -> None:
    found = SlipEvent(
        time_s=1.8, state="onset", kind="incipient", onset_s=1.8, onset_sd_s=0.1, direction_deg=0.0,
        direction_sd_deg=1.0, confidence=1.0, taxels=(), detector="grip", statistic=1.0, threshold=0.0,
        valid=True, detected_s=2.0,
    )  # fmt: skip
    tuned = TunedSuite(WANG, DetectParams(), build=lambda *_: Says([found]))  # type: ignore[arg-type]
    tuned.expect_load_change(from_s, duration_s)
    (said,) = tuned.process(TOUCH)
    assert isinstance(said, SlipEvent)
    assert said.suppressed == hidden


class Says:
    """Suite that gives the same events for every item, and keeps the items."""

    def __init__(self, events: list[Event]) -> None:
        self.events, self.items = events, list[ScanBlock | Gap]()

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        self.items.append(item)
        return self.events


def test_a_gap_after_another_board_reaches_the_detectors_while_its_zero_is_awaited() -> None:
    says, gap = Says([]), Gap(0, "disconnect", 300)
    array = replace(WANG, zero_first_s=0.3)
    tuned = TunedSuite(array, DetectParams(), build=lambda *_: says)  # type: ignore[arg-type]
    tuned.process(rest())
    tuned.forget_zero()
    tuned.process(gap)
    assert says.items[1:] == [gap]


def test_a_level_of_contact_below_that_of_release_is_refused() -> None:
    tuned = suite()
    reason, _ = tuned.set_thresholds({"grip.contact.contact_volts": 0.1})
    assert "contact_volts (0.1) must be above release_volts (0.15)" in reason
    assert tuned.params == suite().params

"""Contact of pads whose array file gives no level: magnetic fields, and skins that keep a set."""

from dataclasses import replace

import numpy as np
import pytest
from contact_gate import ContactGate
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from touches import contact_states

from tactiled import tomlfile
from tactiled.array import Array, ArrayFile, ContactLevels, FloatArray, build
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.signal.contact_gate import ContactParams
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import ContactEvent, SlipEvent
from tactiled.samples.block import Gap, regular_block

RATE_HZ = 100.0
NOISE = 2.0
LOAD = 3000.0


def pad(unit: str, *kinds: str) -> Array:
    channels = [{"name": f"C{k}", "kind": kind} for k, kind in enumerate(kinds)]
    file = {
        "name": "pad",
        "unit": unit,
        "range": [-32768, 32767],
        "taxel_count": 4,
        "taxel_channels": channels,
    }
    return build(tomlfile.parse(file, ArrayFile, "pad"))


COUNTS, FIELD = pad("count", "normal"), pad("uT", "shear_x", "shear_y", "normal")


def readings(load: FloatArray, of_channel: FloatArray) -> FloatArray:
    noise = NOISE * np.random.default_rng(0).normal(size=(len(load), len(of_channel)))
    return load[:, np.newaxis] * of_channel + noise


def press(hold_s: float, left: float, after_s: float = 30.0) -> FloatArray:
    """Load over time: 2 s of rest, a press, then what is left of it and decays with 20 s."""
    rest, held = np.zeros(round(2 * RATE_HZ)), np.full(round(hold_s * RATE_HZ), LOAD)
    after = left * LOAD * np.exp(-np.arange(round(after_s * RATE_HZ)) / (20 * RATE_HZ))
    return np.concatenate([rest, held, after])


def contacts(
    array: Array,
    values: FloatArray,
    valid: NDArray[np.bool_] | None = None,
    params: ContactParams | None = None,
) -> list[ContactEvent]:
    events = ContactGate(array, params).process(regular_block(values, RATE_HZ, valid=valid))
    return [event for event in events if isinstance(event, ContactEvent)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_field_that_falls_is_a_contact_as_one_that_rises(sign: float) -> None:
    of_channel = np.array([0.1, 0, 1, 0.1, 0, -1, 0.1, 0, 1, 0.1, 0, -1]) * sign
    events = contacts(FIELD, readings(press(5.0, 0.0), of_channel))
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[1].taxels == (0, 1, 2, 3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_channel_of_a_field_that_jumps_is_no_contact(sign: float) -> None:
    chips = pad("uT", "shear_x", "normal", "normal", "normal", "normal")
    together = contacts(chips, readings(press(2.0, 0.0), np.tile([0.0, sign, sign, sign, sign], 4)))
    assert [event.state for event in together] == ["loading", "holding", "none"]
    alone = np.zeros(20)
    alone[1] = sign
    assert contacts(chips, readings(press(2.0, 0.0), alone)) == []


def test_a_light_hold_after_a_long_press_goes_on_where_shear_over_load_is_measured() -> None:
    axes = pad("count", "shear_x", "shear_y", "normal")
    events = contacts(axes, readings(press(20.0, 0.1, after_s=5.0), np.tile([0.0, 0.0, 1.0], 4)))
    assert "none" not in [event.state for event in events]


def test_an_object_that_is_lost_ends_the_contact_though_the_skin_keeps_a_little() -> None:
    axes = pad("count", "shear_x", "shear_y", "normal")
    events = contacts(axes, readings(press(20.0, 0.03, after_s=5.0), np.tile([0.2, 0.0, 1.0], 4)))
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[-1].time_s == pytest.approx(22.0, abs=0.05)


def test_what_a_long_press_leaves_in_a_soft_skin_is_no_contact() -> None:
    events = contacts(COUNTS, readings(press(20.0, 0.06), np.ones(4)))
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[-1].time_s == pytest.approx(22.0, abs=0.05)


def test_a_chip_beside_the_press_keeps_the_set_of_the_skin() -> None:
    of_chips = np.zeros((4, 3))
    of_chips[:, 2] = [1.0, 1.0, -1.0, 0.3]
    load, held = press(20.0, 0.0, after_s=5.0), round(22 * RATE_HZ)
    values = readings(load, of_chips.ravel())
    values[held:, 2::3] += 0.06 * LOAD * np.array([1.0, 1.0, -1.0, 1.0])  # 20 % of its own press for the last
    assert [event.state for event in contacts(FIELD, values)] == ["loading", "holding", "none"]
    of_counts = np.hstack([values[:, 2:9:3] * [1.0, 1.0, -1.0], 3.0 * values[:, 11:]])
    assert "none" not in [event.state for event in contacts(COUNTS, of_counts)]  # a cell feels its own press


def test_a_hold_after_a_press_goes_on_and_a_light_one_is_found_again_after_minutes() -> None:
    firm = contacts(COUNTS, readings(press(1.0, 0.2, after_s=12.0), np.ones(4)))
    assert "none" not in [event.state for event in firm]
    load = np.concatenate([press(1.0, 0.0), np.full(round(350 * RATE_HZ), 0.05 * LOAD)])
    lost, again = contacts(COUNTS, readings(load, np.ones(4)))[2:4]
    assert (lost.state, again.state) == ("none", "unknown")  # it is no new press
    # 0.15 of 0.993 of the press (1 s of it, followed with 0.2 s), forgotten with 300 s, is 0.05 then; by 0.5
    # counts a second, so that noise of a few counts finds it some seconds earlier.
    assert again.time_s - lost.time_s == pytest.approx(300 * np.log(0.15 * 0.993 / 0.05), rel=0.05)


def test_set_and_largest_load_are_not_added() -> None:
    events = contacts(COUNTS, readings(press(60.0, 0.22, after_s=5.0), np.ones(4)))
    assert "none" not in [event.state for event in events]  # the set is 13 % of the press by then


@pytest.mark.parametrize("n_lost", [1, 30])
def test_what_is_not_valid_hides_no_touch(n_lost: int) -> None:
    values = readings(np.concatenate([np.zeros(500), np.full(400, 0.07 * LOAD)]), np.ones(4))
    values[100 : 100 + n_lost] = 4095.0
    valid = np.ones(values.shape, dtype=np.bool_)
    valid[100 : 100 + n_lost] = False
    events = ContactGate(COUNTS).process(regular_block(values, RATE_HZ, valid=valid))
    found = [event for event in events if isinstance(event, ContactEvent) and event.time_s > 3.0]
    assert found[0].state == "loading"
    assert found[0].time_s == pytest.approx(5.0, abs=0.05)


def test_a_press_of_one_pad_hides_no_touch_of_another() -> None:
    both = replace(COUNTS, pad=np.array([0, 0, 1, 1]))
    first, second = press(3.0, 0.0, after_s=40.0), np.zeros(round(45 * RATE_HZ))
    second[round(15 * RATE_HZ) :] = 0.08 * LOAD
    values = readings(first, np.array([1.0, 1.0, 0.0, 0.0])) + np.outer(second, [0.0, 0.0, 1.0, 1.0])
    assert [event.state for event in contacts(both, values)][3:] == ["loading", "holding"]
    assert [event.state for event in contacts(COUNTS, values)] == ["loading", "holding", "none"]


def test_a_touch_that_was_hidden_before_a_gap_is_no_new_press() -> None:
    values = readings(
        np.concatenate([press(3.0, 0.0), np.full(round(60 * RATE_HZ), 0.14 * LOAD)]), np.ones(4)
    )
    detector = GripDetector(COUNTS)
    detector.process(regular_block(values[:3600], RATE_HZ))
    detector.process(Gap(1, "missing", 3601))
    events = detector.process(regular_block(values[3601:], RATE_HZ, start_s=36.01, index=3601))
    assert contact_states(events)[:1] == ["unknown"]


def test_the_load_that_hides_a_touch_is_known() -> None:
    suites = [build_suite(COUNTS, DetectParams()) for _ in range(2)]
    values = readings(press(3.0, 0.0, after_s=60.0), np.ones(4))
    for suite in suites:
        suite.process(regular_block(values, RATE_HZ))
    below = suite.hidden_below
    assert below == pytest.approx(0.15 * LOAD * np.exp(-60 / 300), rel=0.02)
    for suite, load, states in zip(suites, (0.98 * below, 1.1 * below), ([], ["loading"]), strict=True):
        touch = readings(np.full(50, load), np.ones(4))
        after = regular_block(touch, RATE_HZ, start_s=len(values) / RATE_HZ, index=len(values))
        found = [event for event in suite.process(after) if isinstance(event, ContactEvent)]
        assert [event.state for event in found][:1] == states
    given = replace(COUNTS, contact=ContactLevels(above=100.0, below=60.0, loading_per_s=10.0))
    of_levels = build_suite(given, DetectParams())
    of_levels.process(regular_block(values[:1000], RATE_HZ))
    assert of_levels.hidden_below == 0.0


@pytest.mark.parametrize("left", [0.03, 0.08])
@pytest.mark.parametrize("takes_s", [0.1, 4.0])
def test_a_press_on_what_the_last_one_left_is_loading(left: float, takes_s: float) -> None:
    rest = np.full(round(5 * RATE_HZ), left * LOAD)
    again = np.linspace(left * LOAD, LOAD, round(takes_s * RATE_HZ))
    load = np.concatenate([press(3.0, 0.0, after_s=0.0), rest, again, np.full(300, LOAD)])
    states = [event.state for event in contacts(COUNTS, readings(load, np.ones(4)))]
    assert states == ["loading", "holding", "none", "loading", "holding"]


def test_a_load_that_is_not_read_is_not_steady() -> None:
    values = readings(press(2.0, 0.0), np.ones(4))
    values[round(2.4 * RATE_HZ) : round(2.65 * RATE_HZ)] = np.nan
    events = contacts(COUNTS, values)
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[1].time_s >= 2.65


def test_scans_without_any_reading_end_no_contact() -> None:
    values = readings(press(2.0, 0.0), np.ones(4))
    whole = contacts(COUNTS, values)
    values[round(3 * RATE_HZ) : round(3.2 * RATE_HZ)] = np.nan
    assert contacts(COUNTS, values) == whole
    assert [event.state for event in whole] == ["loading", "holding", "none"]
    values[round(3 * RATE_HZ) :] = np.nan
    events = contacts(COUNTS, values)
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[-1].time_s == pytest.approx(3.3, abs=0.05)  # as far back as the slope looks


@given(release=st.floats(1.0, 2 * LOAD))
def test_a_level_of_release_alone_makes_no_contact_flap(release: float) -> None:
    values = readings(press(4.0, 0.0), np.ones(4))
    events = contacts(COUNTS, values, params=ContactParams(release_volts=release))
    assert [event.state for event in events] == ["loading", "holding", "none"]


def test_a_level_of_contact_alone_is_the_level_after_any_press() -> None:
    light = np.concatenate([press(2.0, 0.0, after_s=1.0), np.full(300, 0.05 * LOAD), np.zeros(100)])
    events = contacts(COUNTS, readings(light, np.ones(4)), params=ContactParams(contact_volts=0.02 * LOAD))
    assert [event.state for event in events] == ["loading", "holding", "none"] * 2


@given(
    st.integers(300, 500), st.integers(1, 30), st.sampled_from([0.0, np.nan]), st.sampled_from([[2], [1, 2]])
)
def test_a_taxel_that_is_not_read_for_a_while_ends_no_contact(
    first: int, n_scans: int, value: float, pressed: list[int]
) -> None:
    of_channel = np.isin(np.arange(4), pressed).astype(np.float64)
    values = readings(press(4.0, 0.0), of_channel)
    is_read = np.ones(values.shape, dtype=np.bool_)
    values[first : first + n_scans, 2], is_read[first : first + n_scans, 2] = value, False
    events = contacts(COUNTS, values, is_read)
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[-1].valid


def test_a_contact_that_ends_because_its_taxel_is_not_read_any_more_has_no_valid_end() -> None:
    values = readings(press(4.0, 0.0), np.array([0.0, 0.0, 1.0, 0.0]))
    values[round(3 * RATE_HZ) :, 2] = np.nan
    events = contacts(COUNTS, values)
    assert [(event.state, event.valid) for event in events] == [
        ("loading", True),
        ("holding", True),
        ("none", False),
    ]
    assert events[-1].time_s == pytest.approx(3.3, abs=0.05)
    values = readings(press(4.0, 0.0), np.array([0.0, 0.0, 1.0, 0.0]))
    values[round(5.9 * RATE_HZ) :, 1] = np.nan  # a taxel that bears nothing
    assert [(event.state, event.valid) for event in contacts(COUNTS, values)][-1] == ("none", True)


def test_one_wrong_scan_hides_no_touch() -> None:
    load = np.concatenate([np.zeros(500), np.full(400, 0.05 * LOAD)])
    load[400] = 2 * LOAD
    events = contacts(COUNTS, readings(load, np.ones(4)))
    assert [event.state for event in events[2:]] == ["loading", "holding"]
    assert events[2].time_s == pytest.approx(5.0, abs=0.05)


def test_taps_from_the_first_scan_on_are_no_noise_for_long() -> None:
    taps = 0.02 * LOAD * 20 * np.clip(np.sin(2 * np.pi * 1.5 * np.arange(1200) / RATE_HZ), 0, 1)
    events = contacts(COUNTS, readings(taps, np.ones(4)))
    assert sum(event.state == "none" for event in events) == pytest.approx(18, abs=1)


def test_what_comes_back_within_seconds_of_a_press_is_no_contact() -> None:
    load = press(2.0, 0.0, after_s=20.0)
    released = round(4.0 * RATE_HZ)
    load[released:] = 0.08 * LOAD * np.exp(-np.arange(len(load) - released) / (4.0 * RATE_HZ))
    events = contacts(COUNTS, readings(load, np.ones(4)))
    assert [event.state for event in events] == ["loading", "holding", "none"]
    assert events[-1].time_s == pytest.approx(4.0, abs=0.05)


def test_the_set_decays() -> None:
    load = np.concatenate([press(20.0, 0.0, after_s=120.0), np.full(300, 0.12 * LOAD)])
    events = contacts(COUNTS, readings(load, np.ones(4)))
    assert [event.state for event in events] == ["loading", "holding", "none", "loading", "holding"]


def test_missing_scans_leave_noise_and_set_as_they_are() -> None:
    values = readings(press(20.0, 0.06), np.ones(4))
    cut = round(21.5 * RATE_HZ)
    detector = GripDetector(COUNTS)
    detector.process(regular_block(values[:cut], RATE_HZ))
    lost = detector.process(Gap(100, "missing", cut + 100))
    assert contact_states(lost) == ["none"]
    after = regular_block(values[cut + 100 :], RATE_HZ, start_s=(cut + 100) / RATE_HZ, index=cut + 100)
    assert detector.process(after) == []  # the press ended in the gap: what is left is the set
    again = GripDetector(COUNTS)
    again.process(regular_block(values[:cut], RATE_HZ))
    again.process(Gap(0, "restart", cut + 100))
    assert contact_states(again.process(after))[0] == "unknown"


def test_any_chunking_gives_the_same_contacts() -> None:
    values = readings(press(5.0, 0.06), np.ones(4))
    block, gate = regular_block(values, RATE_HZ), ContactGate(COUNTS)
    found = [event for first in range(0, len(values), 7) for event in gate.process(block[first : first + 7])]
    assert found == contacts(COUNTS, values)


def test_no_load_is_called_hidden_that_would_not_be_told_in_any_case() -> None:
    noise = np.random.default_rng(5).normal(0.0, 2.0, (round(20 * RATE_HZ), 4))
    suite = build_suite(COUNTS, DetectParams())
    suite.process(regular_block(np.rint(noise), RATE_HZ))
    assert suite.hidden_below == 0.0


def swinging(array: Array, seed: int, *, is_even: bool) -> tuple[FloatArray, FloatArray]:
    """Readings (n, channels) that swing at 6 Hz, each on its own, by ten times their noise; a touch (n,)."""
    rng, n, warm = np.random.default_rng(seed), round(20 * RATE_HZ), 500
    turn, fades = 2 * np.pi * 6 / RATE_HZ, np.exp(-5 / RATE_HZ)
    if is_even:
        swing = np.sqrt(2) * np.sin(turn * np.arange(n)[:, np.newaxis] + rng.uniform(0, 7, array.n_channels))
    else:  # a resonance that noise excites
        swing = rng.normal(size=(n + warm, array.n_channels))
        for k in range(2, len(swing)):
            swing[k] += 2 * fades * np.cos(turn) * swing[k - 1] - fades**2 * swing[k - 2]
        swing = swing[warm:] / swing.std(axis=0)
    since_s = np.arange(n) / RATE_HZ - 12.0
    touch = np.clip(since_s / 0.2, 0, 1) * (since_s < 3.0)
    of_channel = np.where(np.array(array.channel_kind) == "normal", 1.0, 0.1)
    noise = NOISE * rng.normal(size=(n, array.n_channels))
    return 10 * NOISE * swing + noise + LOAD / 4 * touch[:, np.newaxis] * of_channel, touch


@pytest.mark.parametrize("is_even", [True, False])
@pytest.mark.parametrize("array", [COUNTS, FIELD, pad("count", "shear_x", "shear_y", "normal")])
def test_readings_that_swing_at_rest_are_no_contact_and_a_touch_in_them_is_one(
    array: Array, *, is_even: bool
) -> None:
    declared = replace(array, zero=np.zeros(array.n_channels), zero_first_s=0.3)
    at_rest, found = [], []
    for seed in range(3):
        values, touch = swinging(declared, seed, is_even=is_even)
        suite = build_suite(declared, DetectParams(), topics=("slip", "contact"))
        block = regular_block(values, RATE_HZ)
        events = suite.process(block)
        onsets = [event for event in events if isinstance(event, SlipEvent) and event.state == "onset"]
        assert not [slip for slip in onsets if slip.kind == "gross" and not 12 < slip.detected_s < 18]
        changes = [event for event in events if isinstance(event, ContactEvent)]
        is_on = np.array([False, *(event.state != "none" for event in changes)])
        in_contact = is_on[np.searchsorted([e.time_s for e in changes], block.time_s, side="right")]
        at_rest.append(in_contact[touch == 0].mean())
        found.append(in_contact[touch > 0.2].mean())
    assert float(np.mean(at_rest)) < 0.04
    assert min(found) > 0.99


@pytest.mark.parametrize("array", [COUNTS, pad("count", "shear_x", "shear_y", "normal")])
@pytest.mark.parametrize("rest_s", [0.0, 2.0])
def test_a_hold_after_a_swing_is_in_contact_within_seconds(array: Array, rest_s: float) -> None:
    """The swing has stopped, so that its level no longer counts: also while something is held."""
    declared = replace(array, zero=np.zeros(array.n_channels), zero_first_s=0.3)
    rng, time_s = np.random.default_rng(3), np.arange(round(30 * RATE_HZ)) / RATE_HZ
    swing = np.where((time_s > 2) & (time_s < 5), np.sin(2 * np.pi * 6 * time_s), 0.0)
    held_from_s = 5.0 + rest_s
    of_channel = np.where(np.array(array.channel_kind) == "normal", 1.0, 0.1)
    load = 20 * NOISE * swing + 100 * NOISE * (time_s > held_from_s)
    values = load[:, np.newaxis] * of_channel + NOISE * rng.normal(size=(len(time_s), array.n_channels))
    suite = build_suite(declared, DetectParams(), topics=("slip", "contact"))
    changes = [one for one in suite.process(regular_block(values, RATE_HZ)) if isinstance(one, ContactEvent)]
    is_on = np.array([False, *(event.state != "none" for event in changes)])
    in_contact = is_on[np.searchsorted([e.time_s for e in changes], time_s, side="right")]
    assert in_contact[time_s > held_from_s + 2.5].all()

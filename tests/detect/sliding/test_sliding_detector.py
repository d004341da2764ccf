"""Slip of arrays without shear channels: roughness and ripple are found, and shaking bodies are not."""

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import Array, ArrayFile, FloatArray, build
from tactiled.detect.base import Detector
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.sliding.tracker import _spectra, _strongest_patterns, travelling_line
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import UNKNOWN_SD_DEG, ContactEvent, Event, SlipEvent, TextureEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.tomlfile import parse

RATE_HZ = 36.0
SLIDE_S = (6.0, 11.0)
N = round(14 * RATE_HZ)
SIDE = np.arange(16) % 4 - 1.5, np.arange(16) // 4 - 1.5


@functools.cache
def pad(n_taxels: int = 16) -> Array:
    return array_of({"taxel_count": n_taxels})


def array_of(more: dict[str, object]) -> Array:
    document = {"name": "pad", "unit": "count", "range": [-500, 3500]} | more
    return build(parse({**document, "taxel_channels": [{"name": "N", "kind": "normal"}]}, ArrayFile, "test"))


def hold(seed: int, extra: FloatArray | float = 0.0, press_s: float = 1.0) -> ScanBlock:
    """Return a press to 800 counts, unequal over the taxels and times 1 + extra, in noise of 2 counts."""
    rng = np.random.default_rng(seed)
    t = np.arange(N)[:, np.newaxis] / RATE_HZ
    load = 500 * rng.uniform(0.6, 1.4, 16) * np.clip(t - press_s, 0, 1)
    return regular_block(np.rint(load * (1 + extra) + 2 * rng.standard_normal((N, 16))), RATE_HZ)


def travel(from_s: float = SLIDE_S[0], to_s: float = SLIDE_S[1]) -> FloatArray:
    return np.asarray(8.0 * np.clip(np.arange(N) / RATE_HZ - from_s, 0, to_s - from_s))


def rough(seed: int, from_s: float = SLIDE_S[0], to_s: float = SLIDE_S[1]) -> FloatArray:
    """Relative load (n, 16) under taxels 4 mm apart that slide over a plate of random waves of 1 to 5 mm."""
    rng = np.random.default_rng(seed)
    x, y = travel(from_s, to_s)[:, np.newaxis] + 4 * SIDE[0], 4 * SIDE[1]
    relief = np.zeros((N, 16))
    for _ in range(40):
        k, turn = 2 * np.pi / rng.uniform(1, 5), rng.uniform(0, 2 * np.pi)
        relief += np.cos(k * (x * np.cos(turn) + y * np.sin(turn)) + rng.uniform(0, 2 * np.pi))
    return np.asarray(0.005 * relief)


def ridges(period_mm: float = 3.0) -> FloatArray:
    angle = np.radians(20)
    x, y = travel()[:, np.newaxis] + 4 * SIDE[0], 4 * SIDE[1]
    return np.asarray(0.05 * np.cos(2 * np.pi / period_mm * (x * np.cos(angle) + y * np.sin(angle))))


def shakes(kind: str) -> FloatArray:
    """Relative load (n, 16) as of a rigid body: the load and two tilts."""
    t = np.arange(N)[:, np.newaxis] / RATE_HZ
    rng = np.random.default_rng(4)
    if kind == "hum":
        phase = 2 * np.pi * 11.3 * t
        return np.asarray((0.05 * np.cos(phase) + 0.03 * SIDE[0] * np.sin(phase + 0.4)) * (t > 5))
    if kind == "tremor":
        slow = np.cumsum(rng.standard_normal((N, 3)), axis=0) * 0.003
        slow -= slow.mean(axis=0)
        return np.asarray(slow[:, :1] + slow[:, 1:2] * SIDE[0] / 2 + slow[:, 2:] * SIDE[1] / 2)
    if kind == "taps":
        taps = np.array([np.abs(t - s) < 0.04 for s in (5.0, 6.1, 7.4, 9.0)]).any(axis=0)
        return np.asarray(0.3 * taps * (1 + 0.2 * SIDE[0]))
    return np.asarray(0.6 * np.clip((t - 6) / 0.3, 0, 1))  # a firmer grip


def detector(speed_mm_s: float = 0.0) -> Detector:
    params = DetectParams(texture=JointParams(speed_mm_s=speed_mm_s))
    return build_suite(pad(), params, topics=("slip", "contact", "texture") if speed_mm_s else ("slip",))


def slips(events: list[Event]) -> list[SlipEvent]:
    return [event for event in events if isinstance(event, SlipEvent)]


@pytest.mark.parametrize("seed", range(3))
def test_a_rough_slide_is_one_slip_without_direction(seed: int) -> None:
    *_, onset, end = slips(detector().process(hold(seed, rough(seed))))
    assert (onset.state, onset.kind, end.state) == ("onset", "gross", "end")
    assert SLIDE_S[0] < onset.detected_s < SLIDE_S[0] + 2
    assert abs(onset.onset_s - SLIDE_S[0]) < 2 * onset.onset_sd_s
    assert SLIDE_S[1] < end.detected_s < SLIDE_S[1] + 2.5  # a window, and what was believed
    assert onset.direction_sd_deg == UNKNOWN_SD_DEG


@pytest.mark.parametrize("seed", range(6))
def test_a_burst_in_the_readings_is_no_slide(seed: int) -> None:
    """Each channel has its own, as of a cable that is knocked: no motion of a rigid body."""
    rng, t = np.random.default_rng(seed), np.arange(2000)[:, np.newaxis] / 100.0
    readings = 400 * np.clip(t - 4, 0, 1) + rng.standard_normal((2000, 16))
    is_burst = np.abs(t - 13 - rng.uniform()) < 0.15
    readings += 20 * rng.standard_normal(readings.shape) * is_burst
    assert slips(detector().process(regular_block(readings, 100.0))) == []


@pytest.mark.parametrize("step", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_channels_that_creep_each_on_its_own_do_not_slide(seed: int, step: float) -> None:
    """A random walk has a spectrum whose strongest bin is the first one, with phases that fill the circle."""
    rng, n = np.random.default_rng(seed), round(40 * RATE_HZ)
    t = np.arange(n)[:, np.newaxis] / RATE_HZ
    creep = step * np.cumsum(rng.standard_normal((n, 16)) * (t > 2), axis=0)
    readings = 500 * np.clip(t - 1, 0, 1) + creep + 0.3 * rng.standard_normal((n, 16))
    found = slips(detector().process(regular_block(np.rint(readings), RATE_HZ)))
    assert [slip.kind for slip in found if slip.kind == "gross"] == []


@pytest.mark.parametrize(("period_mm", "part"), [(1.5, 0.01), (3.0, 0.01), (6.0, 0.01), (12.0, 0.05)])
def test_a_ripple_that_travels_is_a_slide(period_mm: float, part: float) -> None:
    found = slips(detector().process(hold(0, part / 0.05 * ridges(period_mm))))
    assert any(slip.kind == "gross" for slip in found)


@pytest.mark.parametrize(("n_live", "slides"), [(4, True), (3, False)])
def test_load_that_moves_is_told_of_four_channels_that_are_read(n_live: int, slides: bool) -> None:
    t = np.arange(N)[:, np.newaxis] / RATE_HZ
    moves = 1 + 0.3 * np.array([-1.0, 1.0, -1.0, 1.0]) * np.clip(t - 6.0, 0, 1)
    noise = 2 * np.random.default_rng(0).standard_normal((N, 4))
    is_read = np.tile(np.arange(4) < n_live, (N, 1))
    block = regular_block(np.rint(500 * np.clip(t - 1, 0, 1) * moves + noise), RATE_HZ, valid=is_read)
    found = slips(build_suite(pad(4), DetectParams(), topics=("slip",)).process(block))
    assert any(slip.kind == "incipient" for slip in found) == slides


@pytest.mark.parametrize("n_live", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_pad_of_which_few_channels_are_read_does_not_slide_at_rest(n_live: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanders = np.cumsum(rng.standard_normal((1000, 4)), axis=0)  # its own way each: cells that warm up
    load = 500.0 * (np.arange(1000)[:, np.newaxis] > 100)
    readings = np.rint(load + 3 * wanders + 2 * rng.standard_normal((1000, 4)))
    is_read = np.tile(np.arange(4) < n_live, (1000, 1))
    found = build_suite(pad(4), DetectParams(), topics=("slip",))
    assert slips(found.process(regular_block(readings, RATE_HZ, valid=is_read))) == []


def test_an_onset_names_the_taxels_that_touch() -> None:
    touches = (np.arange(16) >= 4).astype(float)
    block = hold(0, rough(0))
    lifted = dataclasses.replace(block, volts=block.volts * touches)
    onset = next(slip for slip in slips(detector().process(lifted)) if slip.kind == "gross")
    assert set(onset.taxels) == set(range(4, 16))


def test_a_slide_over_ridges_that_is_under_way_in_the_first_scan_is_found() -> None:
    block = hold(0, ridges())[round(7 * RATE_HZ) :]
    first = slips(detector().process(block))[0]
    assert first.state == "onset"
    assert first.detected_s < 7 + 3.5


@pytest.mark.parametrize("kind", ["hum", "tremor", "taps", "grip"])
def test_a_rigid_body_that_shakes_does_not_slide(kind: str) -> None:
    found = slips(detector().process(hold(1, shakes(kind))))
    # A tremor of two tilts moves load from taxels to others, as the beginning of a slip does.
    assert {slip.kind for slip in found} <= ({"incipient"} if kind == "tremor" else set())


def test_ridges_are_answered_from_scans_before_the_slide_was_found() -> None:
    found = detector(8.0).process(hold(0, ridges())[: round(9.7 * RATE_HZ)])
    answers = [e for e in found if isinstance(e, TextureEvent) and e.status == "period-only"]
    assert answers[0].period_min_mm < 3.0 < answers[0].period_max_mm
    onset_s = next(slip for slip in slips(found) if slip.kind == "gross").detected_s
    assert answers[0].window_s > answers[0].time_s - onset_s + 0.5


def test_a_gap_ends_the_slip_as_not_valid_and_forgets() -> None:
    block = hold(0, rough(0))
    cut = round(9 * RATE_HZ)
    seen = detector()
    seen.process(block[:cut])
    end, contact = seen.process(Gap(0, "restart", 5000))
    assert isinstance(end, SlipEvent)
    assert isinstance(contact, ContactEvent)
    assert (end.state, end.valid, contact.state, contact.valid) == ("end", False, "none", False)
    assert seen.process(block) == detector().process(block)


@given(st.integers(0, 10_000))
def test_phases_that_fill_the_circle_travel_and_those_of_a_tilting_body_do_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((34, 16)) + 1j * rng.standard_normal((34, 16))
    filled, rocking = noise.copy(), noise.copy()
    filled[9] += 30 * np.exp(1j * (2 * np.pi * np.arange(16) / 16 + rng.uniform(0, 6)))
    turn = np.exp(1j * rng.uniform(0, 6))
    rocking[9] += turn * (30 + 10j + rng.uniform(0, 60) * 1j * SIDE[0])
    assert travelling_line(filled, 3) > 2
    assert travelling_line(rocking, 3) == 0


def test_a_slide_that_begins_with_the_contact_is_not_told_to_begin_before_it() -> None:
    touch_s = 5.0
    events = detector().process(hold(0, 4 * rough(3, touch_s, np.inf), press_s=touch_s))
    contact = next(event for event in events if isinstance(event, ContactEvent))
    onset = slips(events)[0]
    assert onset.detected_s < touch_s + 5.0
    assert onset.onset_s >= contact.time_s - 1 / RATE_HZ


def test_the_slide_of_the_next_contact_begins_after_that_contact() -> None:
    block = hold(0, 4 * rough(3, 2.0, np.inf))
    lifted_s, touch_s = 7.0, 7.5
    t = block.time_s
    lifted = dataclasses.replace(
        block, volts=np.where(((t > lifted_s) & (t < touch_s))[:, np.newaxis], 0.0, block.volts)
    )
    onset = next(
        slip for slip in slips(detector().process(lifted)) if slip.state == "onset" and slip.time_s > lifted_s
    )
    assert touch_s - 0.5 / RATE_HZ < onset.onset_s < onset.detected_s


def test_a_slide_that_stops_dead_ends_at_the_second_look_after_it() -> None:
    # Noise is 2 counts; the ripple moves readings by tens of counts from scan to scan.
    end = slips(detector().process(hold(0, 5 * ridges())))[-1]
    hop_s = 9 / RATE_HZ
    assert end.state == "end"
    assert end.detected_s <= SLIDE_S[1] + 3 * hop_s


@pytest.mark.parametrize("n_lost", [16, 12])
@pytest.mark.parametrize("lost_s", [0.5, 1.0])
def test_a_slide_goes_on_while_channels_are_not_read(n_lost: int, lost_s: float) -> None:
    block = hold(0, 5 * ridges())
    end_s = slips(detector().process(block))[-1].detected_s
    block.valid[round(9 * RATE_HZ) : round((9 + lost_s) * RATE_HZ), :n_lost] = False
    end = slips(detector().process(block))[-1]
    assert (end.state, end.valid) == ("end", True)
    assert end.detected_s >= end_s


def test_slip_and_contact_have_no_valid_end_where_readings_end() -> None:
    block = hold(0, 5 * ridges())
    block.volts[round(9 * RATE_HZ) :] = np.nan
    block.valid[round(9 * RATE_HZ) :] = False
    events = build_suite(pad(), DetectParams(), topics=("slip", "contact")).process(block)
    contact = [event for event in events if isinstance(event, ContactEvent)][-1]
    assert (contact.state, contact.valid) == ("none", False)
    end = slips(events)[-1]
    assert (end.state, end.valid, end.detected_s) == ("end", False, contact.time_s)


def moved(
    part: float,
    pads: int = 1,
    from_s: float = 6.0,
    takes_s: float = 1.0,
    back: float = 0.0,
    back_s: float = 9.0,
) -> list[SlipEvent]:
    """Slips of a hold in which some load of eight taxels moves to the others, and a part of it back."""
    places = [{"x_mm": 4.0 * k, "y_mm": 0.0, "pad": k * pads // 16} for k in range(16)]
    array = array_of({"taxels": places})
    t = np.arange(N)[:, np.newaxis] / RATE_HZ
    away = np.where(np.arange(16) < 8, -part, part) * np.clip((t - from_s) / takes_s, 0, 1)
    away = away - np.sign(away) * back * np.clip(t - back_s, 0, 1)
    return slips(build_suite(array, DetectParams(), topics=("slip",)).process(hold(5, away)))


def test_load_that_moves_over_the_array_is_an_incipient_slip() -> None:
    onset = moved(0.2)[0]
    assert (onset.state, onset.kind, onset.direction_sd_deg) == ("onset", "incipient", UNKNOWN_SD_DEG)
    assert 6.0 < onset.detected_s < 7.0
    assert moved(0.01) == []
    assert moved(0.2, pads=2) == []  # from one finger to the other: the object is lifted or turned


def test_what_moves_before_anything_touches_is_no_slip() -> None:
    """Zeros of some channels rise while those of others fall: a warm-up, below the level of contact."""
    drift = (
        np.where(np.arange(16) < 8, -1.0, 1.0)
        * 30.0
        * np.clip((np.arange(N) / RATE_HZ - 2.0) / 0.3, 0, 1)[:, np.newaxis]
    )
    noise = 2 * np.random.default_rng(8).standard_normal((N, 16))
    levels = {"above": 100.0, "below": 60.0, "loading_per_s": 50.0}
    array = array_of({"taxel_count": 16, "contact": levels})
    found = build_suite(array, DetectParams(), topics=("slip",))
    assert slips(found.process(regular_block(np.rint(drift + noise), RATE_HZ))) == []
    pressed = build_suite(array, DetectParams(), topics=("slip",))
    assert (
        slips(pressed.process(regular_block(np.rint(500.0 + drift + noise), RATE_HZ)))[0].kind == "incipient"
    )


def test_load_that_moves_while_a_hand_closes_is_no_slip() -> None:
    assert moved(0.9, from_s=1.5, takes_s=0.3) == []  # the press begins at 1 s
    assert moved(0.9, from_s=2.5, takes_s=0.3)[0].kind == "incipient"
    (slip, *_) = moved(0.9, from_s=1.5, takes_s=0.3, back=0.4, back_s=5.0)
    assert slip.detected_s == pytest.approx(5.3, abs=0.5)  # the closing hand is not the hold's own tremor


@pytest.mark.parametrize("unknown", [True, False])
def test_what_readings_do_at_rest_is_no_slip_before_rest_was_seen(unknown: bool) -> None:
    """Electrodes have a bump of noise near 6 Hz, each its own."""
    rng = np.random.default_rng(6)
    t = np.arange(N)[:, np.newaxis] / RATE_HZ
    phase = 2 * np.pi * 6.0 * t + np.cumsum(rng.normal(0, 0.8, (N, 16)), axis=0)
    block = hold(7, 0.02 * np.cos(phase))
    assert slips(detector().process(block[round(3 * RATE_HZ) :] if unknown else block)) == []


@pytest.mark.parametrize("seed", range(6))
def test_contact_slides_as_long_as_a_gross_slip_is_open(seed: int) -> None:
    extra = rough(seed) if seed % 2 else ridges(2.0 + seed / 2)
    is_gross, is_sliding = False, False
    spans: list[tuple[float, bool, bool]] = []
    for event in detector().process(hold(seed, extra)):
        if isinstance(event, SlipEvent) and event.kind == "gross":
            is_gross = event.state == "onset"
        elif isinstance(event, ContactEvent):
            is_sliding = event.state == "sliding"
        spans.append((event.evidence_s, is_gross, is_sliding))
    # Events of one scan come one after the other: compare what stands at its end.
    ends = [
        one
        for one, after in zip(spans, [*spans[1:], (np.inf, False, False)], strict=True)
        if one[0] != after[0]
    ]
    assert any(gross for _, gross, _ in ends)
    assert all(gross == slides for _, gross, slides in ends)


@pytest.mark.parametrize("lift_s", [8.2, 8.6, 9.0])
def test_a_slip_of_load_that_moves_ends_with_the_contact(lift_s: float) -> None:
    moved = np.clip((np.arange(N) / RATE_HZ - 8) / 1.5, 0, 0.5)[:, np.newaxis] * np.linspace(-1, 1, 16)
    block = hold(0, moved)
    lifted = dataclasses.replace(
        block, volts=np.where(block.time_s[:, np.newaxis] < lift_s, block.volts, 0.0)
    )
    onset, end = slips(detector().process(lifted))
    assert (onset.state, end.state) == ("onset", "end")
    assert lift_s <= end.detected_s < lift_s + 0.1


@pytest.mark.parametrize(("n_changing", "n_patterns"), [(0, 0), (2, 2), (20, 3)])
def test_no_more_patterns_are_left_out_than_there_are(n_changing: int, n_patterns: int) -> None:
    readings = np.zeros((80, 20))
    readings[:, :n_changing] = np.random.default_rng(0).normal(size=(80, n_changing)).cumsum(axis=0)
    found = _spectra(readings, np.full(20, 1e-6))
    strongest = _strongest_patterns(found, found.noise)
    assert strongest.shape == (20, n_patterns)
    np.testing.assert_allclose(strongest.T @ strongest, np.eye(n_patterns), atol=1e-9)
    np.testing.assert_allclose(strongest[n_changing:], 0.0, atol=1e-9)

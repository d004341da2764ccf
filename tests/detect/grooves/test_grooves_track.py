"""Tracked waves: they are those of a fit of the same window, and another pattern is noticed."""

import dataclasses

import numpy as np
import pytest
from gratings import (
    ARRAY,
    Grating,
    MotionOf,
    Slide,
    answer,
    assert_right,
    fit,
    known,
    motions,
    numbers,
    off,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from slips import slip_at
from touches import textures

from tactiled.array import FloatArray
from tactiled.detect.grooves.estimator import JointTexture
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, NewPattern, Outcome, TrackedWave
from tactiled.detect.grooves.params import JointParams, WaveParams
from tactiled.detect.grooves.track import track_wave
from tactiled.detect.grooves.window import FitWindow
from tactiled.samples.block import regular_block

LAYOUT = channel_layout(ARRAY)
OFFSETS_S = np.linspace(0, 0.007, 36)
LONG = Slide(duration_s=8.0, noise=0.02)


def window(motion: WaveMotion, volts: FloatArray, time_s: FloatArray) -> FitWindow:
    return FitWindow(volts, time_s, OFFSETS_S, LAYOUT, motion, WaveParams())


def in_sigmas(one: GrooveAnswer, other: GrooveAnswer) -> tuple[float, float]:
    return (
        (one.period_mm - other.period_mm) / other.period_sd_mm,
        (one.angle_deg - other.angle_deg) / other.angle_sd_deg,
    )


@motions
@pytest.mark.parametrize("angle_deg", [-60.0, 0.0, 20.0, 70.0])
def test_a_tracked_wave_is_that_of_a_fit_of_the_window(motion_of: MotionOf, angle_deg: float) -> None:
    slide = dataclasses.replace(LONG, gratings=(Grating(angle_deg=angle_deg),))
    volts, time_s, motion = slide.volts(ARRAY, OFFSETS_S), slide.times(), motion_of(slide)
    found = answer(fit_wave(window(motion, volts[:250], time_s[:250])))
    for end in (300, 500, 800):
        found = answer(track_wave(found, window(motion, volts[:end], time_s[:end])))
    anew = answer(fit(slide, motion, volts=volts))
    assert in_sigmas(found, anew) == pytest.approx((0.0, 0.0), abs=0.02)
    assert found.period_sd_mm == pytest.approx(anew.period_sd_mm, rel=0.1)
    assert found.angle_sd_deg == pytest.approx(anew.angle_sd_deg, rel=0.1)


@motions
def test_intervals_of_95_percent_hold(motion_of: MotionOf) -> None:
    z = []
    for seed in range(60):
        slide = Slide(duration_s=3.0, noise=0.035, seed=seed)
        volts, time_s, motion = slide.volts(ARRAY, OFFSETS_S), slide.times(), motion_of(slide)
        first = answer(fit_wave(window(motion, volts[:200], time_s[:200])))
        found = answer(track_wave(first, window(motion, volts[100:], time_s[100:])))
        by_mm, by_deg = off(found, slide.gratings[0])
        z.append((by_mm / found.period_sd_mm, by_deg / found.angle_sd_deg))
    held = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all(held > 0.89)  # 60 trials: 95 % +- 3 %
    assert np.square(z).mean(axis=0) ** 0.5 == pytest.approx(1.0, abs=0.2)  # +- 0.09


def test_lost_scans_with_true_times_and_a_channel_that_dies_leave_the_answer_right() -> None:
    volts, time_s, motion = LONG.volts(ARRAY, OFFSETS_S), LONG.times(), known(LONG)
    first = answer(fit(LONG, motion, volts=volts))
    kept = np.random.default_rng(1).random(len(time_s)) > 0.1
    lost = track_wave(first, window(motion, volts[kept], time_s[kept]))
    assert_right(lost, LONG.gratings[0])
    volts[400:, 7] = np.nan
    volts[:, 20] = 1.0  # without ripple and noise
    dead = track_wave(first, window(motion, volts, time_s))
    assert_right(dead, LONG.gratings[0])


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 400),
    size=st.sampled_from([0.0, 1e-9, 1e-3, 1.0, 1e6, 1e150]),
    bad=st.floats(0, 0.2),
    frequency=st.floats(1e-3, 1e3),
    speed=st.sampled_from([0.0, 1e-6, 1.0, 1e4]),
)
@settings(max_examples=30, deadline=None)
def test_anything_gives_finite_numbers_or_nothing(
    seed: int, n: int, size: float, bad: float, frequency: float, speed: float
) -> None:
    rng = np.random.default_rng(seed)
    volts = size * rng.normal(size=(n, 36)).cumsum(axis=0)
    volts[rng.random(volts.shape) < bad] = np.nan
    wave = TrackedWave(rng.normal(size=2), frequency, 2, np.ones(3), 1.0)
    last = GrooveAnswer(
        frequency_hz=0.0, snr_db=0.0, period_mm=1.0, angle_deg=0.0, speed_mm_s=0.0, covariance=np.eye(3),
        uses_given_speed=bool(rng.integers(2)), wave=wave,
    )  # fmt: skip
    motion = WaveMotion(speed, 0.01 * speed, float(rng.uniform(-180, 180)), 5.0)
    found = track_wave(last, window(motion, volts, np.arange(n) / 100))
    if found is not None:
        assert np.isfinite(numbers(found)).all()
        assert not isinstance(found, GrooveAnswer) or np.all(np.diag(found.covariance) >= 0)


@pytest.mark.parametrize(("rate_hz", "frequency_hz"), [(3.0, 1.33), (2.0, 0.89), (1.0, 0.44), (0.5, 0.222)])
def test_a_wave_is_tracked_in_scans_that_are_a_second_apart(rate_hz: float, frequency_hz: float) -> None:
    across = (Grating(angle_deg=0.0),)  # the phases of all columns of taxels are then exactly alike
    slide = Slide(across, 1.2 * frequency_hz, duration_s=60 / rate_hz, rate_hz=rate_hz, noise=0.002)
    at_once = np.zeros(ARRAY.n_channels)
    scans = FitWindow(slide.volts(ARRAY), slide.times(), at_once, LAYOUT, known(slide), WaveParams())
    assert_right(track_wave(answer(fit_wave(scans)), scans), slide.gratings[0])


@motions
@pytest.mark.parametrize("later", [Grating(1.32, 20.0), Grating(1.08, 20.0), Grating(1.2, 30.0)])
def test_another_pattern_is_noticed(motion_of: MotionOf, later: Grating) -> None:
    volts = LONG.volts(ARRAY, OFFSETS_S)
    last = answer(fit(LONG, motion_of(LONG), volts=volts))
    changed = dataclasses.replace(LONG, gratings=(later,)).volts(ARRAY, OFFSETS_S)
    for scans, is_noticed in ((0, False), (60, True), (150, True)):
        both = np.concatenate([volts[: 800 - scans], changed[800 - scans :]])
        found = track_wave(last, window(motion_of(LONG), both, LONG.times()))
        assert isinstance(found, NewPattern) == is_noticed


def test_an_uneven_speed_is_no_other_pattern() -> None:
    even = Slide(duration_s=8.0)
    last = answer(fit(even, known(even).without_speed))
    uneven = dataclasses.replace(even, acceleration_mm_s2=0.02, speed_mm_s=1.92)
    found = track_wave(last, window(known(even).without_speed, uneven.volts(ARRAY, OFFSETS_S), even.times()))
    assert not isinstance(found, NewPattern)


def test_an_answer_is_fitted_anew_when_its_window_has_doubled_or_is_all_new() -> None:
    ends: list[int] = []

    def counted(window: FitWindow) -> Outcome:
        ends.append(round(100 * float(window.time_s[-1])) + 1)
        return fit_wave(window)

    slide = Slide(duration_s=26.0)
    texture = JointTexture(ARRAY, JointParams(speed_mm_s=2.0, settle_s=0.0, direction_deg=0.0), fit=counted)
    block = regular_block(slide.volts(ARRAY, OFFSETS_S), 100.0, channel_offset_s=OFFSETS_S)
    events = textures(texture.process(block, [slip_at(0.0, 0.0, 1.0)]))
    assert all(event.status == "ok" for event in events)
    assert events[0].answered_s == pytest.approx(1.19)
    assert ends == [20, 40, 60, 80, 100, 200, 400, 800, 1600, 2400]
    assert [event.time_s for event in events] == pytest.approx(0.79 + 0.2 * np.arange(len(events)))


def test_grooves_that_change_are_reported_and_answered_anew() -> None:
    slide = Slide(duration_s=14.0)
    other = dataclasses.replace(slide, gratings=(Grating(1.5, -10.0),))
    volts: NDArray[np.float64] = slide.volts(ARRAY, OFFSETS_S)
    volts[700:] = other.volts(ARRAY, OFFSETS_S)[700:]
    texture = JointTexture(ARRAY, JointParams(speed_mm_s=2.0, settle_s=0.0, direction_deg=0.0))
    block = regular_block(volts, 100.0, channel_offset_s=OFFSETS_S)
    events = textures(texture.process(block, [slip_at(0.0, 0.0, 1.0)]))
    refused = [event for event in events if event.status != "ok"]
    assert [event.status for event in refused] == ["ambiguous"]
    assert 7.0 < refused[0].answered_s <= 8.6
    after = [event for event in events if event.time_s > refused[0].time_s]
    assert after[0].answered_s < refused[0].answered_s + 2.5
    assert [event.period_mm for event in after] == pytest.approx([1.5] * len(after), abs=0.01)
    chunked = JointTexture(ARRAY, JointParams(speed_mm_s=2.0, settle_s=0.0, direction_deg=0.0))
    pieces = [chunked.process(block[:1], [slip_at(0.0, 0.0, 1.0)])]
    pieces += [chunked.process(block[first : first + 33]) for first in range(1, len(block), 33)]
    assert textures([event for piece in pieces for event in piece]) == events


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (Grating(1.8, -29.0), Grating(2.5, -22.0)),  # three blocks of 1.5 periods do not fit into the window
        (Grating(2.0, -22.0), Grating(1.38, 43.0)),  # the line stays nearly where it was
        (Grating(0.87, 2.0), Grating(2.24, -34.0)),  # the line goes, and another comes far below
    ],
)
def test_no_answer_mixes_two_patterns_with_the_shortest_preset(before: Grating, after: Grating) -> None:
    slide = Slide((before,), duration_s=12.0, noise=0.02)
    volts, changes_at = slide.volts(ARRAY, OFFSETS_S), 600
    volts[changes_at:] = dataclasses.replace(slide, gratings=(after,)).volts(ARRAY, OFFSETS_S)[changes_at:]
    texture = JointTexture(ARRAY, JointParams(preset="quick"))
    scans = regular_block(volts, slide.rate_hz, channel_offset_s=OFFSETS_S)
    found = textures(texture.process(scans, [slip_at(0.0, 0.0, 1.0)]))
    answers = [event for event in found if event.status == "ok"]
    off_mm = [[abs(event.period_mm - each.period_mm) for each in (before, after)] for event in answers]
    assert np.min(off_mm, axis=1).max() < 0.04  # two standard deviations of the preset
    assert np.argmin(off_mm[-1]) == 1

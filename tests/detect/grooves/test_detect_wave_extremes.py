"""The joint fit of one window at its limits: a number with an honest sigma, or a named refusal."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from gratings import (
    ARRAY,
    Grating,
    MotionOf,
    Slide,
    assert_refused,
    assert_right,
    fit,
    grid,
    known,
    motions,
    unknown,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, WaveParams, channel_layout
from tactiled.detect.grooves.window import make_window, normal_equations

LSB = 3.0 / 4096
OFFSETS_S = np.linspace(0, 0.007, 36)


@motions
def test_equal_gaps_leave_every_reading_that_they_cannot_tell_apart(motion_of: MotionOf) -> None:
    slide = Slide((Grating(1.2, 20.0),))
    few = WaveParams(min_period_mm=1.0, max_tilt_deg=45.0)
    found = fit(slide, motion_of(slide), grid([0.0, 3.5, 7.0], [0.0, 3.5, 7.0]), params=few)
    assert_refused(found, "ambiguous")
    weights = [c.weight for c in found.candidates]
    # All the same, since phases differ by whole turns.
    assert weights == pytest.approx([weights[0]] * len(weights), rel=0.05)
    assert any(
        c.period_mm == pytest.approx(1.2, abs=0.01) and c.angle_deg == pytest.approx(20.0, abs=1)
        for c in found.candidates
    )


def test_equal_gaps_answer_where_the_limits_leave_one_reading() -> None:
    slide = Slide((Grating(4.0, 20.0),), speed_mm_s=6.0)
    array = grid([0.0, 3.5, 7.0], [0.0, 3.5, 7.0])
    found = fit(slide, known(slide), array, params=WaveParams(max_tilt_deg=30.0, min_period_mm=2.0))
    assert_right(found, slide.gratings[0])


@motions
def test_one_taxel_has_no_delays(motion_of: MotionOf) -> None:
    slide = Slide()
    assert_refused(fit(slide, motion_of(slide), grid([0.0], [0.0])), "ambiguous")


def test_one_column_needs_the_speed_and_motion_across_it() -> None:
    column = grid([0.0], [0.0, 3.5, 7.3])
    slide = Slide((Grating(2.0, 20.0),))
    assert_right(fit(slide, known(slide), column), slide.gratings[0])
    assert_refused(fit(slide, unknown(slide), column), "ambiguous")
    along = dataclasses.replace(slide, direction_deg=90.0, gratings=(Grating(2.0, 70.0),))
    assert_refused(fit(along, known(along), column), "ambiguous")


@motions
@pytest.mark.parametrize("angle_deg", [84.0, 88.0, 90.0])
def test_grooves_along_the_motion_are_refused_and_never_wrong(motion_of: MotionOf, angle_deg: float) -> None:
    slide = Slide((Grating(1.2, angle_deg),), speed_mm_s=2.0, duration_s=4.0)
    assert_refused(fit(slide, motion_of(slide)), "too-few-periods", "low-snr", "ambiguous")


@motions
@pytest.mark.parametrize("angle_deg", [0.0, 90.0, -180.0, 45.0])
def test_a_normal_along_the_motion_is_as_good_as_any(motion_of: MotionOf, angle_deg: float) -> None:
    slide = Slide((Grating(1.2, angle_deg),), direction_deg=angle_deg)
    assert_right(fit(slide, motion_of(slide)), slide.gratings[0])


@motions
@pytest.mark.parametrize("frequency_hz", [46.0, 50.0, 54.0, 70.0, 97.0])
def test_ripples_near_and_above_half_the_rate_are_never_taken_for_slower_ones(
    motion_of: MotionOf, frequency_hz: float
) -> None:
    slide = Slide((Grating(1.0, 10.0),), speed_mm_s=frequency_hz / np.cos(np.radians(10)))
    assert_refused(fit(slide, motion_of(slide)), "aliased", "low-snr", "ambiguous")


@motions
@pytest.mark.parametrize("periods", [0.1, 0.3, 0.5, 0.7])
def test_windows_of_less_than_a_period_are_refused(motion_of: MotionOf, periods: float) -> None:
    slide = Slide((Grating(1.2, 0.0),), speed_mm_s=0.6, duration_s=2 * periods)
    assert_refused(fit(slide, motion_of(slide)), "too-few-periods", "low-snr")


@motions
@pytest.mark.parametrize("harmonics", [(1.0,), (1.0, 0.5, 0.3)])
@pytest.mark.parametrize("periods", [1.2, 1.8, 2.3, 2.45, 2.55, 2.7, 3.2])
def test_little_more_than_a_period_is_enough_and_drift_is_no_ripple(
    motion_of: MotionOf, harmonics: tuple[float, ...], periods: float
) -> None:
    slide = Slide((Grating(1.2, 15.0, harmonics=harmonics),), speed_mm_s=0.6)
    slide = dataclasses.replace(slide, duration_s=periods * 2 / np.cos(np.radians(15.0)))
    volts = slide.volts(ARRAY, OFFSETS_S)
    drift = np.linspace(-0.1, 0.1, len(volts))[:, np.newaxis] * np.linspace(-1, 1, 36)
    assert_right(fit(slide, motion_of(slide), volts=volts + drift), slide.gratings[0])


@motions
@pytest.mark.parametrize("periods", [4.0, 6.5])
def test_creep_far_larger_than_the_ripple_does_not_hide_it(motion_of: MotionOf, periods: float) -> None:
    slide = Slide(speed_mm_s=2.0, duration_s=periods * 0.6)
    times_s = slide.times()[:, np.newaxis]
    creep = -0.5 * np.exp(-times_s / times_s.max() * 3) * np.linspace(0.5, 1.0, 36)
    volts = slide.volts(ARRAY, OFFSETS_S) + creep
    assert_right(fit(slide, motion_of(slide), volts=volts), slide.gratings[0])


@motions
@pytest.mark.parametrize("period_mm", [3.5, 3.8, 7.3, 3.65, 0.3 * 3.5, 1.9])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0])
def test_periods_that_are_a_spacing(motion_of: MotionOf, period_mm: float, angle_deg: float) -> None:
    slide = Slide((Grating(period_mm, angle_deg),), speed_mm_s=4.0, duration_s=8.0)
    assert_right(fit(slide, motion_of(slide)), slide.gratings[0])


@motions
def test_one_step_of_the_converter_under_three_volts(motion_of: MotionOf) -> None:
    slide = Slide((Grating(amplitude=LSB),), level=2.99, noise=LSB / 2, duration_s=6.0)
    volts = np.round(slide.volts(ARRAY, OFFSETS_S) / LSB) * LSB
    assert_right(fit(slide, motion_of(slide), volts=volts), slide.gratings[0])


@motions
def test_a_noiseless_signal_on_a_coarse_converter(motion_of: MotionOf) -> None:
    slide = Slide((Grating(amplitude=4 * LSB),), noise=0.0)
    volts = np.round(slide.volts(ARRAY, OFFSETS_S) / LSB) * LSB
    assert_right(fit(slide, motion_of(slide), volts=volts), slide.gratings[0])


@motions
def test_dead_and_saturated_channels_are_left_out_and_lost_readings_bridged(motion_of: MotionOf) -> None:
    slide = Slide()
    volts = slide.volts(ARRAY, OFFSETS_S)
    rng = np.random.default_rng(3)
    volts[:, rng.choice(36, 12, replace=False)] = np.nan
    volts[:, 5] = 3.0
    volts[rng.random(volts.shape) < 0.01] = np.nan
    assert_right(fit(slide, motion_of(slide), volts=volts), slide.gratings[0])


@motions
def test_nothing_usable_is_saturated(motion_of: MotionOf) -> None:
    slide = Slide()
    assert_refused(fit(slide, motion_of(slide), volts=np.full((400, 36), np.nan)), "saturated")


@motions
@pytest.mark.parametrize("value", [0.0, 3.0, -1e6])
def test_constants_are_no_grooves(motion_of: MotionOf, value: float) -> None:
    slide = Slide()
    assert_refused(fit(slide, motion_of(slide), volts=np.full((400, 36), value)), "low-snr")


def test_the_clock_may_read_anything() -> None:
    slide = Slide()
    volts, times = slide.volts(ARRAY, OFFSETS_S), slide.times()
    early, late = (
        fit_wave(volts, times + start_s, OFFSETS_S, channel_layout(ARRAY), known(slide), WaveParams())
        for start_s in (0.0, 1e7)
    )
    assert_right(late, slide.gratings[0])
    assert late.angle_deg == pytest.approx(early.angle_deg, abs=0.01 * early.angle_sd_deg)


@given(
    seed=st.integers(0, 10**6),
    n=st.integers(1, 300),
    size=st.sampled_from([1e-9, 1e-3, 1.0, 1e6, 1e150]),
    bad=st.floats(0, 0.2),
    speed=st.sampled_from([0.0, 1e-6, 1.0, 1e4]),
    direction_sd_deg=st.sampled_from([0.0, 5.0, 180.0]),
)
@settings(max_examples=60, deadline=None)
def test_anything_gives_finite_numbers_or_a_refusal(
    seed: int, n: int, size: float, bad: float, speed: float, direction_sd_deg: float
) -> None:
    rng = np.random.default_rng(seed)
    volts = size * rng.normal(size=(n, 36)).cumsum(axis=0)
    volts[rng.random(volts.shape) < bad] = np.nan
    motion = WaveMotion(speed, 0.01 * speed, float(rng.uniform(-180, 180)), direction_sd_deg)
    found = fit_wave(volts, np.arange(n) / 100, OFFSETS_S, channel_layout(ARRAY), motion, WaveParams())
    numbers = [found.frequency_hz, found.snr_db, found.period_mm, found.angle_deg, found.speed_mm_s]
    assert np.all(np.isfinite([*numbers, *found.covariance.ravel(), found.error_probability]))
    assert np.all(np.diag(found.covariance) >= 0)


RIPPLE = np.cos(0.3 * np.arange(400)[:, np.newaxis] + np.arange(36) ** 2)
DEGENERATE: dict[str, Callable[[int, np.random.Generator], FloatArray]] = {
    "in step": lambda n, _: np.repeat(RIPPLE[:n, :1], 36, axis=1),
    "noiseless": lambda n, _: RIPPLE[:n],
    "alternating": lambda n, _: np.resize([1.0, -1.0], (n, 1)) * np.ones(36),
    "square": lambda n, _: np.sign(RIPPLE[:n]),
    "one channel": lambda n, rng: rng.normal(size=(n, 1)) * (np.arange(36) == 7),
    "one reading": lambda n, rng: np.eye(n)[:, [int(rng.integers(n))]] * np.ones(36),
    "a steep curve": lambda n, _: RIPPLE[:n] + 1e6 * np.linspace(-1, 1, n)[:, np.newaxis] ** 5,
    "pairs alike": lambda n, rng: np.repeat(rng.normal(size=(n, 18)), 2, axis=1),
    "constant": lambda n, _: np.full((n, 36), 0.1),
}


@given(
    what=st.sampled_from([*DEGENERATE]),
    n=st.sampled_from([14, 15, 16, 17, 18, 20, 25, 30, 60, 200]),
    size=st.sampled_from([1e-12, 1e-6, 1.0, 1e6]),
    seed=st.integers(0, 10**6),
    speed=st.sampled_from([0.0, 1.0, 30.0]),
    trend_order=st.sampled_from([1, 3, 8]),
    max_harmonics=st.sampled_from([1, 3, 6]),
)
@settings(max_examples=80, deadline=None)
def test_windows_that_leave_nothing_to_solve_for_are_answered_or_refused(
    what: str, n: int, size: float, seed: int, speed: float, trend_order: int, max_harmonics: int
) -> None:
    volts = size * DEGENERATE[what](n, np.random.default_rng(seed))
    motion = WaveMotion(speed, 0.0, 10.0, 0.0)
    params = WaveParams(trend_order=trend_order, max_harmonics=max_harmonics)
    found = fit_wave(volts, np.arange(n) / 100, OFFSETS_S, channel_layout(ARRAY), motion, params)
    assert np.all(np.isfinite([*found.covariance.ravel(), found.period_mm, found.error_probability]))


@pytest.mark.parametrize("n_harmonics", [1, 2])
def test_a_line_that_the_trend_has_taken_has_no_part_left(n_harmonics: int) -> None:
    rng = np.random.default_rng(0)
    times = np.arange(40) / 100
    window = make_window(rng.normal(size=(40, 3)), times, np.ones(40), np.zeros(3))
    left = window.without_lines(5.0, [1.0])
    assert normal_equations(left, 5.0, n_harmonics).phasors()[:, :2] == pytest.approx(0.0, abs=1e-6)


@motions
@pytest.mark.parametrize("angle_deg", [-29.0, -28.0, 28.5, 29.5])
def test_grooves_just_within_the_limits_are_not_taken_for_others(
    motion_of: MotionOf, angle_deg: float
) -> None:
    """Their maximum is inside the limits where the nearest point of a grid is not."""
    grating = Grating(6.54, angle_deg)
    slide = Slide((grating,), speed_mm_s=15.0, duration_s=2.0)
    limits = WaveParams(min_period_mm=5.0, max_tilt_deg=30.0)
    assert_right(fit(slide, motion_of(slide), params=limits), grating)


@pytest.mark.parametrize("angle_deg", [20.0, 40.0])
@pytest.mark.parametrize("direction_sd_deg", [1.0, 3.0])
def test_a_column_whose_direction_is_unsure_finds_the_wave_that_suits_it(
    angle_deg: float, direction_sd_deg: float
) -> None:
    """Taxels of one column say nothing of the component along the motion: only the motion does."""
    slide = Slide((Grating(1.0, angle_deg),), speed_mm_s=2.0, duration_s=3.0)
    motion = WaveMotion(2.0, 0.0, 0.0, direction_sd_deg)
    assert_right(fit(slide, motion, grid([0.0], [0.0, 3.5, 7.3])), slide.gratings[0])

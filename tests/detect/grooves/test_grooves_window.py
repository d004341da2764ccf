"""Readings of a window: distance travelled, clock, converter steps, bad channels, and removed lines."""

from collections.abc import Callable

import numpy as np
import pytest
from gratings import (
    ARRAY,
    Grating,
    MotionOf,
    Slide,
    answer,
    assert_refused,
    assert_right,
    fit,
    known,
    motions,
    numbers,
    prepared,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.grooves.window import FitWindow

LSB = 3.0 / 4096
OFFSETS_S = np.linspace(0, 0.007, 36)
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


def test_distance_travelled_compensates_acceleration() -> None:
    slide = Slide(speed_mm_s=1.0, acceleration_mm_s2=1.5)
    offsets_s = np.linspace(0, 0.007, 36)
    times = slide.times()
    speeds = 1.0 + 1.5 * (times + 0.005)  # mean from each scan to the next
    motion = WaveMotion(float(speeds.mean()), 0.0, 0.0, 0.0)
    volts = slide.volts(ARRAY, offsets_s)
    layout = channel_layout(ARRAY)
    window = FitWindow(volts, times, offsets_s, layout, motion, WaveParams(), speeds_mm_s=speeds)
    assert_right(fit_wave(window), slide.gratings[0])


@motions
@pytest.mark.parametrize(("steps", "noise"), [(1, LSB / 2), (4, 0.0)])
def test_ripples_of_few_steps_of_the_converter(motion_of: MotionOf, steps: int, noise: float) -> None:
    slide = Slide((Grating(amplitude=steps * LSB),), level=2.99, noise=noise, duration_s=6.0)
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


def test_the_clock_may_read_anything() -> None:
    slide = Slide()
    volts, times, layout = slide.volts(ARRAY, OFFSETS_S), slide.times(), channel_layout(ARRAY)
    early, late = (
        answer(fit_wave(FitWindow(volts, times + start_s, OFFSETS_S, layout, known(slide), WaveParams())))
        for start_s in (0.0, 1e7)
    )
    assert_right(late, slide.gratings[0])
    assert late.angle_deg == pytest.approx(early.angle_deg, abs=0.01 * early.angle_sd_deg)


@given(
    what=st.sampled_from([*DEGENERATE]),
    n=st.sampled_from([14, 15, 16, 17, 18, 20, 25, 30, 60, 200]),
    size=st.sampled_from([1e-12, 1e-6, 1.0, 1e6]),
    seed=st.integers(0, 10**6),
    speed=st.sampled_from([0.0, 1.0, 30.0]),
    trend_order=st.sampled_from([1, 3, 8]),
    max_harmonics=st.sampled_from([1, 3, 6]),
)
@settings(max_examples=30, deadline=None)
def test_windows_that_leave_nothing_to_solve_for_are_answered_or_refused(
    what: str, n: int, size: float, seed: int, speed: float, trend_order: int, max_harmonics: int
) -> None:
    volts = size * DEGENERATE[what](n, np.random.default_rng(seed))
    motion = WaveMotion(speed, 0.0, 10.0, 0.0)
    params = WaveParams(trend_order=trend_order, max_harmonics=max_harmonics)
    window = FitWindow(volts, np.arange(n) / 100, OFFSETS_S, channel_layout(ARRAY), motion, params)
    assert np.isfinite(numbers(fit_wave(window))).all()


@pytest.mark.parametrize("amplitude", [0.01, 0.3])
def test_the_phase_rate_is_found_and_its_bound_is_that_of_tones_in_white_noise(amplitude: float) -> None:
    # Rife and Boorstyn, IEEE Trans. Inf. Theory 20 (1974), 591, for a real tone: 24 s^2 / (A^2 N^3) in
    # radians a sample. The window is scaled to -1 to 1, N / 2 samples a unit; channels add up.
    n, variance = 400, 4e-6
    phases = np.arange(36) ** 2
    volts = amplitude * np.cos(40 * np.linspace(-1, 1, n)[:, np.newaxis] + phases)
    window = prepared(volts, np.arange(n) / 100, channel_layout(ARRAY))
    found, bound = window.equations(40.1).own_phase_rate(np.full(36, variance))
    assert found == pytest.approx(40.0, abs=0.01)
    assert bound == pytest.approx(np.sqrt(6 * variance / (amplitude**2 * n * 36)), rel=0.02)

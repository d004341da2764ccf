"""Lines of a window: harmonics, drift below a line, vibration, and noise without a line."""

import dataclasses

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
    is_near,
    motions,
)
from scipy import signal

from tactiled.array import FloatArray

OFFSETS_S = np.linspace(0, 0.007, 36)


def drifting(slide: Slide, pole: float, snr_db: float) -> FloatArray:
    """Readings in first-order autoregressive noise, independent between channels."""
    rng = np.random.default_rng(7000 + slide.seed)
    white = rng.normal(size=(len(slide.times()) + 500, 36))
    noise = signal.lfilter([np.sqrt(1 - pole**2)], [1, -pole], white, axis=0)[500:]
    size = slide.gratings[0].amplitude / np.sqrt(2 * 10 ** (snr_db / 10))
    return np.asarray(slide.volts(ARRAY, OFFSETS_S) + size * noise)


@motions
def test_harmonics_sharpen_the_answer(motion_of: MotionOf) -> None:
    plain = Slide((Grating(),))
    sharp = Slide((Grating(harmonics=(1.0, 0.5, 0.3)),))
    found, better = answer(fit(plain, motion_of(plain))), answer(fit(sharp, motion_of(sharp)))
    assert_right(better, sharp.gratings[0])
    assert better.angle_sd_deg < 0.9 * found.angle_sd_deg


@motions
def test_a_harmonic_stronger_than_its_fundamental_is_not_taken_for_finer_grooves(motion_of: MotionOf) -> None:
    slide = Slide((Grating(period_mm=2.4, harmonics=(1.0, 3.0)),), duration_s=6.0)
    assert_right(fit(slide, motion_of(slide)), slide.gratings[0])


@motions
def test_a_second_grating_is_seen_however_the_two_are_ordered(motion_of: MotionOf) -> None:
    strong, weak = Grating(1.5, 30.0, 0.05), Grating(0.8, -40.0, 0.02)
    for gratings in ((weak, strong), (strong, weak)):
        slide = Slide(gratings, duration_s=6.0)
        assert_refused(fit(slide, motion_of(slide)), "several-gratings")
    faint = Grating(0.8, -40.0, 0.003)  # 0.4 % of the power
    slide = Slide((strong, faint), duration_s=6.0)
    assert_right(fit(slide, motion_of(slide)), strong)


@motions
@pytest.mark.parametrize(("period_mm", "angle_deg", "direction_deg"), [(1.5, 30.0, 0.0), (1.7, 90.0, 70.0)])
def test_side_bands_of_an_uneven_speed_are_no_second_grating(
    motion_of: MotionOf, period_mm: float, angle_deg: float, direction_deg: float
) -> None:
    grating = Grating(period_mm, angle_deg)
    slide = Slide((), direction_deg=direction_deg, duration_s=5.0)
    time_s = slide.times()[:, np.newaxis] + OFFSETS_S
    uneven_mm = 0.3 * slide.speed_mm_s / (2 * np.pi * 0.9) * np.sin(2 * np.pi * 0.9 * time_s)
    travel_mm, motion = slide.speed_mm_s * time_s + uneven_mm, np.radians(direction_deg)
    x = ARRAY.x_mm[ARRAY.channel_taxel] + travel_mm * np.cos(motion)
    y = ARRAY.y_mm[ARRAY.channel_taxel] + travel_mm * np.sin(motion)
    angle = np.radians(angle_deg)
    ripple = 0.05 * np.cos(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / grating.period_mm)
    found = fit(slide, motion_of(slide), volts=slide.volts(ARRAY, OFFSETS_S) + ripple)
    assert found.status == "ok"
    assert is_near(found, grating)


@motions
def test_noise_and_random_textures_are_no_grooves(motion_of: MotionOf) -> None:
    for seed in range(10):
        slide = Slide((), seed=seed, duration_s=3.0)
        assert_refused(fit(slide, motion_of(slide)), "low-snr")
        # Sandpaper: each row of taxels slides over its own profile.
        rng = np.random.default_rng(seed)
        profile = signal.lfilter([1.0], [1, -1.7, 0.75], rng.normal(size=(3, 4000)), axis=1)
        place = ARRAY.x_mm[ARRAY.channel_taxel] + 2.0 * slide.times()[:, np.newaxis]
        row = ARRAY.channel_taxel // 3
        sand = np.stack([np.interp(place[:, c], np.arange(4000) / 50, profile[row[c]]) for c in range(36)], 1)
        assert_refused(
            fit(slide, motion_of(slide), volts=1 + 0.01 * sand),
            "low-snr",
            "too-few-periods",
            "ambiguous",
            "uneven-channels",
            "several-gratings",
            "aliased",
        )


@motions
@pytest.mark.parametrize("pole", [0.9, 0.97])
def test_drift_that_is_random_makes_no_slower_fundamental(motion_of: MotionOf, pole: float) -> None:
    """Below a line such noise is strong, and may pass for the fundamental of the line."""
    n_ok = 0
    for seed in range(8):
        grating = Grating(1.0 + 0.1 * seed, -40 + 10.0 * seed)
        slide = Slide((grating,), duration_s=2.0, speed_mm_s=3.0, noise=0.0, seed=seed)
        found = fit(slide, motion_of(slide), volts=drifting(slide, pole, 10.0))
        if found.status == "ok":
            n_ok += 1
            assert is_near(found, grating)
    assert n_ok > 4


@motions
@pytest.mark.parametrize("part", [2, 3])
@pytest.mark.parametrize("is_finer_stronger", [True, False])
def test_a_second_grating_at_a_multiple_of_the_frequency_is_no_harmonic(
    motion_of: MotionOf, part: int, is_finer_stronger: bool
) -> None:
    coarse_mm, coarse_deg, fine_deg = 2.4, 25.0, -35.0
    fine_mm = coarse_mm / part * np.cos(np.radians(fine_deg)) / np.cos(np.radians(coarse_deg))
    sizes = (0.02, 0.05) if is_finer_stronger else (0.05, 0.02)
    coarse, fine = Grating(coarse_mm, coarse_deg, sizes[0]), Grating(fine_mm, fine_deg, sizes[1])
    slide = Slide((coarse, fine), duration_s=5.0)
    found = fit(slide, motion_of(slide))
    assert_refused(found, "several-gratings")


@motions
@pytest.mark.parametrize("frequency_hz", [46.0, 50.0, 54.0, 70.0, 97.0])
def test_ripples_near_and_above_half_the_rate_are_never_taken_for_slower_ones(
    motion_of: MotionOf, frequency_hz: float
) -> None:
    slide = Slide((Grating(1.0, 10.0),), speed_mm_s=frequency_hz / np.cos(np.radians(10)))
    assert_refused(fit(slide, motion_of(slide)), "aliased", "low-snr", "ambiguous", "uneven-channels")


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

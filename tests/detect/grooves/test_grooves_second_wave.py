"""Two waves of one frequency, and gains and phases that only look like two waves."""

from dataclasses import replace

import numpy as np
import pytest
from gratings import ARRAY, Grating, MotionOf, Slide, assert_refused, assert_right, fit, is_near, motions

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import channel_layout, wave_vector
from tactiled.detect.grooves.second_wave import most_explained

OFFSETS_S = np.linspace(0, 0.007, 36)


def gains(slide: Slide) -> FloatArray:
    """Channel gains that a slide over one grating draws, divided by their mean."""
    return np.random.default_rng(slide.seed).uniform(0.6, 1.4, 36)


def crossed(period_mm: float, angle_deg: float, sizes: tuple[float, float]) -> FloatArray:
    """Two ripples of one frequency at 2 mm/s along x; each kind of channel has its own phases."""
    x = ARRAY.x_mm[ARRAY.channel_taxel] + 2.0 * (Slide().times()[:, np.newaxis] + OFFSETS_S)
    y, own = ARRAY.y_mm[ARRAY.channel_taxel], np.nan_to_num(ARRAY.azimuth_deg)
    along, across = wave_vector(period_mm, angle_deg)
    one, other = np.cos(along * x + across * y + own), np.cos(along * x - across * y + 1 - 2 * own)
    return np.asarray(sizes[0] * one + sizes[1] * other)


REFUSED = ("several-gratings", "ambiguous", "uneven-channels")


def test_what_two_waves_explain_is_that_of_least_squares() -> None:
    rng, layout = np.random.default_rng(1), channel_layout(ARRAY)
    z, k = rng.standard_normal(36) + 1j * rng.standard_normal(36), rng.uniform(-5, 5, (2, 2))
    wave = np.exp(1j * layout.xy_mm @ k.T)  # (channels, waves)
    design = np.concatenate([layout.is_kind * wave[:, :1], layout.is_kind * wave[:, 1:]], axis=1)
    explained = design @ np.linalg.lstsq(design, z, rcond=None)[0]
    assert most_explained(z, layout, k) == pytest.approx(float((np.abs(explained) ** 2).sum()))


@motions
@pytest.mark.parametrize("ratio", [1.0, 0.6, 0.3])
@pytest.mark.parametrize("angle_deg", [20.0, 35.0, 50.0])
def test_crossed_grooves_are_not_taken_for_others_between_them(
    motion_of: MotionOf, ratio: float, angle_deg: float
) -> None:
    """Both cause ripples of one frequency; channel amplitudes are free and could alone explain them."""
    gratings = Grating(1.3, angle_deg, 0.05), Grating(1.3, -angle_deg, 0.05 * ratio, phase_rad=1.0)
    slide = Slide(gratings, duration_s=4.0)
    found = fit(slide, motion_of(slide))
    assert found.status in REFUSED or (ratio < 1 and is_near(found, gratings[0]))


@motions
@pytest.mark.parametrize("part", [0.3, 0.7])
def test_a_vibration_at_the_ripples_frequency_is_no_grating(motion_of: MotionOf, part: float) -> None:
    for angle_deg in (-20.0, 10.0, 45.0):
        grating = Grating(1.2, angle_deg)
        slide = Slide((grating,))
        hertz = slide.speed_mm_s * np.cos(np.radians(angle_deg)) / grating.period_mm
        time_s = slide.times()[:, np.newaxis] + OFFSETS_S
        hum = part * grating.amplitude * np.cos(2 * np.pi * hertz * time_s + 1.0)
        found = fit(slide, motion_of(slide), volts=slide.volts(ARRAY, OFFSETS_S) + hum)
        assert found.status in (*REFUSED, "aliased") or is_near(found, grating)


@motions
def test_gains_may_differ_from_channel_to_channel_by_any_amount(motion_of: MotionOf) -> None:
    """One wave with arbitrary gains is one wave."""
    for seed in range(12):
        grating = Grating(1.4, -30.0 + 5 * seed)
        slide = Slide((grating,), noise=0.0, duration_s=3.0, seed=seed)
        rng = np.random.default_rng(seed)
        gain = rng.uniform(0.1, 2.0, 36)
        noise = 0.005 * rng.normal(size=(len(slide.times()), 36))
        assert_right(
            fit(slide, motion_of(slide), volts=slide.volts(ARRAY, OFFSETS_S) * gain + noise), grating
        )


@motions
@pytest.mark.parametrize("seed", range(6))
def test_taxels_that_are_pressed_unevenly_feel_one_grating(motion_of: MotionOf, seed: int) -> None:
    """All channels of a taxel share its gain, and gains vary smoothly: not the beat of two waves."""
    grating = Grating(1.05, -35.0 + 12 * seed)
    slide = Slide((grating,), duration_s=5.0, speed_mm_s=1.5, noise=0.0, seed=seed)
    x, y = ARRAY.x_mm[ARRAY.channel_taxel], ARRAY.y_mm[ARRAY.channel_taxel]
    pressed = np.exp(-((x - 2.0 - 0.5 * seed) ** 2 + (y - 5.0) ** 2) / 60)
    gain = np.random.default_rng(0).uniform(0.97, 1.03, 36) / gains(slide)
    noise = 0.0005 * np.random.default_rng(seed).normal(size=(len(slide.times()), 36))
    volts = (slide.volts(ARRAY, OFFSETS_S) - slide.level) * pressed * gain + noise
    assert_right(fit(slide, motion_of(slide), volts=volts), grating)


@motions
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("part", [0.002, 0.006])
def test_taxel_loads_make_no_answer_wrong(motion_of: MotionOf, part: float, seed: int) -> None:
    """Load rotates and scales each kind's response differently; one kind has almost no response."""
    rng = np.random.default_rng(seed)
    grating = Grating(float(rng.uniform(0.9, 1.6)), float(rng.uniform(-45, 45)))
    slide = Slide((), duration_s=5.0, noise=0.0003)
    angle = np.radians(grating.angle_deg)
    x = ARRAY.x_mm[ARRAY.channel_taxel] + slide.speed_mm_s * (slide.times()[:, np.newaxis] + OFFSETS_S)
    y = ARRAY.y_mm[ARRAY.channel_taxel]
    phase = 2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / grating.period_mm
    kind = np.arange(36) % 4
    response = np.array([0.05, 0.03, 0.007, 0.02]) * np.exp(1j * rng.uniform(-3, 3, 4))
    by_load = part * np.exp(1j * rng.uniform(-3, 3, 4))
    middle_mm = rng.uniform(2.0, 5.0, 2)  # of a round pad, or of unequal taxels
    round_load = 1.5 - ((ARRAY.x_mm - middle_mm[0]) ** 2 + (ARRAY.y_mm - middle_mm[1]) ** 2) / 12
    load = rng.standard_normal(9) if seed % 2 else round_load
    own = 0.0006 * (rng.standard_normal(36) + 1j * rng.standard_normal(36))
    felt = response[kind] + by_load[kind] * load[ARRAY.channel_taxel] + own
    ripple = (felt * np.exp(1j * phase)).real
    motion = replace(motion_of(slide), direction_deg=float(rng.normal(0, 1.5)), direction_sd_deg=1.5)
    found = fit(slide, motion, volts=slide.volts(ARRAY, OFFSETS_S) + ripple)
    assert is_near(found, grating) or found.status in REFUSED


@motions
@pytest.mark.parametrize("off_deg", [-2.0, 2.0])
@pytest.mark.parametrize("angle_deg", [20.0, 35.0, 50.0])
def test_a_slightly_wrong_direction_hides_no_crossed_grooves(
    motion_of: MotionOf, off_deg: float, angle_deg: float
) -> None:
    gratings, slide = (Grating(1.3, angle_deg), Grating(1.3, -angle_deg)), Slide(())
    for part in (0.05, 0.03):
        motion = replace(motion_of(slide), direction_deg=off_deg, direction_sd_deg=1.5)
        volts = slide.volts(ARRAY, OFFSETS_S) + crossed(1.3, angle_deg, (0.05, part))
        found = fit(slide, motion, volts=volts)
        assert found.status in REFUSED or any(is_near(found, grating) for grating in gratings)


@motions
@pytest.mark.parametrize("angle_deg", [15.0, 30.0, 35.0, 45.0, 60.0])
def test_equal_crossed_gratings_are_seen(motion_of: MotionOf, angle_deg: float) -> None:
    slide = Slide((), noise=0.001)
    volts = slide.volts(ARRAY, OFFSETS_S) + crossed(1.1, angle_deg, (0.05, 0.05))
    assert_refused(fit(slide, motion_of(slide), volts=volts), "several-gratings")


@motions
def test_a_weak_vibration_at_the_ripples_frequency_is_in_the_sigmas_or_the_window_refused(
    motion_of: MotionOf,
) -> None:
    answered = 0
    for angle_deg in range(-60, 61, 10):
        grating = Grating(1.2, float(angle_deg))
        slide = Slide((grating,), duration_s=8.0, noise=0.001)
        hertz = slide.speed_mm_s * np.cos(np.radians(angle_deg)) / grating.period_mm
        time_s = slide.times()[:, np.newaxis] + OFFSETS_S
        hum = 0.1 * grating.amplitude * np.cos(2 * np.pi * hertz * time_s + 1.0)
        volts = (slide.volts(ARRAY, OFFSETS_S) - slide.level) / gains(slide)
        found = fit(slide, motion_of(slide), volts=volts + hum)
        if found.status == "ok":
            answered += 1
            assert_right(found, grating)
    assert answered > 3

"""The joint fit of one window where the world is not the model: misfit is stated, or refused."""

import dataclasses

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
    known,
    motions,
    off,
    unknown,
)
from scipy import signal

from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, WaveParams, channel_layout
from tactiled.detect.grooves.refine import design_effect


@motions
def test_harmonics_sharpen_the_answer(motion_of: MotionOf) -> None:
    plain = Slide((Grating(),))
    sharp = Slide((Grating(harmonics=(1.0, 0.5, 0.3)),))
    found, better = fit(plain, motion_of(plain)), fit(sharp, motion_of(sharp))
    assert_right(better, sharp.gratings[0])
    assert better.n_harmonics == 3
    assert better.angle_sd_deg < 0.9 * found.angle_sd_deg


@motions
def test_a_harmonic_stronger_than_its_fundamental_is_not_taken_for_finer_grooves(motion_of: MotionOf) -> None:
    slide = Slide((Grating(period_mm=2.4, harmonics=(1.0, 3.0)),), duration_s=6.0)
    assert_right(fit(slide, motion_of(slide)), slide.gratings[0])


def test_phases_that_stray_from_taxel_to_taxel_widen_the_sigmas() -> None:
    """Taxels displaced at random by 0.01 mm: angles miss by more than noise makes them, and sigmas say so."""
    grating = Grating(angle_deg=30.0)
    z, sigmas = [], []
    for seed in range(40):
        slide = Slide((grating,), noise=0.001, seed=seed)
        moved = np.random.default_rng(seed).normal(0, 0.01, (2, 9))
        real = dataclasses.replace(ARRAY, x_mm=ARRAY.x_mm + moved[0], y_mm=ARRAY.y_mm + moved[1])
        found = fit(slide, known(slide), volts=slide.volts(real, np.linspace(0, 0.007, 36)))
        assert found.status in ("ok", "ambiguous")
        if found.status == "ok":
            z.append(off(found, grating)[1] / found.angle_sd_deg)
            sigmas.append(found.angle_sd_deg)
    assert len(z) > 30
    exact = fit(Slide((grating,), noise=0.001), known(Slide()))
    assert min(sigmas) > 3 * exact.angle_sd_deg
    assert np.mean(np.abs(z) < 2) > 0.85
    assert np.mean(np.abs(z) < 3) > 0.95


def test_noise_that_is_stronger_near_the_line_widens_the_sigmas() -> None:
    """Noise with a pole near the ripple's frequency, the same for all channels."""
    grating = Grating(angle_deg=10.0)
    z = []
    for seed in range(40):
        slide = Slide((grating,), noise=0.002, duration_s=6.0, seed=seed)
        shared = 0.01 * np.random.default_rng(1000 + seed).normal(size=len(slide.times()))
        pole = 0.9 * np.exp(2j * np.pi * 1.6 / 100)
        coloured = signal.lfilter([0.1], [1, -2 * pole.real, abs(pole) ** 2], shared)
        volts = slide.volts(ARRAY, np.linspace(0, 0.007, 36)) + 0.3 * coloured[:, np.newaxis]
        found = fit(slide, known(slide), volts=volts)
        assert found.status in ("ok", "ambiguous")
        if found.status == "ok":
            z.append(off(found, grating)[0] / found.period_sd_mm)
    assert len(z) > 30
    assert np.mean(np.abs(z) < 2) > 0.85


def test_a_speed_of_stated_sigma_widens_the_period_by_it() -> None:
    slide = Slide((Grating(angle_deg=0.0),))
    sure, unsure = fit(slide, known(slide)), fit(slide, WaveMotion(2.0, 0.01, 0.0, 0.0))
    # Not by all of it: delays alone tell the period too, and a speed said to be unsure counts for less.
    assert sure.period_sd_mm < 0.9 * unsure.period_sd_mm
    assert unsure.period_sd_mm < 1.01 * fit(slide, unknown(slide)).period_sd_mm
    assert_right(fit(slide, WaveMotion(2.02, 0.02, 0.0, 0.0)), slide.gratings[0])


def test_a_direction_of_stated_sigma_may_be_wrong_by_it() -> None:
    slide = Slide((Grating(angle_deg=40.0),))
    assert_right(fit(slide, WaveMotion(2.0, 0.0, 3.0, 2.0)), slide.gratings[0])


@pytest.mark.parametrize("tilt_deg", [0.0, 18.0, -50.0])
@pytest.mark.parametrize("off_deg", [-5.0, 4.8])
def test_a_direction_off_by_its_sigma_is_allowed_for_in_windows_of_many_periods(
    tilt_deg: float, off_deg: float
) -> None:
    """Along the normal too, where the frequency answers to a turn in second order only."""
    slide = Slide((Grating(1.0, tilt_deg),), speed_mm_s=9.0)
    found = fit(slide, WaveMotion(9.0, 0.0, off_deg, 3.0))
    assert_right(found, slide.gratings[0])
    assert found.uses_given_speed


def test_way_travelled_undoes_acceleration() -> None:
    slide = Slide(speed_mm_s=1.0, acceleration_mm_s2=1.5)
    offsets_s = np.linspace(0, 0.007, 36)
    times = slide.times()
    speeds = 1.0 + 1.5 * (times + 0.005)  # mean from each scan to the next
    motion = WaveMotion(float(speeds.mean()), 0.0, 0.0, 0.0)
    volts = slide.volts(ARRAY, offsets_s)
    found = fit_wave(volts, times, offsets_s, channel_layout(ARRAY), motion, WaveParams(), speeds_mm_s=speeds)
    assert_right(found, slide.gratings[0])


@motions
def test_two_gratings_are_both_found_the_stronger_first(motion_of: MotionOf) -> None:
    strong, weak = Grating(1.5, 30.0, 0.05), Grating(0.8, -40.0, 0.02)
    slide = Slide((weak, strong), duration_s=6.0)
    found = fit(slide, motion_of(slide))
    assert_right(found, strong)
    assert found.second is not None
    assert_right(found.second, weak)


@motions
def test_vibration_of_the_whole_pad_is_no_wave(motion_of: MotionOf) -> None:
    slide = Slide(duration_s=5.0)
    offsets_s = np.linspace(0, 0.007, 36)
    hum = 0.1 * np.cos(2 * np.pi * 7.3 * (slide.times()[:, np.newaxis] + offsets_s))
    assert_right(fit(slide, motion_of(slide), volts=slide.volts(ARRAY, offsets_s) + hum), slide.gratings[0])
    still = dataclasses.replace(slide, gratings=())
    assert_refused(fit(still, motion_of(slide), volts=still.volts(ARRAY, offsets_s) + hum), "low-snr")


@motions
def test_noise_and_random_textures_are_no_grooves(motion_of: MotionOf) -> None:
    for seed in range(10):
        slide = Slide((), seed=seed, duration_s=3.0)
        assert_refused(fit(slide, motion_of(slide)), "low-snr")
        # Sand paper: each row of taxels runs over a profile of its own.
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
            "aliased",
        )


def test_channels_that_stray_as_one_count_as_one() -> None:
    rng, layout = np.random.default_rng(3), channel_layout(ARRAY)
    effect, dof = design_effect(rng.normal(size=36), layout)
    assert 1.0 <= effect < 2.0
    assert dof == pytest.approx(30 / effect)
    together, few = design_effect(rng.normal(size=9)[ARRAY.channel_taxel], layout)
    assert (together, few) == (4.0, 7.5)


def test_strays_of_a_tenth_of_a_radian_are_answered_and_held() -> None:
    grating, held = Grating(1.4, 25.0), []
    for seed in range(20):
        slide = Slide((grating,), duration_s=3.0, seed=seed)
        late_s = 0.1 * np.random.default_rng(seed).normal(size=36) / (2 * np.pi * 2.0 / 1.4)
        volts = slide.volts(ARRAY, np.linspace(0, 0.007, 36) + late_s)
        found = fit(slide, known(slide), volts=volts)
        if found.status == "ok":
            by_mm, by_deg = off(found, grating)
            held.append((abs(by_mm) < 2 * found.period_sd_mm, abs(by_deg) < 2 * found.angle_sd_deg))
    assert len(held) >= 17
    assert np.mean(held) > 0.85


@motions
def test_one_frequency_with_phases_that_are_anything_is_no_wave(motion_of: MotionOf) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        slide = Slide((), seed=seed)
        hum = 0.02 * np.cos(4 * np.pi * slide.times()[:, np.newaxis] + rng.uniform(-np.pi, np.pi, 36))
        found = fit(slide, motion_of(slide), volts=slide.volts(ARRAY) + hum)
        assert_refused(found, "low-snr", "ambiguous")

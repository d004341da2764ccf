"""Standard deviations of the joint fit in coloured noise and with strays of channels."""

import dataclasses

import numpy as np
import pytest
from gratings import ARRAY, Grating, MotionOf, Slide, answer, assert_refused, fit, known, motions, off
from scipy import signal

from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal


def test_phase_mismatch_between_taxels_widens_the_sigmas() -> None:
    """Taxels displaced at random by 0.01 mm: angle errors exceed those of noise; sigmas include them."""
    grating = Grating(angle_deg=30.0)
    z, sigmas = [], []
    for seed in range(40):
        slide = Slide((grating,), noise=0.001, seed=seed)
        moved = np.random.default_rng(seed).normal(0, 0.01, (2, 9))
        real = dataclasses.replace(ARRAY, x_mm=ARRAY.x_mm + moved[0], y_mm=ARRAY.y_mm + moved[1])
        found = fit(slide, known(slide), volts=slide.volts(real, np.linspace(0, 0.007, 36)))
        assert found.status in ("ok", "uneven-channels")
        if isinstance(found, GrooveAnswer):
            z.append(off(found, grating)[1] / found.angle_sd_deg)
            sigmas.append(found.angle_sd_deg)
    assert len(z) > 30
    exact = answer(fit(Slide((grating,), noise=0.001), known(Slide())))
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
        if isinstance(found, GrooveAnswer):
            z.append(off(found, grating)[0] / found.period_sd_mm)
    assert len(z) > 30
    assert np.mean(np.abs(z) < 2) > 0.85


def test_mismatch_of_a_tenth_of_a_radian_is_answered_with_correct_sigmas() -> None:
    grating, held = Grating(1.4, 25.0), []
    for seed in range(20):
        slide = Slide((grating,), duration_s=3.0, seed=seed)
        late_s = 0.1 * np.random.default_rng(seed).normal(size=36) / (2 * np.pi * 2.0 / 1.4)
        volts = slide.volts(ARRAY, np.linspace(0, 0.007, 36) + late_s)
        found = fit(slide, known(slide), volts=volts)
        if isinstance(found, GrooveAnswer):
            by_mm, by_deg = off(found, grating)
            held.append((abs(by_mm) < 2 * found.period_sd_mm, abs(by_deg) < 2 * found.angle_sd_deg))
    assert len(held) >= 17
    assert np.mean(held) > 0.85


@motions
def test_one_frequency_with_random_phases_is_no_wave(motion_of: MotionOf) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        slide = Slide((), seed=seed)
        hum = 0.02 * np.cos(4 * np.pi * slide.times()[:, np.newaxis] + rng.uniform(-np.pi, np.pi, 36))
        found = fit(slide, motion_of(slide), volts=slide.volts(ARRAY) + hum)
        assert_refused(found, "low-snr", "ambiguous", "uneven-channels", "aliased")


@pytest.mark.parametrize("seed", [33, 114, 206, 248, 276, 298])
def test_a_strong_line_of_less_than_a_period_is_not_answered_by_what_is_beside_it(seed: int) -> None:
    """Slow waves of uneven friction: a climb could end where the channels have a thousandth of the line."""
    rng = np.random.default_rng(seed)
    slide, rate_hz = Slide((), speed_mm_s=1.0, duration_s=1.6), rng.uniform(0.4, 0.65)
    layout, k = channel_layout(ARRAY), rng.normal(0, 2, 2)
    phases = layout.xy_mm @ k + rng.normal(0, 0.5, 36)
    wave = 0.05 * np.cos(2 * np.pi * rate_hz * slide.times()[:, np.newaxis] + phases)
    readings = 1 + wave * (1 + 0.3 * rng.normal(size=36)) + 4e-4 * rng.normal(size=wave.shape)
    assert isinstance(fit(slide, WaveMotion(1.0, direction_sd_deg=1.0), volts=readings), Refusal)


@pytest.mark.parametrize("period_mm", [1.75, 1.8, 1.85])
def test_rounding_does_not_select_the_noise_frequencies(period_mm: float) -> None:
    # A fourth harmonic, which is not fitted, is noise of uneven density: sigmas depend on where it is read.
    grating = Grating(period_mm, 20.0, 0.05, (1.0, 0.3, 0.2, 0.2))
    slide = Slide((grating,), duration_s=3.6, noise=0.002)
    volts = slide.volts(ARRAY)
    found = []
    for seed in range(8):
        rounding = 1e-8 * np.random.default_rng(seed).normal(size=volts.shape)
        found.append(answer(fit(slide, known(slide), volts=volts + rounding)))
    assert [one.angle_sd_deg for one in found] == pytest.approx([found[0].angle_sd_deg] * 8, rel=1e-2)

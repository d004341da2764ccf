"""Likelihood of waves given phasors: least squares, mismatch of gains, phases and taxel loads."""

from typing import Any

import numpy as np
import pytest
from gratings import ARRAY, prepared

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.phasors import Phasors
from tactiled.detect.grooves.second_wave import has_second_wave

LAYOUT = channel_layout(ARRAY)
PLACE = np.stack([LAYOUT.x_mm, LAYOUT.y_mm], axis=1)
K = 2 * np.pi / 1.2 * np.array([np.cos(0.3), np.sin(0.3)])
OTHER = 2 * np.pi / 1.2 * np.array([np.cos(-0.5), np.sin(-0.5)])
SD = 0.01


def phasors_of(rng: np.random.Generator, waves: list[tuple[FloatArray, float]], factor: Any = 1.0) -> Any:
    """Phasors of waves, with one complex amplitude for each kind, in noise."""
    z = np.zeros(len(PLACE), dtype=np.complex128)
    for k, size in waves:
        amplitude = size * np.exp(2j * np.pi * rng.uniform(size=LAYOUT.is_kind.shape[1]))
        z += (LAYOUT.is_kind @ amplitude) * np.exp(1j * (PLACE @ k))
    return z * factor + SD * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z)))


def phasors(z: Any) -> Phasors:
    return Phasors(z, np.full(len(z), SD**2), LAYOUT)


def test_contributions_are_those_of_least_squares() -> None:
    z = phasors_of(np.random.default_rng(1), [(K, 1.0), (OTHER, 0.5)])
    each = phasors(z).fit(np.array([[K, OTHER]]))[0]
    columns = [
        LAYOUT.is_kind[:, kind] * np.exp(1j * (PLACE @ k))
        for k in (K, OTHER)
        for kind in range(LAYOUT.is_kind.shape[1])
    ]
    design = np.stack(columns, axis=1)
    amplitude = np.linalg.lstsq(design, z, rcond=None)[0]
    n = LAYOUT.is_kind.shape[1]
    expected = np.stack([design[:, :n] @ amplitude[:n], design[:, n:] @ amplitude[n:]], axis=1)
    assert each == pytest.approx(expected, abs=1e-6)


def test_a_wave_is_likelier_than_another_and_two_waves_than_one() -> None:
    rng = np.random.default_rng(3)
    one = phasors(phasors_of(rng, [(K, 1.0)]))
    true, other = one.likelihood(np.array([[K], [OTHER]]))
    assert true > other + 20
    two = phasors(phasors_of(rng, [(K, 1.0), (OTHER, 0.5)]))
    both = two.likelihood(np.array([[K, OTHER]]))[0]
    assert both > two.likelihood(K[np.newaxis, np.newaxis])[0] + 20


def test_one_wave_is_seldom_taken_for_more_and_two_are_not_taken_for_one() -> None:
    rng = np.random.default_rng(4)
    single = [phasors(phasors_of(rng, [(K, 1.0)])).is_single_wave(K) for _ in range(200)]
    # The least mismatch of 3 % adds to the noise: no more than the stated 1 % may fail.
    assert np.mean(single) > 0.97
    assert not any(phasors(phasors_of(rng, [(K, 1.0), (OTHER, 0.5)])).is_single_wave(K) for _ in range(50))


def test_likelihood_is_finite_without_any_ripple() -> None:
    nothing = Phasors(np.zeros(len(PLACE), dtype=np.complex128), np.full(len(PLACE), 1e-12), LAYOUT)
    pairs = np.array([[K, OTHER], [K, K]])
    assert np.isfinite(nothing.likelihood(pairs)).all()


def test_two_waves_of_one_frequency_are_seen_and_uneven_gains_are_not() -> None:
    crossed = K * [1, -1]
    variance = np.full(len(PLACE), SD**2)
    motion = WaveMotion(direction_deg=0.0, direction_sd_deg=0.0)
    window = prepared(np.zeros((99, 36)), np.arange(99) / 100, LAYOUT, motion)
    seen = {"two": 0, "one": 0}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        gain = rng.uniform(0.7, 1.3, len(PLACE)) * np.exp(0.1j * rng.standard_normal(len(PLACE)))
        one, two = phasors_of(rng, [(K, 1.0)], gain), phasors_of(rng, [(K, 1.0), (crossed, 0.5)])
        seen["one"] += has_second_wave(window, one, variance, K, False)
        seen["two"] += has_second_wave(window, two, variance, K, False)
    assert seen == {"two": 10, "one": 0}

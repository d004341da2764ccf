"""The linearised model: gradients match the likelihood; mismatch acts as a Gaussian unknown."""

from dataclasses import replace

import numpy as np
import pytest
from gratings import prepared
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout
from tactiled.detect.grooves.solve import (
    Linearisation,
    PlaneWaves,
    expected_products,
    linearise,
    sweep,
)
from tactiled.detect.grooves.window import NormalEquations

N_CHANNELS, N = 6, 200


def case(seed: int) -> tuple[FloatArray, NormalEquations, PlaneWaves]:
    """Weights of channels, ripples of two harmonics in noise, and a wave that nearly fits them."""
    rng = np.random.default_rng(seed)
    kinds = np.eye(2)[np.arange(N_CHANNELS) % 2]
    place, weight = rng.uniform(-3, 3, (N_CHANNELS, 2)), rng.uniform(1, 30, N_CHANNELS)
    place -= (place.min(axis=0) + place.max(axis=0)) / 2
    k, phase = rng.uniform(-1, 1, (1, 2)), rng.uniform(-3, 3, (1, 2, 2))
    travel = np.linspace(-1.0, 1.0, N)
    psi = 20.0 * travel + place @ k.T
    first, second = psi + kinds @ phase[0, :, :1], 2 * psi + kinds @ phase[0, :, 1:]
    volts = np.cos(first) + 0.3 * np.cos(second) + 0.2 * rng.standard_normal((N_CHANNELS, N))
    layout = ChannelLayout(place[:, 0], place[:, 1], np.arange(N_CHANNELS) % 2)
    window = prepared(volts.T, travel, layout)
    empty = np.zeros(1)
    waves = PlaneWaves(k + 0.05, np.array([20.01]), empty, empty, phase + 0.1)
    return weight, window.equations(20.0, 2), waves


def near(weight: FloatArray, equations: NormalEquations, waves: PlaneWaves) -> Linearisation:
    return linearise(equations, weight, waves, equations.product[np.newaxis])


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 4))
def test_sweep_eliminates_the_first_unknowns(seed: int, n: int, n_more: int) -> None:
    factor = np.random.default_rng(seed).standard_normal((n + n_more, n + n_more + 3))
    square = factor @ factor.T + np.eye(n + n_more)
    left = sweep(square, n)
    inverse = np.linalg.inv(square[:n, :n])
    assert left[:n, :n] == pytest.approx(inverse, rel=1e-7, abs=1e-9)
    assert left[:n, n:] == pytest.approx(inverse @ square[:n, n:], rel=1e-7, abs=1e-8)
    rest = square[n:, n:] - square[n:, :n] @ inverse @ square[:n, n:]
    assert left[n:, n:] == pytest.approx(rest, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_gradient_is_the_slope_of_the_gain(seed: int) -> None:
    weight, equations, waves = case(seed)
    here = near(weight, equations, waves)
    step = 1e-6

    def rise(moved: PlaneWaves, back: PlaneWaves) -> FloatArray:
        there = near(weight, equations, moved).gain - near(weight, equations, back).gain
        return np.asarray(there[0] / (2 * step) / 2)  # the gain is twice the logarithm

    scale = np.abs(here.gradient).max()
    for h in range(2):
        by = step * np.eye(2)[h]
        slope = rise(replace(waves, phase=waves.phase + by), replace(waves, phase=waves.phase - by))
        assert slope == pytest.approx(here.gradient[h, 0], abs=1e-5 * scale)
    slope = rise(
        replace(waves, phase_rate=waves.phase_rate + step), replace(waves, phase_rate=waves.phase_rate - step)
    )
    assert slope == pytest.approx(here.gradient[2, 0], abs=1e-5 * scale)


@pytest.mark.parametrize("seed", range(6))
def test_gradient_vanishes_at_the_wave_without_noise(seed: int) -> None:
    weight, equations, waves = case(seed)
    same = linearise(equations, weight, waves, expected_products(equations, waves))
    scale = np.sqrt(np.einsum("hhsc->hsc", same.information))
    assert same.gradient / np.maximum(scale, 1e-6) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_mismatch_is_a_gaussian_unknown(seed: int) -> None:
    weight, equations, waves = case(seed)
    plain = near(weight, equations, waves)
    rng = np.random.default_rng(seed)
    mismatch = rng.uniform(0, 0.5, (2, N_CHANNELS)) * (rng.uniform(size=(2, N_CHANNELS)) > 0.3)
    mismatched = plain.with_mismatch(mismatch)
    for c in range(N_CHANNELS):
        variance = np.zeros((3, 3))
        variance[[0, 1], [0, 1]] = mismatch[:, c]
        information, gradient = plain.information[..., 0, c], plain.gradient[:, 0, c]
        # The mismatch adds its variance to that of the measured unknowns (without inverting either).
        softened = np.linalg.inv(np.eye(3) + information @ variance)
        assert mismatched.information[..., 0, c] == pytest.approx(softened @ information, rel=1e-6, abs=1e-6)
        assert mismatched.gradient[:, 0, c] == pytest.approx(softened @ gradient, rel=1e-6, abs=1e-6)
        more = gradient @ variance @ softened @ gradient
        assert mismatched.gain[0, c] - plain.gain[0, c] == pytest.approx(more, rel=1e-6, abs=1e-6)
    none = plain.with_mismatch(np.zeros((2, N_CHANNELS)))
    assert none.information == pytest.approx(plain.information)

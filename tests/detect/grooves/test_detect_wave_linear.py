"""The wave near a point: slopes are those of the likelihood; strays cost what a Gaussian unknown costs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables, Window, tabulate, trend_basis
from tactiled.detect.grooves.linear import Geometry, Linear, Waves, expected, linearise, swept

N_CHANNELS, N = 6, 200


def case(seed: int) -> tuple[Geometry, Tables, Waves]:
    """Ripples of two harmonics under noise, and a wave that is nearly theirs."""
    rng = np.random.default_rng(seed)
    kinds = np.eye(2)[np.arange(N_CHANNELS) % 2]
    place = rng.uniform(-3, 3, (N_CHANNELS, 2))
    geometry = Geometry(place, np.zeros(N_CHANNELS), kinds, rng.uniform(1, 30, N_CHANNELS), np.zeros(2))
    k, phase = rng.uniform(-1, 1, (1, 2)), rng.uniform(-3, 3, (1, 2, 2))
    way, trend = np.linspace(-1.0, 1.0, N), trend_basis(N, 1)
    psi = 20.0 * way + place @ k.T
    first, second = psi + kinds @ phase[0, :, :1], 2 * psi + kinds @ phase[0, :, 1:]
    volts = np.cos(first) + 0.3 * np.cos(second) + 0.2 * rng.standard_normal((N_CHANNELS, N))
    volts -= (volts @ trend) @ trend.T
    window = Window(volts, way[np.newaxis], np.zeros(N_CHANNELS), 1.0, 2.0, trend)
    empty = np.zeros(1)
    waves = Waves(k + 0.05, np.array([20.01]), empty, empty, phase + 0.1)
    return geometry, tabulate(window, 20.0, 2), waves


def near(geometry: Geometry, tables: Tables, waves: Waves) -> Linear:
    return linearise(geometry, tables, waves, tables.product[np.newaxis])


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 4))
def test_swept_solves_for_the_first(seed: int, n: int, n_more: int) -> None:
    factor = np.random.default_rng(seed).standard_normal((n + n_more, n + n_more + 3))
    square = factor @ factor.T + np.eye(n + n_more)
    left = swept(square, n)
    inverse = np.linalg.inv(square[:n, :n])
    assert left[:n, :n] == pytest.approx(inverse, rel=1e-7, abs=1e-9)
    assert left[:n, n:] == pytest.approx(inverse @ square[:n, n:], rel=1e-7, abs=1e-8)
    rest = square[n:, n:] - square[n:, :n] @ inverse @ square[:n, n:]
    assert left[n:, n:] == pytest.approx(rest, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_push_is_the_slope_of_the_gain(seed: int) -> None:
    geometry, tables, waves = case(seed)
    here = near(geometry, tables, waves)
    step = 1e-6

    def rise(moved: Waves, back: Waves) -> FloatArray:
        there = near(geometry, tables, moved).gain - near(geometry, tables, back).gain
        return np.asarray(there[0] / (2 * step) / 2)  # the gain is twice the logarithm

    scale = np.abs(here.push).max()
    for h in range(2):
        by = step * np.eye(2)[h]
        slope = rise(replace(waves, phase=waves.phase + by), replace(waves, phase=waves.phase - by))
        assert slope == pytest.approx(here.push[h, 0], abs=1e-5 * scale)
    slope = rise(replace(waves, turn=waves.turn + step), replace(waves, turn=waves.turn - step))
    assert slope == pytest.approx(here.push[2, 0], abs=1e-5 * scale)


@pytest.mark.parametrize("seed", range(6))
def test_waves_see_themselves_where_there_is_no_noise(seed: int) -> None:
    geometry, tables, waves = case(seed)
    same = linearise(geometry, tables, waves, expected(geometry, tables, waves))
    scale = np.sqrt(np.einsum("hhsc->hsc", same.information))
    assert same.push / np.maximum(scale, 1e-6) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_strays_are_gaussian_unknowns(seed: int) -> None:
    geometry, tables, waves = case(seed)
    plain = near(geometry, tables, waves)
    rng = np.random.default_rng(seed)
    stray = rng.uniform(0, 0.5, (2, N_CHANNELS)) * (rng.uniform(size=(2, N_CHANNELS)) > 0.3)
    strayed = plain.strayed(stray)
    for c in range(N_CHANNELS):
        variance = np.zeros((3, 3))
        variance[[0, 1], [0, 1]] = stray[:, c]
        information, push = plain.information[..., 0, c], plain.push[:, 0, c]
        # What is measured of the unknowns is off by the strays: variances add (without inverting either).
        softened = np.linalg.inv(np.eye(3) + information @ variance)
        assert strayed.information[..., 0, c] == pytest.approx(softened @ information, rel=1e-6, abs=1e-6)
        assert strayed.push[:, 0, c] == pytest.approx(softened @ push, rel=1e-6, abs=1e-6)
        more = push @ variance @ softened @ push
        assert strayed.gain[0, c] - plain.gain[0, c] == pytest.approx(more, rel=1e-6, abs=1e-6)
    none = plain.strayed(np.zeros((2, N_CHANNELS)))
    assert none.information == pytest.approx(plain.information)

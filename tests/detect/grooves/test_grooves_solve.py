"""The solver: gradients match the likelihood, and the answer is that of an optimiser of another kind."""

from dataclasses import replace

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide, prepared
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion, channel_layout
from tactiled.detect.grooves.solve import Linearisation, PlaneWaves, WaveSolver, linearise, sweep
from tactiled.detect.grooves.window import NormalEquations

LAYOUT = channel_layout(ARRAY)
SLIDE = Slide((Grating(1.2, 20.0),), noise=0.01)
HZ = 2.0 * np.cos(np.radians(20.0)) / 1.2
NOISE = 0.01
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


def direct_fit(volts: FloatArray, time_s: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares over wave vector, frequency and the phase of each kind, by numerical derivatives.

    Level, slope and amplitude of each channel are solved for inside (variable projection).
    """
    n_kinds = LAYOUT.is_kind.shape[1]

    def residual(unknown: FloatArray) -> FloatArray:
        k, hz, phase = unknown[:2], unknown[2], unknown[3:] @ LAYOUT.is_kind.T
        psi = LAYOUT.x_mm * k[0] + LAYOUT.y_mm * k[1]
        out = []
        for c in range(ARRAY.n_channels):
            wave = np.cos(2 * np.pi * hz * time_s + psi[c] + phase[c])
            design = np.stack([np.ones_like(time_s), time_s, wave], axis=1)
            out.append(volts[:, c] - design @ np.linalg.lstsq(design, volts[:, c], rcond=None)[0])
        return np.concatenate(out) / NOISE

    # Phases of the kinds from a coarse grid, so that the optimiser starts near the maximum.
    grid = np.linspace(-np.pi, np.pi, 12, endpoint=False)
    phases = np.zeros(n_kinds)
    for kind in range(n_kinds):
        mine = np.flatnonzero(LAYOUT.kind == kind)
        total = sum(
            (volts[:, c] - volts[:, c].mean())
            @ np.exp(-1j * (2 * np.pi * HZ * time_s + LAYOUT.x_mm[c] * start[0] + LAYOUT.y_mm[c] * start[1]))
            for c in mine
        )
        phases[kind] = grid[np.abs(np.exp(1j * grid) - total / abs(total)).argmin()]
    found = optimize.least_squares(residual, np.concatenate([start, [HZ], phases]), x_scale="jac")
    jacobian = np.asarray(found.jac)
    return found.x[:3], np.linalg.inv(jacobian.T @ jacobian)[:3, :3]


@pytest.mark.parametrize("seed", range(3))
def test_answer_and_covariance_are_those_of_a_direct_least_squares_fit(seed: int) -> None:
    slide = Slide(SLIDE.gratings, noise=NOISE, seed=seed)
    volts, time_s = slide.volts(ARRAY), slide.times()
    true_k = 2 * np.pi / 1.2 * np.array([np.cos(np.radians(20.0)), np.sin(np.radians(20.0))])
    start = true_k * 1.01
    motion = WaveMotion(direction_deg=0.0, direction_sd_deg=0.0)
    window = prepared(volts, time_s, LAYOUT, motion)
    line = np.pi * HZ * window.duration_s
    solver = WaveSolver(window, np.full(ARRAY.n_channels, NOISE**2))
    equations = window.equations(line)
    found = solver.solve(equations, start[np.newaxis], np.array([line]))
    for _ in range(2):  # the equations follow a change of frequency to first order only
        equations = window.equations(float(found.phase_rate[0]))
        found = solver.solve(equations, found.k, found.phase_rate)
    direct, covariance = direct_fit(volts, time_s, start)
    sd = np.sqrt(np.diag(covariance))
    hz = window.frequency_hz(float(found.phase_rate[0]))
    assert np.abs(np.array([*found.k[0], hz]) - direct) / sd == pytest.approx(np.zeros(3), abs=0.05)
    stated = np.sqrt(np.diag(found.covariance[0]))
    stated[2] /= np.pi * window.duration_s
    assert stated == pytest.approx(sd, rel=0.05)


@pytest.mark.parametrize("angle_deg", [0.0, 50.0])
def test_a_direction_that_is_not_known_well_lets_the_phase_rate_leave_the_tie(angle_deg: float) -> None:
    """By the root mean square of what errors of the direction change, drawn at random."""
    volts, time_s = SLIDE.volts(ARRAY), SLIDE.times()
    window = prepared(volts, time_s, LAYOUT, WaveMotion(2.0, 0.0, 0.0, 10.0))
    solver = WaveSolver(window, np.full(ARRAY.n_channels, NOISE**2))
    angle, errors = np.radians(angle_deg), np.radians(10.0) * np.random.default_rng(0).standard_normal(20_000)
    k = 5.0 * np.array([[np.cos(angle), np.sin(angle)]])
    tied = window.half_travel * 5.0 * np.cos(angle)
    moved = window.half_travel * 5.0 * np.cos(angle + errors) - tied
    most = solver.likely_phase_rate(k, 1e9, 2.0)[0]
    assert most - tied == pytest.approx(2.0 * np.sqrt((moved**2).mean()), rel=0.05)
    assert solver.likely_phase_rate(k, tied + 1e-3, 2.0)[0] == tied + 1e-3

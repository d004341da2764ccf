"""The wave solver against an optimiser of another kind on the same readings."""

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide, prepared
from scipy import optimize

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.solve import WaveSolver

LAYOUT = channel_layout(ARRAY)
SLIDE = Slide((Grating(1.2, 20.0),), noise=0.01)
HZ = 2.0 * np.cos(np.radians(20.0)) / 1.2
NOISE = 0.01


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


def test_a_known_speed_ties_frequency_and_wave_vector() -> None:
    volts, time_s = SLIDE.volts(ARRAY), SLIDE.times()
    window = prepared(volts, time_s, LAYOUT, WaveMotion(2.0, 0.0, 0.0, 0.0))
    solver = WaveSolver(window, np.full(ARRAY.n_channels, NOISE**2))
    line = np.pi * HZ * window.duration_s
    start = 2 * np.pi / 1.2 * np.array([[np.cos(np.radians(20.0)), np.sin(np.radians(20.0))]])
    found = solver.solve(window.equations(line), start, np.array([line]))
    assert found.phase_rate[0] == pytest.approx(window.half_travel * found.k[0, 0], rel=1e-9)
    free = WaveSolver(window.without_speed, np.full(ARRAY.n_channels, NOISE**2)).solve(
        window.equations(line), start, np.array([line])
    )
    assert found.covariance[0, 0, 0] < 0.7 * free.covariance[0, 0, 0]


def test_channels_that_hold_no_ripple_give_finite_numbers() -> None:
    volts, time_s = np.ones((300, ARRAY.n_channels)), np.arange(300) / 100
    window = prepared(volts, time_s, LAYOUT)
    solver = WaveSolver(window, np.full(ARRAY.n_channels, 1e-6))
    found = solver.solve(window.equations(30.0, 2), np.array([[1.0, 0.3]]), np.array([30.0]))
    for value in (found.k, found.phase_rate, found.gain, found.covariance, found.phase):
        assert np.isfinite(value).all()


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

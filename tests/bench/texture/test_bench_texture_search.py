"""An exhaustive least-squares search that shares nothing with the estimator finds the same gratings."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench.texture.signal import Grating, Wave, bound, draw_grating, readings
from bench.texture.trials import joint
from tactiled.array import FloatArray
from tactiled.detect.grooves.outcome import GrooveAnswer

_FINEST = 2.0  # turns a millimetre: a period of 0.5 mm
_TILT = float(np.tan(np.radians(80)))  # between groove normal and motion
_MIN_PERIODS = 2.5  # a line whose peak is half a bin off may still have three
_PHASES = np.arange(24) * 2 * np.pi / 24
_POLISHED = 8


def search(case: Grating, volts: FloatArray) -> tuple[Wave, float]:
    """Grating of the least sum of squares over all that could be, motion known, and that sum.

    All is fitted from the readings themselves: no tables, no linearisation, no gradient but differences.
    """
    starts = _lattice(case, volts)
    found = [_polish(case, volts, per_mm) for per_mm in starts]
    per_mm, cost = min(found, key=lambda entry: entry[1])
    per_mm = per_mm if per_mm[0] > 0 else -per_mm
    angle_deg = float(np.degrees(np.arctan2(per_mm[1], per_mm[0])))
    motion = case.wave
    return Wave(1 / float(np.hypot(*per_mm)), angle_deg, motion.speed_mm_s, motion.direction_deg), cost


def _places(case: Grating) -> FloatArray:
    sensed = case.sensed
    return np.column_stack([sensed.x_mm - sensed.x_mm.mean(), sensed.y_mm - sensed.y_mm.mean()])


def _way(case: Grating) -> FloatArray:
    """Way (n, channels, 2) of each reading's place, the middle of the window at 0."""
    theta = np.radians(case.wave.direction_deg)
    time_s = case.time_s[:, None] - case.time_s.mean() + case.sensed.offset_s
    heading = np.array([np.cos(theta), np.sin(theta)])
    return np.asarray((case.wave.speed_mm_s * time_s)[..., None] * heading)


def _detrended(case: Grating, columns: FloatArray) -> FloatArray:
    basis, _ = np.linalg.qr(np.column_stack([np.ones_like(case.time_s), case.time_s]))
    return np.asarray(columns - basis @ (basis.T @ columns))


def _lattice(case: Grating, volts: FloatArray) -> list[FloatArray]:
    """The best wave vectors (turns a millimetre) of a lattice, amplitudes being what channels show.

    Along the motion steps are a quarter of a period in the window; across it, 0.04 turns at the array's rim.
    """
    clean, places, way = _detrended(case, volts), _places(case), _way(case)
    theta = np.radians(case.wave.direction_deg)
    heading, normal = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    length_mm = case.wave.speed_mm_s * np.ptp(case.time_s)
    found: list[tuple[float, FloatArray]] = []
    for along in np.arange(_MIN_PERIODS / length_mm, _FINEST, 0.25 / length_mm):
        phasor = (clean * np.exp(-2j * np.pi * along * (way @ heading))).sum(axis=0)
        across = np.arange(-_TILT * along, _TILT * along, 0.01)
        per_mm = along * heading + across[:, None] * normal
        turned = phasor * np.exp(-2j * np.pi * (per_mm @ places.T))
        power = np.zeros(len(across))
        for kind in np.unique(case.sensed.kind):
            mine = turned[:, case.sensed.kind == kind, None] * np.exp(1j * _PHASES)
            power += (np.maximum(mine.real, 0.0) ** 2).sum(axis=1).max(axis=1)
        found += zip(power.tolist(), per_mm, strict=True)
    chosen: list[FloatArray] = []
    for _, per_mm in sorted(found, key=lambda entry: -entry[0]):
        if all(np.abs(per_mm - other).max() > 0.05 for other in chosen):
            chosen.append(per_mm)
        if len(chosen) == _POLISHED:
            break
    return chosen


def _polish(case: Grating, volts: FloatArray, per_mm: FloatArray) -> tuple[FloatArray, float]:
    clean, places, way = _detrended(case, volts), _places(case), _way(case)
    kind = case.sensed.kind

    def residual(unknown: FloatArray) -> FloatArray:
        phase = 2 * np.pi * ((way + places) @ unknown[:2]) + unknown[2:][kind]
        wave = _detrended(case, np.cos(phase))
        amplitude = np.maximum((wave * clean).sum(axis=0) / (wave * wave).sum(axis=0), 0.0)
        return np.asarray((clean - amplitude * wave).ravel())

    turned = np.exp(-2j * np.pi * ((way + places) @ per_mm))
    phasor = (clean * turned).sum(axis=0)
    phases = [float(np.angle(phasor[kind == k].sum())) for k in range(kind.max() + 1)]
    fit = least_squares(residual, np.concatenate([per_mm, phases]), x_scale="jac", xtol=1e-12, ftol=1e-12)
    return fit.x[:2], float(2 * fit.cost)


@pytest.mark.parametrize(("window_s", "snr_db", "seed"), [(1.0, 20.0, 0), (2.0, 10.0, 1), (2.0, 0.0, 2)])
def test_search_finds_what_the_estimator_finds(window_s: float, snr_db: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    case = draw_grating(rng, window_s, snr_db, 3.0)
    volts = readings(case, rng)
    found, _ = search(case, volts)
    said = joint(volts, case.sensed.offset_s, case.wave, is_speed_known=True)
    least = bound(case.wave, case.sensed, case.time_s, is_speed_known=True)
    assert isinstance(said, GrooveAnswer)
    # The estimator gives each channel its own noise and drift a cubic: that moves it by a part of a sigma.
    assert abs(said.period_mm - found.period_mm) < least.period_sd_mm
    assert abs(said.angle_deg - found.angle_deg) < least.angle_sd_deg

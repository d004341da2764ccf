"""The amplitude spectrum of a window, against SciPy, and the signal-to-noise ratio it states."""

import numpy as np
import pytest
from scipy.signal import detrend, periodogram

from tactiled.array import FloatArray
from tactiled.wang2019.spectrum import spectrum

STEP = 8.0 / 2**23


def sines(frequency_hz: float, snr_db: float, seed: int = 0) -> FloatArray:
    """Three taxels with one ripple at different phases, 10 s at 100 Hz."""
    rng = np.random.default_rng(seed)
    phase = 2 * np.pi * frequency_hz * np.arange(1000)[:, np.newaxis] / 100 + np.arange(3)
    noise = rng.standard_normal(phase.shape) / np.sqrt(2 * 10 ** (snr_db / 10))
    return np.asarray(1.0 + 0.05 * (np.cos(phase) + noise))


def test_spectrum_is_that_of_scipy() -> None:
    volts = sines(1 / 1.2, 10.0)
    frequency_hz, density = periodogram(detrend(volts, axis=0), 100.0, detrend=False, axis=0)
    ours = spectrum(volts, 100.0, STEP, 20.0)
    assert ours.frequency_hz == pytest.approx(frequency_hz)
    # One-sided density is amplitude^2 / 2 over the width of a bin.
    assert ours.amplitude_volts[1:-1] ** 2 / 2 * 10 == pytest.approx(density[1:-1], rel=1e-6, abs=1e-15)
    assert ours.peak_hz == frequency_hz[density.sum(axis=1).argmax()]


def test_stated_snr_is_that_of_the_signal() -> None:
    stated = [spectrum(sines(0.8, 6.0, seed), 100.0, STEP, 20.0).snr_db for seed in range(10)]
    assert np.mean(stated) == pytest.approx(6.0, abs=0.7)

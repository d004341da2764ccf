"""Spectrum of the readings of a window, and which of its bins belong to a line."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.window import trend_basis

HARMONICS = (2, 3)  # prior: a higher harmonic is never the strongest line of a ridge
_TREND_ORDER = 3  # choice
LEAST_CYCLES = _TREND_ORDER  # periods in the window: a cubic trend leaves humps of fewer
_LEAST_SD = 1e-12  # derived: of the readings: less is the rounding of the trend
LOBE = 2  # derived: bins to either side that a Hann window spreads a line over


@dataclass(frozen=True, eq=False)
class SwingSpectrum:
    """Readings of a window less a cubic trend, and their spectrum under a Hann window."""

    readings: FloatArray  # (n, channels)
    # (channels,): standard deviation of the readings; 0 where they change by no more than rounding
    sd: FloatArray
    values: NDArray[np.complex128]  # (bins, channels): bin b has b periods in the window


def swing_spectrum(readings: FloatArray) -> SwingSpectrum:
    """Spectrum of finite readings (n, channels), in any unit."""
    trend = trend_basis(len(readings), _TREND_ORDER)
    centred = readings - readings.mean(axis=0)
    centred = np.asarray(centred - trend @ (trend.T @ centred))
    sd, size = centred.std(axis=0), np.abs(readings).max(axis=0)
    values = np.fft.rfft(np.hanning(len(readings))[:, np.newaxis] * centred, axis=0)
    return SwingSpectrum(centred, np.where(sd > _LEAST_SD * size, sd, 0.0), values)


def apart_from(cycles: NDArray[np.int64], line: int) -> NDArray[np.bool_]:
    """True for bins outside the lobes of a line and of its harmonics, which uneven ridges widen."""
    apart = np.abs(cycles - line) > LOBE
    for harmonic in HARMONICS:
        apart &= np.abs(cycles - harmonic * line) > harmonic + 1
    return apart

"""Pooled spectrum of a window, with the threshold for lines, and the noise around them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import FALSE_ALARM
from tactiled.detect.grooves.window import (
    CLEAR_CYCLES,
    LEAST_VARIANCE,
    DetrendedWindow,
)
from tactiled.detect.signal.median import median

# derived: bins per period of the window. The largest bin is then within 1/8 of a bin of the peak.
_PADDING = 4
# choice: bins to either side over which the noise density is taken as constant.
_NEIGHBOURS = 40
# derived: periods in the window. Anything slower is a straight trend.
LEAST_CYCLES = 0.5
# derived: periods in the window. Below this, a line and its image at the negative frequency are one hump
# under a Hann window.
_SLOW_CYCLES = 8
# choice: frequencies beside a line, one period of the window apart, from which the noise there is read.
_FLOOR_PLACES = 4
# derived: bins that belong to the line itself: the main lobe of a Hann window and a little more.
_NEAR = 3


@dataclass(frozen=True, eq=False)
class LineSpectrum:
    """Pooled spectrum of a window."""

    cycles: FloatArray  # (bins,): periods in the window
    power: FloatArray  # (bins,): mean over channels of power over noise; 1 for noise
    needed: FloatArray  # (bins,): power above which a peak is a line
    variance: FloatArray  # (channels,): of each channel's noise, assumed white, volts^2

    def peaks(self) -> list[int]:
        """Bins of the lines, the strongest first."""
        inner = self.power[1:-1]
        is_peak = (inner > self.power[:-2]) & (inner >= self.power[2:]) & (inner > self.needed[1:-1])
        bins = np.flatnonzero(is_peak & (self.cycles[1:-1] >= LEAST_CYCLES)) + 1
        return [int(b) for b in bins[np.argsort(-self.power[bins], kind="stable")]]


def line_spectra(window: DetrendedWindow, *others: DetrendedWindow) -> list[LineSpectrum]:
    """Spectra over the distance travelled, under a Hann window, with the threshold for lines.

    Parameters
    ----------
    *others : DetrendedWindow
        Windows of the same readings with other trends.
    """
    n = window.n
    even = np.linspace(-1.0, 1.0, n)
    if len(window.travel) == 1 and np.ptp(np.diff(window.travel[0])) < 1e-6:
        volts = window.volts
    else:  # interpolation is accurate enough to find the line; the fit uses the original samples
        travels = np.broadcast_to(window.travel, window.volts.shape)
        volts = np.array(
            [np.interp(even, travel, row) for travel, row in zip(travels, window.volts, strict=True)]
        )
    hann = 1.0 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    power = np.abs(np.fft.rfft(volts * hann, _PADDING * n, axis=1)) ** 2 / (hann**2).sum()
    variance = np.maximum(median(power[:, _PADDING::_PADDING]) / np.log(2), LEAST_VARIANCE)
    pooled = (1 / variance) @ power / len(volts)
    needed = _needed(pooled, len(volts))
    cycles = np.arange(len(pooled)) / _PADDING
    n_slow = min(_SLOW_CYCLES * _PADDING, len(pooled))
    waves = _slow_waves(window, n_slow)
    found = []
    for each in (window, *others):
        slow = _least_squares_power(each, waves, variance)
        found.append(LineSpectrum(cycles, np.concatenate([slow, pooled[n_slow:]]), needed, variance))
    return found


def floor_beside(window: DetrendedWindow, phase_rate: float, variance: FloatArray, line: float) -> float:
    """Ratio of the noise at a phase rate to its stated variance, estimated beside it.

    The noise of a real skin falls with frequency, at most like a random walk (1 / f^2). Estimates from higher
    frequencies are therefore raised by that law; estimates from lower frequencies count unchanged.

    Parameters
    ----------
    window : DetrendedWindow
        Without the line at `line` and its harmonics.
    variance : (channels,) float64
    line : float
        Phase rate of the line that was removed.
    """
    here, apart = phase_rate / np.pi, line / np.pi
    there = here + np.array([-2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
    clear = np.abs(there - np.maximum(np.round(there / apart), 1) * apart) >= min(CLEAR_CYCLES, apart / 2)
    clear &= np.array([not window.is_removed(np.pi * place) for place in there])
    there = there[(there >= CLEAR_CYCLES) & (there < window.n / 2 - 1) & clear][:_FLOOR_PLACES]
    if not len(there):
        return np.inf
    rises = np.maximum(there / here, 1.0) ** 2
    waves = np.exp(1j * np.outer(np.pi * there, window.travel.mean(axis=0)))
    powers = _least_squares_power(window, waves, variance)
    return float((powers * rises).mean())


def _slow_waves(window: DetrendedWindow, n_bins: int) -> NDArray[np.complex128]:
    """Complex waves at the first bins of the spectrum: (bins, n); half a bin stands for bin 0."""
    phase_rate = np.pi / _PADDING * (window.n - 1) / window.n
    first = np.exp(1j * phase_rate * window.travel.mean(axis=0))
    waves = np.cumprod(np.broadcast_to(first, (n_bins - 1, window.n)), axis=0)
    return np.concatenate([np.exp(0.5j * phase_rate * window.travel.mean(axis=0))[np.newaxis], waves])


def _least_squares_power(
    window: DetrendedWindow, waves: NDArray[np.complex128], variance: FloatArray
) -> FloatArray:
    """Mean over channels of power over noise that waves explain, 1 for noise: (waves,).

    Least squares on sine and cosine with the slow part projected out.
    """
    basis = np.concatenate([waves.real, waves.imag])
    basis -= (basis @ window.trend) @ window.trend.T
    product = (basis @ window.volts.T).reshape(2, len(waves), -1).swapaxes(0, 1)
    basis = basis.reshape(2, *waves.shape)
    gram = np.einsum("itn,jtn->tij", basis, basis)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(2)
    explained = (product * np.linalg.solve(gram, product)).sum(axis=1)
    return np.asarray((explained / variance).mean(axis=1) / 2)


def _needed(pooled: FloatArray, n_channels: int) -> FloatArray:
    """Threshold that noise exceeds once in `1 / FALSE_ALARM` windows, from the scatter of nearby bins.

    The mean of the spectra of m independent channels is gamma distributed with shape m. Noise that channels
    share, such as a random texture under all taxels, has a smaller shape, down to 1; the scatter of the
    logarithms yields it.
    """
    bins = np.log(np.maximum(pooled[::_PADDING], 1e-12))
    if len(bins) > _NEIGHBOURS + 1:
        padded = np.pad(bins[1:], _NEIGHBOURS, mode="reflect")
        views = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
        views = np.concatenate([views[:1], views])
        beside = [views[:, : _NEIGHBOURS - _NEAR], views[:, _NEIGHBOURS + _NEAR + 1 :]]
        around = np.concatenate(beside, axis=1)
    else:
        around = np.broadcast_to(bins[1:], (len(bins), len(bins) - 1))
    level = median(around)
    scatter = 1.4826 * median(np.abs(around - level[:, np.newaxis]))
    shape = np.clip(1.0 / np.maximum(scatter, 1e-3) ** 2, 1.0, n_channels)
    mean = np.exp(level - special.digamma(shape)) * shape
    needed = mean * special.gammainccinv(shape, FALSE_ALARM / len(bins)) / shape
    return np.repeat(needed, _PADDING)[: len(pooled)]

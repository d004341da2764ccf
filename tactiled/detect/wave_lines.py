"""Where in the spectrum of a window ripples stand out, and how strong the noise around them is."""

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Window

_PADDING = 4  # bins a period of the window: the largest is then within 1/8 of a bin of the peak
_NEIGHBOURS = 40  # bins to either side in which noise is taken to be of one density
LEAST_CYCLES = 0.5  # slower ones are a straight trend
_SLOW_CYCLES = 8  # below, a line and its image at the negative frequency are one hump under a Hann window
_NEAR = 3  # of them, belong to the line itself: a Hann window's main lobe and a little
# White noise passes for a line once in so many windows.
_FALSE_LINE = 1e-6
# No noise is smaller than that of converters of 22 bits on 3 V; keeps a noiseless signal's weights finite.
LEAST_VARIANCE = (1e-6) ** 2 / 12


@dataclass(frozen=True, eq=False)
class Lines:
    """Pooled spectrum of a window.

    Attributes
    ----------
    cycles : (bins,) float64
        Periods in the window.
    power : (bins,) float64
        Mean over channels of power over noise; 1 for noise.
    needed : (bins,) float64
        What a line must have to be one.
    variance : (channels,) float64
        Of each channel's noise, taken to be white.
    """

    cycles: FloatArray
    power: FloatArray
    needed: FloatArray
    variance: FloatArray

    def peaks(self) -> list[int]:
        """Bins of lines, the strongest first."""
        inner = self.power[1:-1]
        is_peak = (inner > self.power[:-2]) & (inner >= self.power[2:]) & (inner > self.needed[1:-1])
        bins = np.flatnonzero(is_peak & (self.cycles[1:-1] >= LEAST_CYCLES)) + 1
        return [int(b) for b in bins[np.argsort(-self.power[bins], kind="stable")]]


def find_lines(window: Window) -> Lines:
    """Spectrum by way travelled, under a Hann window, with the level that lines must pass."""
    n = window.n
    even = np.linspace(-1.0, 1.0, n)
    if len(window.way) == 1 and np.ptp(np.diff(window.way[0])) < 1e-6:
        volts = window.volts
    else:  # good enough to find the line; the fit uses the readings where they are
        ways = np.broadcast_to(window.way, window.volts.shape)
        volts = np.array([np.interp(even, way, row) for way, row in zip(ways, window.volts, strict=True)])
    hann = 1.0 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    size = _PADDING * n
    power = np.abs(np.fft.rfft(volts * hann, size, axis=1)) ** 2 / (hann**2).sum()
    at_bins = slice(_PADDING, None, _PADDING)
    variance = np.maximum(np.median(power[:, at_bins], axis=1) / np.log(2), LEAST_VARIANCE)
    pooled = (power / variance[:, np.newaxis]).mean(axis=0)
    needed = _needed(pooled, len(volts))
    cycles = np.arange(len(pooled)) / _PADDING
    n_slow = min(_SLOW_CYCLES * _PADDING, len(pooled))
    pooled[:n_slow] = _slow_power(window, cycles[:n_slow], variance)
    return Lines(cycles, pooled, needed, variance)


def _slow_power(window: Window, cycles: FloatArray, variance: FloatArray) -> FloatArray:
    """The same by least squares, sine and cosine with the slow part taken out: (bins,)."""
    turns = np.pi * np.maximum(cycles, cycles[1] / 2) * (window.n - 1) / window.n
    angle = np.outer(turns, window.way.mean(axis=0))
    basis = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # (bins, 2, n)
    basis -= (basis @ window.trend) @ window.trend.T
    gram = basis @ basis.swapaxes(1, 2)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(2)
    product = (basis.reshape(-1, window.n) @ window.volts.T).reshape(len(turns), 2, -1)
    explained = (product * np.linalg.solve(gram, product)).sum(axis=1)
    return np.asarray((explained / variance).mean(axis=1) / 2)


def _needed(pooled: FloatArray, n_channels: int) -> FloatArray:
    """Level that noise passes once in `1 / _FALSE_LINE` windows, from how the bins around scatter.

    The mean of m independent channels' spectra is gamma distributed with shape m. Noise that channels share,
    such as a random texture under all taxels, has a smaller shape, down to 1: the scatter of the logs tells.
    """
    bins = np.log(np.maximum(pooled[::_PADDING], 1e-12))
    width = 2 * _NEIGHBOURS + 1
    padded = np.pad(bins[1:], _NEIGHBOURS, mode="reflect") if len(bins) > _NEIGHBOURS + 1 else None
    if padded is None:
        around = np.broadcast_to(bins[1:], (len(bins), len(bins) - 1))
    else:
        views = np.lib.stride_tricks.sliding_window_view(padded, width)
        around = np.concatenate([views[:1], views])
        around = np.delete(around, slice(_NEIGHBOURS - _NEAR, _NEIGHBOURS + _NEAR + 1), axis=1)
    level = np.median(around, axis=1)
    scatter = 1.4826 * np.median(np.abs(around - level[:, np.newaxis]), axis=1)
    shape = np.clip(1.0 / np.maximum(scatter, 1e-3) ** 2, 1.0, n_channels)
    mean = np.exp(level - special.digamma(shape)) * shape
    needed = mean * stats.gamma.isf(_FALSE_LINE / len(bins), shape) / shape
    return np.repeat(needed, _PADDING)[: len(pooled)]

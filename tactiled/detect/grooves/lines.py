"""Where in the spectrum of a window ripples stand out, and how strong the noise around them is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Window

_PADDING = 4  # bins a period of the window: the largest is then within 1/8 of a bin of the peak
_NEIGHBOURS = 40  # bins to either side in which noise is taken to be of one density
LEAST_CYCLES = 0.5  # slower ones are a straight trend
_SLOW_CYCLES = 8  # below, a line and its image at the negative frequency are one hump under a Hann window
_FLOOR_PLACES = 4  # beside a frequency, a period of the window apart, tell the noise there
_CLEAR = 0.75  # periods of the window: nearer to a line or to the trend, noise has been taken with it
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


def find_lines(window: Window, *others: Window) -> list[Lines]:
    """Spectrum by way travelled, under a Hann window, with the level that lines must pass.

    Of a window, and of others that differ from it in their slow trends.
    """
    n = window.n
    even = np.linspace(-1.0, 1.0, n)
    if len(window.way) == 1 and np.ptp(np.diff(window.way[0])) < 1e-6:
        volts = window.volts
    else:  # good enough to find the line; the fit uses the readings where they are
        ways = np.broadcast_to(window.way, window.volts.shape)
        volts = np.array([np.interp(even, way, row) for way, row in zip(ways, window.volts, strict=True)])
    hann = 1.0 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    power = np.abs(np.fft.rfft(volts * hann, _PADDING * n, axis=1)) ** 2 / (hann**2).sum()
    variance = np.maximum(_median(power[:, _PADDING::_PADDING]) / np.log(2), LEAST_VARIANCE)
    pooled = (1 / variance) @ power / len(volts)
    needed = _needed(pooled, len(volts))
    cycles = np.arange(len(pooled)) / _PADDING
    n_slow = min(_SLOW_CYCLES * _PADDING, len(pooled))
    waves = _slow_waves(window, n_slow)
    found = []
    for each in (window, *others):
        slow = _least_squares_power(each, waves, variance)
        found.append(Lines(cycles, np.concatenate([slow, pooled[n_slow:]]), needed, variance))
    return found


def floor_beside(window: Window, turn: float, variance: FloatArray, line: float) -> float:
    """Noise at a frequency over the variance it is said to have, as its neighbours tell it.

    Noise of a real skin falls with frequency, at the most as that of a random walk (1 / f^2): what is read
    off higher neighbours is taken to rise so towards the frequency; what is read off lower ones counts as is.

    Parameters
    ----------
    window : Window
        Without the line at `line` (a turn) and its harmonics.
    turn : float
    """
    here, apart = turn / np.pi, line / np.pi
    there = here + np.array([-2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
    clear = np.abs(there - np.maximum(np.round(there / apart), 1) * apart) >= min(_CLEAR, apart / 2)
    clear &= np.array([not window.is_gone(np.pi * place) for place in there])
    there = there[(there >= _CLEAR) & (there < window.n / 2 - 1) & clear][:_FLOOR_PLACES]
    if not len(there):
        return np.inf
    rises = np.maximum(there / here, 1.0) ** 2
    waves = np.exp(1j * np.outer(np.pi * there, window.way.mean(axis=0)))
    powers = _least_squares_power(window, waves, variance)
    return float((powers * rises).mean())


def _slow_waves(window: Window, n_bins: int) -> NDArray[np.complex128]:
    """Waves of the first bins of the spectrum: (bins, n); of half a bin in place of none."""
    turn = np.pi / _PADDING * (window.n - 1) / window.n
    first = np.exp(1j * turn * window.way.mean(axis=0))
    waves = np.cumprod(np.broadcast_to(first, (n_bins - 1, window.n)), axis=0)
    return np.concatenate([np.exp(0.5j * turn * window.way.mean(axis=0))[np.newaxis], waves])


def _least_squares_power(window: Window, waves: NDArray[np.complex128], variance: FloatArray) -> FloatArray:
    """Mean over channels of power over noise that waves explain, 1 for noise: (waves,).

    By least squares, sine and cosine with the slow part taken out.
    """
    basis = np.concatenate([waves.real, waves.imag])
    basis -= (basis @ window.trend) @ window.trend.T
    product = (basis @ window.volts.T).reshape(2, len(waves), -1).swapaxes(0, 1)
    basis = basis.reshape(2, *waves.shape)
    gram = np.einsum("itn,jtn->tij", basis, basis)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(2)
    explained = (product * np.linalg.solve(gram, product)).sum(axis=1)
    return np.asarray((explained / variance).mean(axis=1) / 2)


def _median(values: FloatArray) -> FloatArray:
    """Of each row; NumPy sorts many short rows in a tenth of the time that its median takes."""
    ordered, half = np.sort(values, axis=-1), values.shape[-1] // 2
    return np.asarray((ordered[..., half] + ordered[..., -1 - half]) / 2)


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
        views = np.concatenate([views[:1], views])
        beside = [views[:, : _NEIGHBOURS - _NEAR], views[:, _NEIGHBOURS + _NEAR + 1 :]]
        around = np.concatenate(beside, axis=1)
    level = _median(around)
    scatter = 1.4826 * _median(np.abs(around - level[:, np.newaxis]))
    shape = np.clip(1.0 / np.maximum(scatter, 1e-3) ** 2, 1.0, n_channels)
    mean = np.exp(level - special.digamma(shape)) * shape
    needed = mean * special.gammainccinv(shape, _FALSE_LINE / len(bins)) / shape
    return np.repeat(needed, _PADDING)[: len(pooled)]

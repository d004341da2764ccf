"""Loads and shears of the taxels from readings: zero, noise, and the coif1 approximation that noise asks for.

The approximation of level J of the stationary coif1 transform is one causal filter, the cascade of J low-pass
filters (Mallat, A Wavelet Tour of Signal Processing, 3rd ed., 5.5). The scaling function of a coiflet has
vanishing moments, so that a ramp passes with a pure delay of 3 (2^J - 1) scans. The standard deviation of the
noise is read off the detail coefficients of the two finest levels: all filters of the transform have unit
energy, so that white noise has the same standard deviation in each.
"""

import functools
import math

import numpy as np
import pywt
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.grip.elementary import sums_in_order
from tactiled.detect.signal.wavelet import delay_scans, taps

FLOOR_LEVELS = 2
_LONGEST_DELAY_S = 0.06  # of the approximation: beyond it, the shares of the taxels come too late to help
_NOISE_WANTED = (
    0.01  # of a taxel's shear over load; below it the misfit of the model is larger than the noise
)
_FLOOR_S = 1.0  # averaging time of the noise
_CLIP = 3.0  # standard deviations: a coefficient beyond counts as this much, since it is signal
_CLIPPED_AFTER = 20  # scans: before, the mean is too uncertain to clip by
_ROUNDING = math.sqrt(12)  # rounding to steps of q has a standard deviation of q / sqrt(12)
_MEAN_ABS = math.sqrt(2 / math.pi)  # of a normal variable of unit variance


@functools.cache
def approximation_taps(level: int) -> FloatArray:
    """Return the causal low-pass filter of a level, newest scan first; its sum is 1.

    Returns
    -------
    (5 (2^level - 1) + 1,) float64
    """
    low = np.array(pywt.Wavelet("coif1").dec_lo) / math.sqrt(2)
    cascade = np.ones(1)
    for j in range(level):
        dilated = np.zeros((len(low) - 1) * 2**j + 1)
        dilated[:: 2**j] = low
        cascade = np.convolve(cascade, dilated)
    return np.asarray(cascade / cascade.sum())


def longest_level(rate_hz: float) -> int:
    """Return the coarsest level whose delay is affordable at a scan rate."""
    level = 0
    while level < 5 and delay_scans(level + 1) <= _LONGEST_DELAY_S * rate_hz:
        level += 1
    return level


def level_for(relative_noise: float, rate_hz: float) -> int:
    """Return the finest level whose approximation has little noise, within the affordable delay.

    Parameters
    ----------
    relative_noise : float
        Noise of a taxel's shear in one scan, over its load.
    """
    for level in range(longest_level(rate_hz)):
        if relative_noise * noise_gain(level) <= _NOISE_WANTED:
            return level
    return longest_level(rate_hz)


@functools.cache
def noise_gain(level: int) -> float:
    """Return the factor by which an approximation reduces white noise."""
    return float(np.sqrt((approximation_taps(level) ** 2).sum()))


def own_channels(weights: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the few channels that make each response, and their weights.

    Parameters
    ----------
    weights : (kinds, taxels, channels) float64

    Returns
    -------
    (n, kinds, taxels) int64, (n, kinds, taxels) float64
        Indices and weights; a weight is 0 where a response has fewer channels.
    """
    n_most = max(1, int(np.count_nonzero(weights, axis=2).max()))
    own = np.argsort(weights == 0, axis=2, kind="stable")[..., :n_most]
    own_weights = np.take_along_axis(weights, own, axis=2)
    return (
        np.ascontiguousarray(own.transpose(2, 0, 1), dtype=np.int64),
        np.ascontiguousarray(own_weights.transpose(2, 0, 1)),
    )


class Responses:
    """Weights that make loads and shears of the taxels out of readings.

    `compiled_readings.c` does the same with the same bits, so that sums over channels run over a leading
    axis, where numpy adds one term after the other.

    Parameters
    ----------
    array : Array

    Attributes
    ----------
    weights : (3, taxels, channels) float64
        Load, shear along x and along y of each taxel. Shear is the force of the object on the skin, so that
        it opposes the motion of the skin.
    taxel_channels : (taxels, channels) bool
        True where a channel is part of a taxel's load or shear.
    """

    def __init__(self, array: Array) -> None:
        self.weights = np.concatenate([array.normal_weights()[np.newaxis], -array.shear_weights()])
        self.own, self.own_weights = own_channels(self.weights)
        self.taxel_channels = np.any(self.weights != 0, axis=0)
        self.senses_load = bool(np.any(self.weights[0] != 0))
        self.senses_shear = array.has_shear

    def of(self, volts: FloatArray) -> FloatArray:
        """Return load, shear x and shear y (3, taxels) of one scan (channels,)."""
        return np.asarray((self.own_weights * volts[self.own]).sum(axis=0))

    def noise(self, channel_sd: FloatArray) -> tuple[float, float, float]:
        """Return standard deviations of a taxel's shear, of the total shear and of the mean load."""
        n_taxels = self.own.shape[2]
        variances = ((self.own_weights * channel_sd[self.own]) ** 2).sum(axis=0)
        load, shear_x, shear_y = sums_in_order(variances).tolist()
        return (
            math.sqrt((shear_x + shear_y) / (2 * n_taxels)),
            math.sqrt((shear_x + shear_y) / 2),
            math.sqrt(load) / n_taxels,
        )


class NoiseFloor:
    """Standard deviation of each channel's noise, from the finest details of the wavelet bank.

    Parameters
    ----------
    n_channels : int
    volts_per_step : float
        Of the bank's grid: no noise is below it.
    """

    def __init__(self, n_channels: int, volts_per_step: float) -> None:
        self._mean_abs = np.zeros((FLOOR_LEVELS, n_channels))
        self._least = volts_per_step
        self._last = np.full(n_channels, np.nan)
        self._step = np.full(n_channels, np.inf)
        self._sd = np.full(n_channels, volts_per_step)
        self._n = 0

    def take(self, volts: FloatArray, details: FloatArray, rate_hz: float) -> None:
        """Take readings (channels,) and details (FLOOR_LEVELS, channels) of a scan whose filters are full."""
        self._n += 1
        part = 1.0 / min(self._n, max(2.0, _FLOOR_S * rate_hz))
        clip = _CLIP if self._n > _CLIPPED_AFTER else math.inf
        step = np.abs(volts - self._last)
        self._step[:] = np.minimum(np.where(step > 0, step, np.inf), self._step)
        self._last[:] = volts
        size = np.minimum(np.abs(details), clip * self._known_sd())
        self._mean_abs += part * (size - self._mean_abs)
        self._sd[:] = self._known_sd()

    def sd(self) -> FloatArray:
        """Return the noise (channels,) in volts.

        It is no less than the rounding of the converter, whose step is the smallest between two readings:
        at rest a coarse converter shows no noise, and in motion it shows its steps.
        """
        return self._sd.copy()

    def _known_sd(self) -> FloatArray:
        rounding = np.where(np.isfinite(self._step), self._step, 0.0) / _ROUNDING
        noise = self._mean_abs.max(axis=0) / _MEAN_ABS
        return np.asarray(np.maximum(np.sqrt(noise**2 + rounding**2), self._least))


def history_scans(rate_hz: float) -> int:
    """Return the number of scans that the coarsest affordable approximation needs."""
    return len(taps(longest_level(rate_hz))) if longest_level(rate_hz) else 1


def floor_numbers(rate_hz: float) -> FloatArray:
    """Return the constants of `NoiseFloor` in the order of `struct readings_numbers`."""
    return np.array([_MEAN_ABS, _ROUNDING, max(2.0, _FLOOR_S * rate_hz), _CLIP, _CLIPPED_AFTER])

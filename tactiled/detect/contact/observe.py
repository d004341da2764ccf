"""Loads and shears of the taxels from readings, and the noise of the readings.

The standard deviation of the noise is read off the detail coefficients of the two finest levels of the
stationary coif1 transform: all its filters have unit energy, so that white noise has the same standard
deviation in each (Mallat, A Wavelet Tour of Signal Processing, 3rd ed., 5.5).
"""

import math

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.ordered_sums import sums_in_order

FLOOR_LEVELS = 2
_HISTORY_S = 0.06  # in which what interpolation between channels leaves counts as noise: the length of a jerk
_FLOOR_S = 1.0  # averaging time of the noise
_CLIP = 3.0  # standard deviations: a coefficient beyond counts as this much, since it is signal
_CLIPPED_AFTER = 20  # scans: before, the mean is too uncertain to clip by
_ROUNDING = math.sqrt(12)  # rounding to steps of q has a standard deviation of q / sqrt(12)
_MEAN_ABS = math.sqrt(2 / math.pi)  # of a normal variable of unit variance


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
    """Return the number of scans of which readings are kept."""
    return max(1, round(_HISTORY_S * rate_hz))


def floor_numbers(rate_hz: float) -> FloatArray:
    """Return the constants of `NoiseFloor` in the order of `struct readings_numbers`."""
    return np.array([_MEAN_ABS, _ROUNDING, max(2.0, _FLOOR_S * rate_hz), _CLIP, _CLIPPED_AFTER])

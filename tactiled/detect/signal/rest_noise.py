"""Noise of readings at rest, from second differences in groups of scans.

Loads, creep and drift are straight lines over a few scans and leave second differences alone; contact and
sliding only add to the noise. The quietest group so far is therefore the noise at rest, whatever came first.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.signal.quantise import READING_BITS, HeldReadings

GROUP_SCANS = 16
_SECOND_DIFFERENCE = 6.0  # variance of v[k] - 2 v[k + 1] + v[k + 2] over that of v, for white noise
_UNKNOWN = 2.0**READING_BITS  # full scale, in steps: no reading stands out of that
_ROUNDING = 12.0  # variance of rounding to a step q is q^2 / 12


class RestNoise:
    """Standard deviation of each channel's noise in its quietest group of scans so far.

    It is no less than the rounding noise of the smallest step between two readings, and full scale until
    a group without missing readings is complete. The minimum over many groups of 16 scans is about half of
    the standard deviation.
    """

    def __init__(self, n_channels: int) -> None:
        self._steps = np.empty((0, n_channels))
        self._ok = np.empty((0, n_channels), dtype=np.bool_)
        self._least_power = np.full((1, n_channels), _UNKNOWN**2)
        self._least_step = np.full((1, n_channels), np.inf)

    def interrupt(self) -> None:
        """Begin a group anew after missing scans."""
        self._steps, self._ok = self._steps[:0], self._ok[:0]

    def process(self, held: HeldReadings) -> FloatArray:
        """Return the standard deviation (n, channels) in steps, as known at each scan, for any chunking."""
        n_left = len(self._steps)
        steps = np.concatenate([self._steps, held.steps])
        ok = np.concatenate([self._ok, held.ok])
        n_groups = len(steps) // GROUP_SCANS
        whole = n_groups * GROUP_SCANS
        groups = steps[:whole].reshape(n_groups, GROUP_SCANS, steps.shape[1])
        usable = ok[:whole].reshape(groups.shape).all(axis=1)
        change = np.diff(groups, axis=1)
        power = (np.diff(change, axis=1) ** 2).mean(axis=1) / _SECOND_DIFFERENCE
        step = np.where(change != 0, np.abs(change), np.inf).min(axis=1, initial=np.inf)
        self._steps, self._ok = steps[whole:], ok[whole:]
        powers = _running_least(self._least_power, np.where(usable, power, _UNKNOWN**2))
        smallest = _running_least(self._least_step, np.where(usable, step, np.inf))
        self._least_power, self._least_step = powers[-1:], smallest[-1:]
        rounding = np.where(np.isfinite(smallest), smallest, 0.0) ** 2 / _ROUNDING
        groups_known = (n_left + np.arange(1, len(held.steps) + 1)) // GROUP_SCANS
        return np.asarray(np.sqrt(np.maximum(powers, rounding))[groups_known])


def _running_least(before: FloatArray, values: FloatArray) -> FloatArray:
    """Return the least value (groups + 1, channels) before, and after each group."""
    return np.asarray(np.minimum.accumulate(np.concatenate([before, values]), axis=0))

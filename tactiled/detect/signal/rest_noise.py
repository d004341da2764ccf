"""Noise of readings at rest, from second differences in groups of scans.

Loads, creep and drift are straight lines over a few scans and leave second differences alone; contact and
sliding only add to the noise. The quietest group so far is therefore the noise at rest, whatever came first.
Before a channel has a whole group, its noise is taken to be that of the channels together, or its own so far
if that is more: a press moves few channels at a time, or all of them in few scans, which medians do not see.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.quantise import READING_BITS, HeldReadings

GROUP_SCANS = 16  # choice
_SECOND_DIFFERENCE = 6.0  # derived: variance of v[k] - 2 v[k + 1] + v[k + 2] over that of v, for white noise
_UNKNOWN = 2.0**READING_BITS  # derived: full scale, in steps: no reading stands out of that
_ROUNDING = 12.0  # derived: variance of rounding to a step q is q^2 / 12
_MEDIAN = 0.6745  # derived: of |x| of a normal variable of unit variance
# derived: second differences, of all channels, before their median counts: that of eight is less than a sixth
# of the true one once in 2,000 draws.
_FEWEST = 8


class RestNoise:
    """Standard deviation of each channel's noise in its quietest group of scans so far.

    It is no less than the rounding noise of the smallest step between two readings. The minimum over many
    groups of 16 scans is about half of the standard deviation. Until a channel has a group without missing
    readings it is that of the channels together, and full scale before that can be told.

    Parameters
    ----------
    early : float
        Least standard deviation in steps of a channel without a group.

    Attributes
    ----------
    n_known : int
        Channels that have a group, -1 while nothing can be told, at the newest scan.
    """

    def __init__(self, n_channels: int, early: float) -> None:
        self._steps = np.empty((0, n_channels))
        self._ok = np.empty((0, n_channels), dtype=np.bool_)
        self._least_power = np.full((1, n_channels), _UNKNOWN**2)
        self._least_step = np.full((1, n_channels), np.inf)
        self._early = early
        self._early_noise = np.full((1, n_channels), _UNKNOWN)
        self._is_early = True
        self.n_known = -1

    def interrupt(self) -> None:
        """Begin a group anew after missing scans."""
        self._steps, self._ok = self._steps[:0], self._ok[:0]

    def process(self, held: HeldReadings) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the standard deviation (n, channels) in steps, as known at each scan, for any chunking.

        And the scans (n,) at which more became known: what is below a level before may be above it then.
        """
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
        noise: FloatArray = np.sqrt(np.maximum(powers, rounding))[groups_known]
        early = np.repeat(self._early_noise, len(noise), axis=0)
        if self._is_early:
            for scan in range(n_left, min(len(steps), GROUP_SCANS)):
                early[scan - n_left :] = self._noise_of_few(steps[: scan + 1], ok[: scan + 1])
            self._early_noise = early[-1:]
            self._is_early = n_groups == 0
        has_own = noise < _UNKNOWN
        n_known = np.where((early < _UNKNOWN).any(axis=1), has_own.sum(axis=1), -1)
        becomes_known = np.diff(n_known, prepend=self.n_known) > 0
        self.n_known = int(n_known[-1])
        return np.where(has_own, noise, early), becomes_known

    def _noise_of_few(self, steps: FloatArray, ok: NDArray[np.bool_]) -> FloatArray:
        """Standard deviation (channels,) in steps, from the scans of an incomplete group."""
        bend = np.abs(np.diff(steps, n=2, axis=0))
        bend[~(ok[2:] & ok[1:-1] & ok[:-2])] = np.nan
        if np.isfinite(bend).sum() < _FEWEST:
            return np.full(steps.shape[1], _UNKNOWN)
        is_seen = np.isfinite(bend).any(axis=0)
        median = np.full(steps.shape[1], float(np.nanmedian(bend)))
        median[is_seen] = np.maximum(median[is_seen], np.nanmedian(bend[:, is_seen], axis=0))
        return np.maximum(median / (_MEDIAN * math.sqrt(_SECOND_DIFFERENCE)), self._early)


def _running_least(before: FloatArray, values: FloatArray) -> FloatArray:
    """Return the least value (groups + 1, channels) before, and after each group."""
    return np.asarray(np.minimum.accumulate(np.concatenate([before, values]), axis=0))

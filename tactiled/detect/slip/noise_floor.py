"""Noise floor of the response and of every channel, by octave, outside of slips.

A floor is the median size of a level's details over groups of 16 scans, smoothed in its logarithm: a slip,
a tap or a burst of interference in a group moves it by little, and a floor that changes 100-fold is
followed in some three seconds. For white noise the median size is 0.6745 standard deviations. While
something happens the floor is frozen, but no longer than `_LONGEST_FREEZE_S`: noise that grew and stays is
the new floor.
"""

import numpy as np

from tactiled.array import FloatArray

GROUP_SCANS = 16
_WEIGHT = 0.1  # of the newest group: a time constant of 1.6 s at 100 Hz
_LONGEST_FREEZE_S = 2.0
_MEDIAN_OF_NORMAL = 0.6745
# Steps of the grid (0.95 uV of 8 V) below which no floor goes: below a tenth of the last bit of a 12-bit
# ADC a silent converter hides what noise there is.
_LEAST_STEPS = 64.0


def median(values: FloatArray) -> float:
    """Return the median of numbers (n,), as `np.median` does in five times the time."""
    n = len(values)
    middle = np.sort(values)[(n - 1) // 2 : n // 2 + 1]
    return float(middle.sum() / len(middle))


class GroupedNoiseFloor:
    """Standard deviation that white noise with a level's details would have: (levels, columns).

    Parameters
    ----------
    levels, columns : int
    rate_hz : float

    Attributes
    ----------
    sd : (levels, columns) float64
    newest : (levels, columns) float64
        Standard deviation from the newest group alone.
    """

    def __init__(self, levels: int, columns: int, rate_hz: float) -> None:
        self._details = np.zeros((GROUP_SCANS, levels, columns))
        self._freeze_groups = max(1, round(_LONGEST_FREEZE_S * rate_hz / GROUP_SCANS))
        self._log = np.full((levels, columns), np.log(_LEAST_STEPS))
        self._n_groups = 0
        self._n_frozen = 0
        self._n_rows = 0
        self._disturbed = False
        self._set()
        self.newest = self.sd

    @property
    def n_to_group(self) -> int:
        """Scans until the group is complete."""
        return GROUP_SCANS - self._n_rows

    def add(self, common: FloatArray, channels: FloatArray, disturbed: bool) -> bool:
        """Add scans, at most `n_to_group` of them; return True if the group is complete.

        Parameters
        ----------
        common : (n, first columns, levels) float64
            Details of the first columns.
        channels : (n, levels, other columns) float64
            Those of the others.
        disturbed : bool
        """
        n, n_common = common.shape[:2]
        rows = self._details[self._n_rows : self._n_rows + n]
        rows[..., :n_common] = common.swapaxes(1, 2)
        rows[..., n_common:] = channels
        self._n_rows += n
        self._disturbed |= disturbed
        if self._n_rows < GROUP_SCANS:
            return False
        disturbed, self._disturbed, self._n_rows = self._disturbed, False, 0
        self._n_frozen = self._n_frozen + 1 if disturbed else 0
        middle = np.sort(np.abs(self._details), axis=0)[GROUP_SCANS // 2 - 1 : GROUP_SCANS // 2 + 1]
        median = middle.mean(axis=0) / _MEDIAN_OF_NORMAL
        self.newest = np.maximum(median, _LEAST_STEPS)
        if 0 < self._n_frozen <= self._freeze_groups and self._n_groups:
            return True
        self._n_groups += 1
        weight = max(_WEIGHT, 1 / self._n_groups)
        self._log += weight * (np.log(self.newest) - self._log)
        self._set()
        return True

    def scale(self, by: FloatArray, columns: slice = slice(None)) -> None:
        """Multiply the floors (levels, columns), as for a change of the taxel set."""
        self._log[:, columns] = np.maximum(self._log[:, columns] + np.log(by), np.log(_LEAST_STEPS))
        self._set()

    def _set(self) -> None:
        self.sd = np.exp(np.maximum(self._log, self._log[0]))

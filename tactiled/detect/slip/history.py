"""History of the response, to find the onset of growth that began before the filters' window."""

from collections import deque
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip.filters import N_BASELINE
from tactiled.detect.slip.kink import KinkEstimate, find_kink
from tactiled.detect.slip.response import COLUMNS, PRESSURE, motion

_KEPT_S = 16.0  # the slowest creep into slip takes 12 s
_EACH_S = 0.08  # that one mean is of: a sixteenth of the longest ramp
_BEGUN = 0.0038  # shear over pressure that anyone would call growing: friction of 0.2 % of the load
# Times the ramp that shows it best: a pull that swells began so long before. The longest ramp shows whatever
# is longer than all.
_LONGEST = 4
_LEVEL_SCANS = 8  # before the earliest instant that is tried
_LEAST_NOISE = 0.5  # steps: readings are whole


class _ResponseMean(NamedTuple):
    newest: int  # scan
    row: FloatArray  # (7,)


class ResponseHistory:
    """Response since the contact began, as means over some scans each.

    Parameters
    ----------
    rate_hz : float
    longest_ramp : int
        Scans of the longest that evidence is looked for along.
    """

    def __init__(self, rate_hz: float, longest_ramp: int) -> None:
        self._longest_ramp = longest_ramp
        self._each = max(1, round(_EACH_S * rate_hz))
        self._means: deque[_ResponseMean] = deque(maxlen=round(_KEPT_S * rate_hz / self._each))
        self._n_taken = 0
        self._sum, self._n = np.zeros(COLUMNS), 0

    def forget(self) -> None:
        """Clear the history."""
        self._means.clear()
        if self._n:
            self._sum, self._n = np.zeros(COLUMNS), 0

    def shift(self, jump: FloatArray) -> None:
        """Correct the history for a change of the taxel set, by which the response jumps by (7,)."""
        if not jump.any():
            return
        self._sum = self._sum + self._n * jump
        for k, mean in enumerate(self._means):
            self._means[k] = mean._replace(row=mean.row + jump)

    def take(self, rows: FloatArray) -> None:
        """Add the responses (n, 7) of scans; sums of whole numbers, exact in any order."""
        done = 0
        while done < len(rows):
            n = min(len(rows) - done, self._each - self._n)
            self._sum = self._sum + rows[done : done + n].sum(axis=0)
            self._n += n
            self._n_taken += n
            done += n
            if self._n == self._each:
                self._means.append(_ResponseMean(self._n_taken, self._sum / self._n))
                self._sum, self._n = np.zeros(COLUMNS), 0

    def at(self, seen: FloatArray, scans: float) -> FloatArray:
        """Return the response (7,) `scans` ago, or the oldest that is kept."""
        ago = round(scans)
        if ago < len(seen) or not self._means:
            return np.asarray(seen[-1 - min(ago, len(seen) - 1)])
        return min(self._means, key=lambda mean: abs(self._n_taken - mean.newest - ago)).row

    def began(self, seen: FloatArray, ramp: int, known: int, along: FloatArray, noise: float) -> KinkEstimate:
        """Estimate the onset of a growth.

        Parameters
        ----------
        seen : (window, 7) float64
            Responses, newest last; all were taken.
        ramp : int
            Scans of the ramp that shows the growth best.
        known : int
            Scans that may have to do with it.
        along : (3,) float64
            Unit vector of the growth.
        noise : float
            Standard deviation of a response along it.
        """
        longest = known if ramp == self._longest_ramp else _LONGEST * ramp
        n = min(longest + max(N_BASELINE, ramp), known)
        noise = max(noise, _LEAST_NOISE)
        recent = motion(seen[-min(n, len(seen)) :])
        ages = self._n_taken - np.array([mean.newest for mean in self._means], dtype=np.int64)
        older = (ages >= len(recent)) & (ages <= n - self._each)
        means = motion(np.array([mean.row for mean in self._means]).reshape(-1, COLUMNS))[older]
        ago = np.concatenate([ages[older] + (self._each - 1) / 2, np.arange(len(recent) - 1.0, -1.0, -1.0)])
        sd = np.repeat([noise / np.sqrt(self._each), noise], [len(means), len(recent)])
        series = np.concatenate([means, recent]) @ along
        least = _BEGUN * float(seen[-1, PRESSURE])
        return find_kink(ago, series, sd, min(float(longest), ago[0] - _LEVEL_SCANS), least)

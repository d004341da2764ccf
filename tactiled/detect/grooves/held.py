"""Scans held for the joint fit: a sliding window that is contiguous in memory, so that fits take views."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.samples.block import ScanBlock


class Held:
    """The newest scans, up to a number of them, in order.

    Parameters
    ----------
    size : int
    n_channels : int
    """

    def __init__(self, size: int, n_channels: int) -> None:
        self.size = size
        self._end = 0
        self._volts = np.empty((2 * size, n_channels))
        self._good = np.empty((2 * size, n_channels), dtype=np.bool_)
        self._time_s = np.empty(2 * size)
        self._speeds_mm_s = np.empty(2 * size)

    def append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        """Take scans in, with which readings to go by (n, channels) and the speed at each (n,)."""
        for first in range(0, len(block), self.size):
            self._append(block[first : first + self.size], good[first:], speeds_mm_s[first:])

    def _append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        n = len(block)
        if self._end + n > 2 * self.size:
            kept = slice(max(0, self._end - self.size), self._end)
            self._end = kept.stop - kept.start
            for store in (self._volts, self._good, self._time_s, self._speeds_mm_s):
                store[: self._end] = store[kept].copy()
        rows = slice(self._end, self._end + n)
        self._volts[rows], self._good[rows] = block.volts, good[:n]
        self._time_s[rows], self._speeds_mm_s[rows] = block.time_s, speeds_mm_s[:n]
        self._end += n

    def __len__(self) -> int:
        return min(self._end, self.size)

    @property
    def _rows(self) -> slice:
        return slice(max(0, self._end - self.size), self._end)

    @property
    def sign(self) -> float:
        """Of the newest speed: 1 forward, -1 backward, 0 not known."""
        return float(np.sign(self._speeds_mm_s[self._end - 1])) if self._end else 0.0

    @property
    def volts(self) -> FloatArray:
        return self._volts[self._rows]

    @property
    def good(self) -> NDArray[np.bool_]:
        return self._good[self._rows]

    @property
    def time_s(self) -> FloatArray:
        return self._time_s[self._rows]

    @property
    def speeds_mm_s(self) -> FloatArray:
        return self._speeds_mm_s[self._rows]

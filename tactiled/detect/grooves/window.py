"""Scans of a sliding window, kept while they come and handed to a fit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion
from tactiled.detect.grooves.params import WaveParams
from tactiled.samples.block import ScanBlock

# prior: part of a channel's readings. A channel with more bad ones is left out of a fit.
_MOST_BAD_PART = 0.05
# derived: no converter reads more. Fourth powers of it, and of its noise, are finite numbers.
_MOST_VOLTS = 1e9


class ScanWindow:
    """The newest scans, up to a number that can grow, contiguous in memory so that fits take views.

    Parameters
    ----------
    size : int
        Scans at most.
    most : int, optional
        Scans that are kept for `widen`; `size` if not given.
    """

    def __init__(self, size: int, n_channels: int, most: int | None = None) -> None:
        self.size = size
        self._most = most = max(size, most or 0)
        self._end = 0
        self._volts = np.empty((2 * most, n_channels))
        self._good = np.empty((2 * most, n_channels), dtype=np.bool_)
        self._time_s = np.empty(2 * most)
        self._speeds_mm_s = np.empty(2 * most)

    def widen(self) -> None:
        """Double the number of scans, up to the most."""
        self.size = min(2 * self.size, self._most)

    def append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        """Append scans, with the usable readings (n, channels) and the speed at each scan (n,)."""
        for first in range(0, len(block), self._most):
            self._append(block[first : first + self._most], good[first:], speeds_mm_s[first:])

    def _append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        n = len(block)
        if self._end + n > 2 * self._most:
            kept = slice(max(0, self._end - self._most), self._end)
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
        """Sign of the newest speed: 1 forward, -1 backward, 0 unknown."""
        return float(np.sign(self._speeds_mm_s[self._end - 1])) if self._end else 0.0

    @property
    def speed_mm_s(self) -> float:
        """Mean of the speeds that were set, without a sign; 0 where there are no scans."""
        return float(np.abs(self._speeds_mm_s[self._rows]).mean()) if self._end else 0.0

    def for_fit(
        self, channel_offset_s: FloatArray, layout: ChannelLayout, motion: WaveMotion, params: WaveParams
    ) -> "FitWindow":
        """Copy the scans for a fit, which may run while others come."""
        rows = self._rows
        return FitWindow(
            self._volts[rows].copy(),
            self._time_s[rows].copy(),
            channel_offset_s,
            layout,
            motion,
            params,
            self._good[rows].copy(),
            np.abs(self._speeds_mm_s[rows]),
        )


@dataclass(frozen=True, eq=False)
class FitWindow:
    """Input of a fit: the scans of one window, and what is known of array, motion and grooves.

    Attributes
    ----------
    volts : (n, channels) float64
    time_s : (n,) float64
        Instants at which scans began, evenly spaced or nearly so.
    channel_offset_s : (channels,) float64
        Delay from the beginning of a scan to the sampling of each channel.
    usable : (n, channels) bool, optional
        False for readings to ignore; by default those that are not finite.
    speeds_mm_s : (n,) float64, optional
        Speed from each scan to the next where it is known and not constant; `motion` then holds the mean.
    """

    volts: FloatArray
    time_s: FloatArray
    channel_offset_s: FloatArray
    layout: ChannelLayout
    motion: WaveMotion
    params: WaveParams
    usable: NDArray[np.bool_] | None = None
    speeds_mm_s: FloatArray | None = None

    @property
    def duration_s(self) -> float:
        """Time from the first scan to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    def good_readings(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """Readings (n, good channels) with the few bad ones interpolated linearly, and the good channels."""
        usable = np.abs(self.volts) <= _MOST_VOLTS
        if self.usable is not None:
            usable &= self.usable
        chosen = np.flatnonzero(usable.mean(axis=0) >= 1 - _MOST_BAD_PART)
        volts, usable = np.take(self.volts, chosen, axis=1), usable[:, chosen]
        scans = np.arange(len(volts))
        for c in np.flatnonzero(~usable.all(axis=0)):
            good = usable[:, c]
            volts[~good, c] = np.interp(scans[~good], scans[good], volts[good, c])
        return volts, chosen

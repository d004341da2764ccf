"""Scans of a sliding window, kept while they come and handed to a fit; and the fits of one slide."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion
from tactiled.detect.grooves.outcome import FitSpan, Outcome, PeriodOnly, Refusal
from tactiled.detect.grooves.params import AnswerCriteria, WaveParams
from tactiled.detect.signal.slip_gate import SlipEnd
from tactiled.detect.worker import Job
from tactiled.samples.block import ScanBlock

# prior: part of a channel's readings. A channel with more bad ones is left out of a fit.
_MOST_BAD_PART = 0.05
# derived: no converter reads more. Fourth powers of it, and of its noise, are finite numbers.
_MOST_VOLTS = 1e9


class ScanWindow:
    """The newest scans, up to a number that can grow, contiguous in memory so that fits take views.

    Parameters
    ----------
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
    """Input of a fit: the scans of one window, and what is known of array, motion and grooves."""

    volts: FloatArray  # (n, channels)
    time_s: FloatArray  # (n,): instants at which scans began, evenly spaced or nearly so
    # (channels,): delay from the beginning of a scan to the sampling of each channel
    channel_offset_s: FloatArray
    layout: ChannelLayout
    motion: WaveMotion
    params: WaveParams
    # (n, channels): False for readings to ignore; by default those that are not finite
    usable: NDArray[np.bool_] | None = None
    # (n,): speed from each scan to the next where it is known and not constant; `motion` then holds the mean
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


# derived: in the window: a line at the place of the newest one before it. Chance lines come at any place.
_SAME_LINE_PERIODS = 0.5


class SlideWindow:
    """Scans of one slip in one direction, and what was answered of them."""

    def __init__(self, n_scans: int, n_channels: int, most: int) -> None:
        self.scans = ScanWindow(n_scans, n_channels, most)
        self.n_scans = 0
        self.n_next_fit = 0
        self.n_pending = 0
        self.has_answer = False
        self.is_over = False
        self.last: Outcome = Refusal("no-slip")
        self.line_hz = 0.0
        self.end: SlipEnd | None = None

    def append(self, block: ScanBlock, speeds_mm_s: FloatArray, full_scale_volts: float) -> None:
        """Append scans; readings beyond the converter's range are not used."""
        good = block.valid & (np.abs(block.volts) <= full_scale_volts)
        self.scans.append(block, good, speeds_mm_s)
        self.n_scans += len(block)

    def span(self, end_s: float, rate_hz: float) -> FitSpan:
        """Describe the scans in the window."""
        return FitSpan(end_s, len(self.scans) / rate_hz, self.scans.speed_mm_s)


@dataclass(frozen=True, eq=False)
class PendingFit:
    """A fit that was handed over."""

    job: Job[Outcome]
    due_index: int  # scan at which the answer is reported
    window: SlideWindow
    span: FitSpan
    is_full: bool  # True where the window had its full length
    is_refusal_due: bool  # True where a refusal is reported also without an answer before it

    def is_reported(self, fit: Outcome, criteria: AnswerCriteria) -> bool:
        """Return True for an answer that is good enough, and for a refusal that is due."""
        if isinstance(fit, PeriodOnly):
            before_hz, self.window.line_hz = self.window.line_hz, fit.frequency_hz
            return abs(fit.frequency_hz - before_hz) * self.span.window_s < _SAME_LINE_PERIODS
        if isinstance(fit, Refusal):
            return self.window.has_answer or self.is_refusal_due
        is_good = (
            fit.period_sd_mm <= criteria.period_sd_mm
            and fit.angle_sd_deg <= criteria.angle_sd_deg
            and fit.frequency_hz * self.span.window_s >= criteria.answer_periods
        )
        return is_good or self.is_full or self.window.has_answer

"""Rows that repeat the row before, in logs that are faster than their sensor.

A host that polls writes the newest reading again until the sensor has another. Such rows are no scans: the
noise looks smaller than it is, changes look like steps, and a ripple looks faster than the sensor can follow.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_FEWEST = 20  # changes, by which the rate of the sensor is known
# Quantile of the rows from change to change, which is 1 where the sensor is as fast as the log: coarse
# readings at rest repeat often, but change from row to row under a press. One reading in twenty may be early.
_LEAST = 0.05
# Smallest steps of its channels by which a scan of a noisy sensor differs from the one before, in three of
# four: readings that creep over one step after the other change as regularly, and are scans.
_STEPS, _FEW_STEPS = 2.0, 0.25
_REGULAR = 0.5  # of the median, which it reaches in a log that polls: changes by chance come at any distance
LATE = 1.5  # periods after which a reading that stays counts anew, as the host may poll late


def rows_of_a_reading(readings: FloatArray) -> int:
    """Return the rows for which the sensor's reading stays, the median; 1 of a sensor as fast as its log.

    Parameters
    ----------
    readings : (n, channels) float64
        NaN where one is missing.
    """
    held = _held(readings, readings[0])
    moved = np.abs(np.diff(held, axis=0))
    is_change = _changes(readings, held)
    rows = np.diff(np.flatnonzero(is_change))
    if len(rows) < _FEWEST:
        return 1
    smallest = np.where(moved > 0, moved, np.inf).min(axis=0)
    steps = (moved[is_change] / smallest).sum(axis=1)
    if np.quantile(steps, _FEW_STEPS) <= _STEPS:
        return 1
    median, least = float(np.median(rows)), float(np.quantile(rows, _LEAST, method="lower"))
    return round(median) if least > 1 and least >= _REGULAR * median else 1


class RepeatFilter:
    """Find the scans of a log among the rows that repeat them, batch by batch.

    A reading that stays for longer than a period of the sensor is one scan a period: nothing moves.
    """

    def __init__(self, period_rows: int) -> None:
        self._period_rows = period_rows
        self._longest = round(LATE * period_rows)
        self._last: tuple[FloatArray, FloatArray] | None = None  # row, and with older ones for missing ones
        self._age = 0

    def take(self, readings: FloatArray) -> NDArray[np.bool_]:
        """Return which of the rows (n,) are scans."""
        if self._period_rows == 1 or not len(readings):
            return np.ones(len(readings), dtype=np.bool_)
        if self._last is None:
            self._last = readings[:1], np.nan_to_num(readings[:1])
            self._age = self._longest  # the first row is a scan
        last, last_held = self._last
        rows = np.vstack([last, readings])
        held = np.vstack([last_held, _held(readings, last_held[0])])
        is_scan = _changes(rows, held)
        self._last = rows[-1:].copy(), held[-1:].copy()
        for row, changes in enumerate(is_scan.tolist()):
            self._age += 1
            if changes or self._age > self._longest:
                is_scan[row] = True
                self._age = 0 if changes else self._age - self._period_rows
        return is_scan


def _changes(rows: FloatArray, held: FloatArray) -> NDArray[np.bool_]:
    """Return which rows (n - 1,) differ from the one before, of rows (n, channels) as read and as held.

    A reading that is missing in one of two rows tells nothing, unless no channel is read in both.
    """
    is_pair = np.isfinite(rows[1:]) & np.isfinite(rows[:-1])
    moves = held[1:] != held[:-1]
    return np.asarray((moves & is_pair).any(axis=1) | (moves.any(axis=1) & ~is_pair.any(axis=1)))


def _held(readings: FloatArray, before: FloatArray) -> FloatArray:
    """Return the readings (n, channels) with the last one, `before` at first, in place of missing ones.

    A channel that never had one reads 0.
    """
    rows = np.vstack([before, readings])
    newest = np.maximum.accumulate(np.where(np.isnan(rows), 0, np.arange(len(rows))[:, np.newaxis]), axis=0)
    return np.nan_to_num(np.take_along_axis(rows, newest, axis=0)[1:])

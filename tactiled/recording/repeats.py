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
_REGULAR = 0.5  # of the median, which it reaches in a log that polls: changes by chance come at any distance
LATE = 1.5  # periods after which a reading that stays counts anew, as the host may poll late


def rows_of_a_reading(readings: FloatArray) -> int:
    """Return the rows for which the sensor's reading stays, the median; 1 of a sensor as fast as its log.

    Parameters
    ----------
    readings : (n, channels) float64
        NaN where one is missing.
    """
    rows = np.diff(np.flatnonzero(_changes(readings[1:], readings[:-1])))
    if len(rows) < _FEWEST:
        return 1
    median, least = float(np.median(rows)), float(np.quantile(rows, _LEAST, method="lower"))
    return round(median) if least > 1 and least >= _REGULAR * median else 1


class RepeatFilter:
    """Find the scans of a log among the rows that repeat them, batch by batch.

    A reading that stays for longer than a period of the sensor is one scan a period: nothing moves.

    Parameters
    ----------
    period_rows : int
        Of the sensor, see `rows_of_a_reading`.
    """

    def __init__(self, period_rows: int) -> None:
        self._period_rows = period_rows
        self._longest = round(LATE * period_rows)
        self._last: FloatArray | None = None
        self._age = 0

    def take(self, readings: FloatArray) -> NDArray[np.bool_]:
        """Return which of the rows (n,) are scans."""
        if self._period_rows == 1 or not len(readings):
            return np.ones(len(readings), dtype=np.bool_)
        before = readings[:1] if self._last is None else self._last
        is_scan = _changes(readings, np.concatenate([before, readings[:-1]]))
        if self._last is None:
            is_scan[0] = True
        self._last = readings[-1:].copy()
        for row, changes in enumerate(is_scan.tolist()):
            self._age += 1
            if changes or self._age > self._longest:
                is_scan[row] = True
                self._age = 0 if changes else self._age - self._period_rows
        return is_scan


def _changes(readings: FloatArray, before: FloatArray) -> NDArray[np.bool_]:
    """Return the rows (n,) that differ from those before; what is missing in both is the same."""
    is_same = (readings == before) | (np.isnan(readings) & np.isnan(before))
    return np.asarray(~is_same.all(axis=1))

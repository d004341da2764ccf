"""Motion of the hand that a controller announces, as a course of accelerations by instant."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from typing import Any

import numpy as np

from tactiled.array import FloatArray
from tactiled.errors import DataError

# choice: a value holds so long after its instant: ten steps of a sender at 100 Hz, so that a few late
# commands leave no hole, and one step of a sender at 10 Hz, the slowest that is served.
HOLD_S = 0.1
_KEPT = 2048  # choice: values: two seconds at 1000 Hz, one of them announced ahead


class AnnouncedMotion:
    """Acceleration of the hand minus that of gravity, against the object's pull, as it was announced.

    Each value holds from its instant until the next one, for `HOLD_S` at most. An announcement replaces what
    was announced before for its first instant and later ones: a controller may announce its plan and change
    it.

    Examples
    --------
    >>> motion = AnnouncedMotion()
    >>> motion.announce(np.array([1.00, 1.01]), np.array([9.81, 12.0]))
    >>> [motion.at(time_s) for time_s in (0.99, 1.005, 1.05, 1.2)]
    [nan, 9.81, 12.0, nan]
    """

    def __init__(self) -> None:
        self._time_s: list[float] = []  # never decreasing
        self._acceleration_m_s2: list[float] = []

    def announce(self, time_s: FloatArray, acceleration_m_s2: FloatArray) -> None:
        """Add values; the newest `_KEPT` are kept.

        Parameters
        ----------
        time_s : (n,) float64
            Instants in the clock of the scans, finite, never decreasing; at least one.
        acceleration_m_s2 : (n,) float64
            Finite.
        """
        kept = bisect_left(self._time_s, float(time_s[0]))
        self._time_s[kept:] = time_s.tolist()
        self._acceleration_m_s2[kept:] = acceleration_m_s2.tolist()
        surplus = max(0, len(self._time_s) - _KEPT)
        del self._time_s[:surplus], self._acceleration_m_s2[:surplus]

    def at(self, time_s: float) -> float:
        """Return the acceleration at an instant, in m/s^2; NaN where nothing is announced for it."""
        n_before = bisect_right(self._time_s, time_s)
        if n_before == 0 or time_s - self._time_s[n_before - 1] > HOLD_S:
            return math.nan
        return self._acceleration_m_s2[n_before - 1]


def course_of(arguments: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return the course of the command ``motion`` of the daemon or of a recording, as `announce` takes it.

    Raises
    ------
    DataError
        The lists are no course: a recording may come from another program.
    """
    try:
        time_s = np.array(arguments["time_s"], dtype=np.float64)
        acceleration_m_s2 = np.array(arguments["acceleration_m_s2"], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise DataError("motion: time_s and acceleration_m_s2 are not two lists of numbers") from None
    is_course = time_s.ndim == 1 and time_s.size > 0 and time_s.shape == acceleration_m_s2.shape
    if not is_course or not np.isfinite(time_s + acceleration_m_s2).all() or (np.diff(time_s) < 0).any():
        raise DataError("motion: time_s and acceleration_m_s2 are not a course of finite values in order")
    return time_s, acceleration_m_s2

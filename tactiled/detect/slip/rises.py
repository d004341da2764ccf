"""Test of single rises: which ramps at which scans may count as evidence of slip.

These are the tests "size" and "opposed" of `slip.evidence`, which need nothing but the rise and the response.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.slip.response import AXES, UNEQUAL_SHEAR

# Resistors of a hand-made array are 5 % unequal; one taxel alone then leaks 0.07 of the pressure, and a
# tilting load leaks more than an even one.
_LEAKED_PART = 0.25
# A rise during which pressure doubles is a press; where it is oblique, shear grows with it without slip.
_PRESS = 0.5
_LEAST_NEW_PART = (
    0.2  # a load that has grown slowly, over more than the longest ramp, still grows by so much of it
)


class RiseTest:
    """Find the rises that may count as evidence.

    Parameters
    ----------
    least_shear : float
        Shear over pressure that counts.

    Attributes
    ----------
    constants : tuple of float
        Least shear and the constants of this module, for `compiled.c`.
    """

    def __init__(self, least_shear: float) -> None:
        self._least = least_shear
        self.constants = (least_shear, UNEQUAL_SHEAR, _LEAKED_PART, _LEAST_NEW_PART, _PRESS)

    def fits(self, rises: FloatArray, now: FloatArray) -> NDArray[np.bool_]:
        """Return (n, ramps), from rises (n, 4, ramps) of axes and pressure, and these now (n, 4)."""
        rise = rises[:, :AXES]
        pressure = np.maximum(now[:, AXES:], 1.0)
        start = now[:, :AXES, np.newaxis] - rise
        size, there = length(rise), length(start)
        along = (start * rise).sum(axis=1) / np.maximum(size * there, 1.0)  # cosine
        is_back = (along < -0.5) & (there > self._least * pressure)
        reached = size + np.where(along > 0.5, np.maximum(there - UNEQUAL_SHEAR * pressure, 0.0), 0.0)
        leak = _LEAKED_PART + there / np.maximum(pressure - rises[:, AXES], 1.0)
        return np.asarray(
            (reached >= self._least * pressure * np.where(is_back, 2.0, 1.0))
            & (size >= _LEAST_NEW_PART * self._least * pressure)
            & (size >= leak * np.abs(rises[:, AXES]))
            & (rises[:, AXES] <= _PRESS * pressure)
        )


def length(axes: FloatArray) -> FloatArray:
    """Return the length of vectors (n, 3, ramps)."""
    return np.asarray(np.sqrt((axes**2).sum(axis=1)))

"""Rows of the newest scans in one dense array, so that windows over them are views."""

import numpy as np

from tactiled.array import FloatArray

# choice: times the rows that are added at once: the kept rows move to the front once in so many calls
_SPARE = 2


class RollingRows:
    """Keep the rows of the newest scans.

    Views that `append` and `newest` return are good until the next `append`.

    Parameters
    ----------
    n_kept : int
        Rows that are kept when others are added; at first they are zero.
    shape : tuple of int
        Shape of a row.
    n_most : int
        Rows that are added at once, at most.
    """

    def __init__(self, n_kept: int, shape: tuple[int, ...], n_most: int) -> None:
        self._rows = np.zeros((n_kept + _SPARE * n_most, *shape))
        self._n_kept = n_kept
        self._end = n_kept

    def append(self, n: int) -> FloatArray:
        """Add n rows, and return them (n, ...) to be filled."""
        if self._end + n > len(self._rows):
            self._rows[: self._n_kept] = self._rows[self._end - self._n_kept : self._end].copy()
            self._end = self._n_kept
        self._end += n
        return self._rows[self._end - n : self._end]

    def newest(self, n: int) -> FloatArray:
        """Return the newest n rows."""
        return self._rows[self._end - n : self._end]

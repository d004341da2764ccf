"""Medians of short rows.

``np.median`` loads `numpy.ma` at its first call, which takes 15 ms in the middle of a slide where nothing has
loaded it yet; a sort takes a tenth of the time of the later calls.
"""

import numpy as np

from tactiled.array import FloatArray


def median(values: FloatArray) -> FloatArray:
    """Return the median of each row, along the last axis."""
    ordered, half = np.sort(values, axis=-1), values.shape[-1] // 2
    return np.asarray((ordered[..., half] + ordered[..., -1 - half]) / 2)

"""Sums whose terms are added one after the other, as C adds them: numpy's order depends on the processor."""

import numpy as np

from tactiled.array import FloatArray


def sum_in_order(values: FloatArray) -> float:
    """Return the sum of the values (n,)."""
    return float(np.add.accumulate(values)[-1])


def sums_in_order(values: FloatArray) -> FloatArray:
    """Return sums (...,) over the last axis of values (..., n)."""
    return np.asarray(np.add.accumulate(values, axis=-1)[..., -1])

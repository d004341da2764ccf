"""Exponentials and powers of the C library, and sums in order, as `compiled_grip.c` has them.

numpy has its own exponentials, whose last bits differ from those of the C library and between processors, and
adds the entries of a vector in an order of its own.
"""

import math

import numpy as np

from tactiled.array import FloatArray


def exp(values: FloatArray) -> FloatArray:
    """Return e to the power of each value (n,), at most 700."""
    return np.array([math.exp(value) for value in values.tolist()])


def expm1(values: FloatArray) -> FloatArray:
    """Return e to the power of each value (n,), at most 700, less one."""
    return np.array([math.expm1(value) for value in values.tolist()])


def log(values: FloatArray) -> FloatArray:
    """Return the natural logarithm of each value (n,), all above 0."""
    return np.array([math.log(value) for value in values.tolist()])


def power(values: FloatArray, exponent: float) -> FloatArray:
    """Return a power of each value (n,), which is not negative."""
    return np.array([math.pow(value, exponent) for value in values.tolist()])


def sum_in_order(values: FloatArray) -> float:
    """Return the sum of the values (n,), added one after the other."""
    return float(np.add.accumulate(values)[-1])

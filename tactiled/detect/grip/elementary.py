"""Exponentials and powers of the C library, and sums in order, as `compiled_grip.c` has them.

numpy has its own exponentials, whose last bits differ from those of the C library and between processors, and
adds the entries of a vector in an order of its own.
"""

import math
from collections.abc import Callable

import numpy as np

from tactiled.array import FloatArray


def exp(values: FloatArray) -> FloatArray:
    """Return e to the power of each value, at most 700."""
    return _each(math.exp, values)


def expm1(values: FloatArray) -> FloatArray:
    """Return e to the power of each value, at most 700, less one."""
    return _each(math.expm1, values)


def log(values: FloatArray) -> FloatArray:
    """Return the natural logarithm of each value, all above 0."""
    return _each(math.log, values)


def cbrt(values: FloatArray) -> FloatArray:
    """Return the cubic root of each value."""
    return _each(math.cbrt, values)


def power(values: FloatArray, exponent: float) -> FloatArray:
    """Return a power of each value, none below 0."""
    return _each(lambda value: math.pow(value, exponent), values)


def sum_in_order(values: FloatArray) -> float:
    """Return the sum of the values (n,), added one after the other."""
    return float(np.add.accumulate(values)[-1])


def sums_in_order(values: FloatArray) -> FloatArray:
    """Return sums (...,) over the last axis of values (..., n), added one after the other."""
    return np.asarray(np.add.accumulate(values, axis=-1)[..., -1])


def length(vector: FloatArray) -> float:
    """Return the length of a vector (3,)."""
    x, y, z = vector.tolist()
    return math.sqrt(x * x + y * y + z * z)


def _each(function: Callable[[float], float], values: FloatArray) -> FloatArray:
    return np.array([function(value) for value in values.ravel().tolist()]).reshape(values.shape)

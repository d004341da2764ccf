"""Special functions that the detectors need, on numpy and the standard library alone.

`scipy.special` and `numpy.polynomial` have them all, for 26 MB of resident memory and 0.6 s of start.
Formulas by number are those of the NIST Digital Library of Mathematical Functions (DLMF).

Quantiles solve ``log(tail(x)) = log(chance)`` by Newton's method in log(x). The density of log(x) is
log-concave for the gamma distribution and for Student's t, so this function is concave and falls: after its
first step, the iteration approaches the solution from above.
"""

import functools
import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np

from tactiled.array import FloatArray

_PRECISION = 1e-15  # relative size of the terms at which series and fractions end
_LAST_STEP = 1e-10  # of Newton's method in log(x): the error that a step leaves is of the order of its square
_MOST_TERMS = 10_000  # of a series or fraction: these need a few times the square root of the larger argument
_MOST_STEPS = 100  # of Newton's method, which needs ten
_DEGREES = np.arange(20.0)[:, np.newaxis]  # of an interpolation: 1e-11 for shapes up to 1000
_TINY = 1e-300  # in place of a zero divisor in Lentz's method


@functools.lru_cache(maxsize=4096)
def gamma_quantile(shape: float, chance: float) -> float:
    """Value that a gamma variable of a shape and scale 1 exceeds with a chance: inverse of DLMF 8.2.4."""
    log_norm = math.lgamma(shape)

    def tail(x: float) -> tuple[float, float]:
        log_part = shape * math.log(x) - x - log_norm
        return _log_gamma_tail(shape, x, log_part), log_part

    return _solved(tail, shape + 1, chance)


def gamma_quantiles(shapes: FloatArray, largest: float, chance: float) -> FloatArray:
    """Quantiles as of `gamma_quantile` for many shapes from 1 to `largest`, to a relative 1e-11.

    Interpolated in the logarithms of both between Chebyshev points (Trefethen, "Approximation Theory and
    Approximation Practice", SIAM 2013, ch. 2 to 4).
    """
    span = math.log(max(largest, 2.0))
    turned = np.arccos(np.clip(2 * np.log(shapes) / span - 1, -1, 1))
    return np.asarray(np.exp(_interpolation(span, chance) @ np.cos(_DEGREES * turned)))


@functools.lru_cache(maxsize=256)
def _interpolation(span: float, chance: float) -> FloatArray:
    """Coefficients (degrees,) of the logarithms of quantiles over those of shapes from 0 to `span`."""
    n = len(_DEGREES)
    at = (np.arange(n) + 0.5) * np.pi / n
    values = [math.log(gamma_quantile(math.exp(u), chance)) for u in (span * (np.cos(at) + 1) / 2).tolist()]
    coefficients = 2 / n * (np.cos(_DEGREES * at) @ np.array(values))
    coefficients[0] /= 2
    return np.asarray(coefficients)


def chi_square_quantile(freedom: float, chance: float) -> float:
    """Value that a chi-square variable exceeds with a chance."""
    return 2.0 * gamma_quantile(float(freedom) / 2, chance)


@functools.lru_cache(maxsize=4096)
def student_quantile(freedom: float, chance: float) -> float:
    """Value that a Student's t variable exceeds with a chance of at most 0.4."""
    log_norm = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2) - 0.5 * math.log(freedom * math.pi)

    def tail(t: float) -> tuple[float, float]:
        total = freedom + t * t
        log_density = log_norm - (freedom + 1) / 2 * math.log1p(t * t / freedom)
        log_tail = math.log(0.5) + _log_beta_part(freedom / 2, 0.5, freedom / total, t * t / total)
        return log_tail, math.log(t) + log_density

    return _solved(tail, 1.0, chance)


def normal_quantile(chance: float) -> float:
    """Value that a standard normal variable exceeds with a chance."""
    return -NormalDist().inv_cdf(chance)


def digamma(x: FloatArray) -> FloatArray:
    """Logarithmic derivative of the gamma function for positive arguments (DLMF 5.5.2 and 5.11.2)."""
    below = np.zeros_like(x)
    for step in range(10):
        below += 1 / (x + step)
    far2 = 1 / (x + 10) ** 2
    series = far2 * (1 / 12 - far2 * (1 / 120 - far2 * (1 / 252 - far2 * (1 / 240 - far2 / 132))))
    return np.log(x + 10) - 0.5 / (x + 10) - series - below


def legendre(x: FloatArray, order: int) -> FloatArray:
    """Legendre polynomials (n, order + 1) at places (n,), by Bonnet's recursion (DLMF 14.10.3)."""
    columns = [np.ones_like(x), x]
    for n in range(2, order + 1):
        columns.append((columns[-1] * x * (2 * n - 1) - columns[-2] * (n - 1)) / n)
    return np.stack(columns[: order + 1], axis=1)


def log_sum_exp(x: FloatArray, axis: int | tuple[int, ...] | None = None) -> FloatArray:
    """Logarithm of the sum of exponentials over some axes; all of them by default."""
    largest = x.max(axis=axis, keepdims=True)
    return np.asarray(np.log(np.exp(x - largest).sum(axis=axis)) + largest.reshape(x.sum(axis=axis).shape))


def softmax(x: FloatArray) -> FloatArray:
    """Exponentials over their sum."""
    parts = np.exp(x - x.max())
    return np.asarray(parts / parts.sum())


def logistic(x: float) -> float:
    """Logistic function, from 0 to 1."""
    part = math.exp(-abs(x))
    return 1 / (1 + part) if x >= 0 else part / (1 + part)


def _solved(tail: Callable[[float], tuple[float, float]], start: float, chance: float) -> float:
    """Solve for the argument at which a tail equals a chance.

    Parameters
    ----------
    tail : callable
        Returns the logarithms of the tail at an argument, and of the argument times the density.
    start : float
        An argument beyond the largest density of its logarithm.
    chance : float
    """
    x = start
    for _ in range(_MOST_STEPS):
        log_tail, log_slope = tail(x)
        step = (log_tail - math.log(chance)) * math.exp(log_tail - log_slope)
        x *= math.exp(step)
        if abs(step) < _LAST_STEP or x < _TINY:
            break
    return x


def _log_gamma_tail(shape: float, x: float, log_part: float) -> float:
    """Logarithm of the regularised upper incomplete gamma function; that of x^a e^-x / Gamma(a) is given."""
    if x < shape + 1:  # 1 minus the series of DLMF 8.7.1
        term = total = 1 / shape
        for n in range(1, _MOST_TERMS):
            term *= x / (shape + n)
            total += term
            if term < _PRECISION * total:
                break
        return math.log1p(-total * math.exp(log_part))
    fraction = _continued(  # DLMF 8.9.2, its even part
        lambda n: (-n * (n - shape), x + 2 * n + 1 - shape), x + 1 - shape
    )
    return log_part - math.log(fraction)


def _log_beta_part(a: float, b: float, x: float, rest: float) -> float:
    """Logarithm of the regularised incomplete beta function of x = 1 - `rest` (DLMF 8.17.22)."""
    if x > (a + 1) / (a + b + 2):
        return math.log1p(-math.exp(_log_beta_part(b, a, rest, x)))

    def term(n: int) -> tuple[float, float]:
        m = n // 2
        if n % 2:
            return -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)), 1.0
        return m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)), 1.0

    log_part = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log(rest)
    return log_part - math.log(a * _continued(term, 1.0))


def _continued(term: Callable[[int], tuple[float, float]], first: float) -> float:
    """Value of ``first + a1 / (b1 + a2 / (b2 + ...))`` by the modified method of Lentz (DLMF 3.10(iii))."""
    value = c = first or _TINY
    d = 0.0
    for n in range(1, _MOST_TERMS):
        a, b = term(n)
        d = 1 / (b + a * d or _TINY)
        c = b + a / c or _TINY
        value *= c * d
        if abs(c * d - 1) < _PRECISION:
            break
    return value

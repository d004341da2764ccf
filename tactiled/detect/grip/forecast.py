"""Probability that gross slip begins soon, from friction and the present growth of the ratio.

The growth of the ratio is extrapolated to each friction value. Hands change their mind: they stop near what
they want, and swings turn where they turned before. The time at which a growth arrives at a limit, over the
extrapolated time, is therefore log-logistic, and only a part of the growths arrives at all.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import Ahead
from tactiled.detect.grip.elementary import exp, expm1, power

_NODES = np.array([-np.sqrt(3.0), 0.0, np.sqrt(3.0)])  # Gauss-Hermite of order 3, for unit variance
_NODE_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0
_RATE_SD_PART = 0.25  # of the Kalman filter's, which allows for accelerations that hands seldom make
_LEAST_RATE = 1e-4  # 1/s: a ratio that does not grow
_LEAST_GAP = 0.01  # of the ratio: friction is not known better
_UNSEEN_PER_S = 0.01  # slips that no growth announces: a knock, friction that falls away; a prior


def p_gross_within(
    log_used: FloatArray,
    weights: FloatArray,
    growth: float,
    growth_sd: float,
    is_fresh: bool,
    horizons_s: FloatArray,
) -> FloatArray:
    """Return the probability that gross slip begins within each horizon, where it has not begun.

    Parameters
    ----------
    log_used : (n,) float64
        Logarithm of the ratio over the ratio at gross slip, for each friction value.
    weights : (n,) float64
        Probability of each friction value and that the contact sticks.
    growth, growth_sd : float
        Rate at which the ratio grows, over the ratio (1/s), and its standard deviation.
    is_fresh : bool
        True where the ratio exceeds what was borne before.
    horizons_s : (k,) float64

    Returns
    -------
    (k,) float64
    """
    # Extrapolated over available time is gap / (rate * horizon); its power is the product of three powers.
    rates = np.maximum(growth + growth_sd * (_RATE_SD_PART * _NODES), _LEAST_RATE)
    gap = power(np.maximum(expm1(-log_used), _LEAST_GAP), Ahead.TIME_POWER)
    slow = power(rates, -Ahead.TIME_POWER)
    soon = power(Ahead.TIME_PART * horizons_s, -Ahead.TIME_POWER)
    over = gap[:, np.newaxis] * slow[:, np.newaxis, np.newaxis] * soon  # (nodes, n, k)
    in_time = (_NODE_WEIGHTS[:, np.newaxis, np.newaxis] / (1.0 + over)).sum(axis=0)
    arrives = weights * exp(Ahead.E_FOLDS * np.minimum(log_used, 0.0))
    part = Ahead.FRESH if is_fresh else Ahead.REVISITED
    found = part * (in_time * arrives[:, np.newaxis]).sum(axis=0) + _UNSEEN_PER_S * horizons_s
    return np.asarray(np.minimum(found, 1.0))


def forecast_numbers(horizons_s: FloatArray) -> FloatArray:
    """Return the constants of `p_gross_within` for three horizons, in the order of `struct grip_numbers`."""
    soon = power(Ahead.TIME_PART * horizons_s, -Ahead.TIME_POWER)
    single = [_LEAST_RATE, _LEAST_GAP, Ahead.TIME_POWER, Ahead.E_FOLDS, Ahead.FRESH, Ahead.REVISITED]
    return np.concatenate([single, _RATE_SD_PART * _NODES, _NODE_WEIGHTS, soon, _UNSEEN_PER_S * horizons_s])

"""Intervals of the rate of rare reports, from their count.

No report in T hours bounds the rate by 3 / T at 95 % (the rule of three: exp(-3) = 0.05). Seconds of motion
can never prove one report an hour.
"""

import numpy as np
from scipy import special

LEVEL = 0.95


def rate_interval(count: int, hours: float) -> tuple[float, float]:
    """95 % interval of the rate per hour after `count` reports in `hours`.

    Garwood's exact limits (Biometrika 28, 1936); with no report the whole 5 % lies above: 3 / hours.
    """
    if count == 0:
        return 0.0, float(-np.log(1 - LEVEL) / hours)
    side = (1 - LEVEL) / 2
    low, high = special.gammaincinv(count, side), special.chdtri(2 * count + 2, side) / 2
    return float(low / hours), float(high / hours)

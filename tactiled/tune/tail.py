"""Statistics of rare alarms: bounds of their rate, and extrapolation to lower rates.

Bounds are Poisson intervals: k alarms in T hours bound the rate, whatever their cause. No alarm in T bounds
it by 3 / T at 95 % (the rule of three: exp(-3) = 0.05). Seconds of motion can never prove one alarm per hour.

Lower rates are extrapolated. Sizes above a high level u are exponential in the middle
case of extreme values (Pickands, Annals of Statistics 3, 1975; Coles, An Introduction to Statistical Modeling
of Extreme Values, 2001, section 4.3), neither bounded nor heavy-tailed; for a bounded
motion the estimate is too strict. The scale is the mean excess over u.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

LEVEL = 0.95
_ENOUGH = 10  # alarms above u: the scale is then good to a third


def rate_interval(count: int, hours: float) -> tuple[float, float]:
    """95 % interval of the rate per hour after `count` alarms in `hours`.

    Garwood's exact limits (Biometrika 28, 1936); with no alarm the whole 5 % lies above: 3 / hours.
    """
    if count == 0:
        return 0.0, float(-np.log(1 - LEVEL) / hours)
    side = (1 - LEVEL) / 2
    low, high = special.gammaincinv(count, side), special.chdtri(2 * count + 2, side) / 2
    return float(low / hours), float(high / hours)


@dataclass(frozen=True)
class AlarmTail:
    """Exponential tail of the number of alarms as a function of the parameter's strictness.

    Attributes
    ----------
    start : float
        u: the strictest value with enough alarms above it.
    count : int
        AlarmCount there.
    scale : float
        Mean excess over `start`.
    hours : float
    """

    start: float
    count: int
    scale: float
    hours: float

    def needed(self, per_hour: float) -> tuple[float, float, float]:
        """Strictness needed for a rate, and its 95 % interval: 2 n mean / scale is chi-square of 2 n."""
        times = max(0.0, float(np.log(self.count / self.hours / per_hour)))
        n, side = self.count, (1 - LEVEL) / 2
        excess = self.scale * times
        low = excess * 2 * n / special.chdtri(2 * n, side)
        high = excess * n / special.gammaincinv(n, side)
        return self.start + excess, self.start + float(low), self.start + float(high)


def fit_tail(levels: Sequence[float], counts: Sequence[int], hours: float) -> AlarmTail | None:
    """Fit the tail to counts of alarms at or above increasing values; None without alarms."""
    level, count = np.asarray(levels, dtype=np.float64), np.asarray(counts)
    if not count.any():
        return None
    enough = np.flatnonzero(count >= min(_ENOUGH, int(count.max())))
    first = int(enough[-1])
    # The mean of (size - u) over sizes above u is the integral of their survival from u on.
    above = np.minimum.accumulate(count[first:])
    integral = float(np.trapezoid(above, level[first:]))
    return AlarmTail(float(level[first]), int(count[first]), integral / int(count[first]), hours)


def silent_from(levels: Sequence[float], counts: Sequence[int]) -> float | None:
    """Lowest value from which on there was no alarm; None where the strictest still had one."""
    alarmed = np.flatnonzero(np.asarray(counts))
    first = int(alarmed[-1]) + 1 if len(alarmed) else 0
    return float(levels[first]) if first < len(levels) else None


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics.

    Conover, Practical Nonparametric Statistics, 1999, section 3.2.

    `inf` stands for missed; the interval may end there.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = len(ordered)
    k = int(np.searchsorted(special.bdtr(np.arange(n + 1), n, 0.5), (1 - LEVEL) / 2))
    # Two halves of inf are one: no mean of unequal infinities arises, since all are of one sign.
    middle = float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2
    low = max(k - 1, 0)
    return middle, float(ordered[low]), float(ordered[n - 1 - low])

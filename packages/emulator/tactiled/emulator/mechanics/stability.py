"""Limits of a Yeoh energy: loss of ellipticity, and decrease of the nominal stress.

An incompressible solid W(I1) is elliptic where, for all orthogonal unit vectors m, n and b = F F^T,

    W' n.b n + 2 W'' (m.b n)^2 > 0        (Ogden, Non-linear Elastic Deformations, 1984, section 6.2.7)

The largest (m.b n)^2 / n.b n over directions is the square of the difference d of the largest and the
smallest principal stretch, so the condition is W' + 2 d^2 W'' > 0. At a given I1 no state has a larger d^2
than pure shear, where it is I1 - 3: hence W' + 2 (I1 - 3) W'' > 0 is enough in any state.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray

# Beyond any test of a rubber. Steps of 0.5 % do not skip a pair of crossings of a cubic energy.
_SHORTEST, _LONGEST, _STEP = 0.01, 100.0, 0.005


@dataclass(frozen=True)
class StableRange:
    """Uniaxial stretches between which a Yeoh energy is valid; 0 and infinity where there is no limit."""

    elliptic: tuple[float, float]  # ellipticity is lost outside
    rising: tuple[float, float]  # nominal stress rises with stretch inside
    # I1 - 3 up to which the material is elliptic in every state, not just uniaxial ones
    any_state_excess: float

    def covers(self, shortest: float, longest: float) -> bool:
        """Return whether the energy is elliptic with rising stress over a range of stretches."""
        low, high = max(self.elliptic[0], self.rising[0]), min(self.elliptic[1], self.rising[1])
        return low < shortest and longest < high


def any_state_limit(c1_mpa: float, c2_mpa: float, c3_mpa: float) -> float:
    """I1 - 3 = x where W' + 2 x W'' = C1 + 6 C2 x + 15 C3 x^2 first is 0; infinite if never."""
    if c1_mpa <= 0:
        return 0.0
    inside = (6 * c2_mpa) ** 2 - 60 * c3_mpa * c1_mpa
    if inside < 0:
        return math.inf
    divisor = -6 * c2_mpa + math.sqrt(
        inside
    )  # this form of the quadratic formula has no division by a small C3
    return 2 * c1_mpa / divisor if divisor > 0 else math.inf


def stable_range(c1_mpa: float, c2_mpa: float, c3_mpa: float) -> StableRange:
    """Find the range numerically, outwards from zero strain, for the energy without continuation."""

    def derivatives(stretch: FloatArray) -> tuple[FloatArray, FloatArray]:
        excess = stretch**2 + 2 / stretch - 3
        return c1_mpa + 2 * c2_mpa * excess + 3 * c3_mpa * excess**2, 2 * c2_mpa + 6 * c3_mpa * excess

    def ellipticity(stretch: FloatArray) -> FloatArray:
        slope, curvature = derivatives(stretch)
        return slope + 2 * (stretch - stretch**-0.5) ** 2 * curvature

    def tangent(stretch: FloatArray) -> FloatArray:
        slope, curvature = derivatives(stretch)
        return (1 + 2 * stretch**-3) * slope + 2 * (stretch - stretch**-2) ** 2 * curvature

    return StableRange(
        elliptic=(_first_zero(ellipticity, _SHORTEST), _first_zero(ellipticity, _LONGEST)),
        rising=(_first_zero(tangent, _SHORTEST), _first_zero(tangent, _LONGEST)),
        any_state_excess=any_state_limit(c1_mpa, c2_mpa, c3_mpa),
    )


def _first_zero(margin: Callable[[FloatArray], FloatArray], end: float) -> float:
    """Stretch between 1 and `end` at which a margin first is not positive; 0 or infinity if it always is."""
    steps = np.arange(0.0, abs(np.log(end)) + _STEP, _STEP)
    stretch = np.exp(np.sign(np.log(end)) * steps)
    lost = np.flatnonzero(margin(stretch) <= 0)
    if not lost.size:
        return 0.0 if end < 1 else math.inf
    if lost[0] == 0:
        return 1.0
    from scipy.optimize import brentq  # a third of a second, which most boards do not need

    inside, outside = stretch[lost[0] - 1], stretch[lost[0]]
    return float(brentq(lambda at: float(margin(np.array([at]))[0]), inside, outside, xtol=1e-12))

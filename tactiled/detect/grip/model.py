"""State of one contact: from loads and shears of the taxels to the probability of gross slip.

Arrays in, numbers out; no clock. `ContactModel.follow` takes every scan, `ContactModel.look` the smoothed
loads and shears of every `STEP_S`, which may be delayed.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import FloatArray
from tactiled.detect.grip.elementary import sum_in_order
from tactiled.detect.grip.forecast import forecast_numbers, p_gross_within
from tactiled.detect.grip.friction import FULL, LEAST_RATIO, FrictionPosterior
from tactiled.detect.grip.growth import GrowthEvidence
from tactiled.detect.grip.rings import MINDLIN_POWER, RingForces, mindlin_rings
from tactiled.detect.grip.shares import ShareEvidence
from tactiled.detect.grip.trend import Trend
from tactiled.detect.grip.wander import ShareWander

STEP_S = 0.02  # between looks at the shares: a fifth of the shortest horizon that is useful
HORIZONS_S = np.array([0.05, 0.1, 0.3])
_QUANTILES = np.array([0.05, 0.5, 0.95])
NEEDED_UTILISATION = 0.7  # that `needed_load` would leave
_GROSS_ON, _GROSS_OFF = 0.5, 0.25  # probability that all slides, at which the state changes
_LEAST_RATIO = 0.02  # below it, noise and zero make the growth of the ratio's logarithm
INCIPIENT_SHARE = 0.1  # of the area that slips: what is called incipient slip
# Utilisation at which a tenth of a ball's area slips in first loading: the sticking share is (1 - u)^(2/3).
INCIPIENT_USED = 1.0 - (1.0 - INCIPIENT_SHARE) ** MINDLIN_POWER
_SURELY = 2.0  # standard deviations
_TINY = 1e-12


class Grip(NamedTuple):
    """Posterior after a scan.

    Attributes
    ----------
    utilisation, friction : (3,) float64
        Quantiles of 5, 50 and 95 %.
    slipping_share : float
    p_gross : (3,) float64
        That gross slip begins within `HORIZONS_S`.
    p_sliding : float
        That all of the contact slides now.
    p_incipient : float
        That a tenth of its area or more slips now.
    is_gross, is_unloading : bool
    """

    utilisation: FloatArray
    friction: FloatArray
    slipping_share: float
    p_gross: FloatArray
    p_sliding: float
    p_incipient: float
    is_gross: bool
    is_unloading: bool


class ContactModel:
    """Model of one contact.

    Parameters
    ----------
    x, y : (taxels,) float64
        Places from their mean, over their effective radius.
    friction : FrictionPosterior
        Prior of this contact; it is updated.
    """

    def __init__(self, x: FloatArray, y: FloatArray, friction: FrictionPosterior) -> None:
        self._x, self._y = x, y
        self.friction = friction
        self.trend = Trend()
        n = len(friction.friction)
        self._rings = RingForces(friction.friction, x, y, mindlin_rings())
        self._evidence = ShareEvidence(friction.friction, len(x))
        self._growth = GrowthEvidence()
        self._scan_s = 0.0
        self._wander = ShareWander(x, y, n)
        self._odds = np.zeros(n)
        self._slipping = np.zeros((n, len(x)))  # share of each taxel's stiffness
        self._area = np.zeros(n)  # share of the contact area that slips
        self._sticking = np.ones(n)  # likelihood of sticking over that of sliding
        self._part = np.full(len(x), 1.0 / len(x))  # of the load
        self._is_gross = False
        self._compiled: Callable[..., int] | None = None
        if (library := compiled.library()) is not None:
            single = [
                *(LEAST_RATIO, math.log(FULL), friction.lowest, friction.cell, _LEAST_RATIO),
                *(_GROSS_ON, _GROSS_OFF, INCIPIENT_SHARE, INCIPIENT_USED),
            ]
            self._numbers = np.concatenate([single, _QUANTILES, forecast_numbers(HORIZONS_S)])
            self._compiled = compiled.bind(
                library.tactiled_grip, n, self._numbers, friction.friction, friction.log_friction
            )

    @property
    def sliding_log_odds(self) -> float:
        """Mean log likelihood ratio of sliding over sticking at this moment."""
        return float(self.friction.weights @ self._odds)

    def total(self, shear: FloatArray) -> FloatArray:
        """Return sums along x and y and the moment (3, ...) of shears (2, ..., taxels)."""
        total = np.empty((3, *shear.shape[1:-1]))
        np.add.reduce(shear, axis=-1, out=total[:2])
        total[2] = shear[1] @ self._x - shear[0] @ self._y
        return total

    def follow(self, ratio: FloatArray, noise_sd: float, step_s: float, offset_sd: float = 0.0) -> None:
        """Take the ratio (3,) of total shear and moment over load.

        Parameters
        ----------
        noise_sd : float
        step_s : float
            Time since the last ratio.
        offset_sd : float
            Of a constant part that is not known: only what the ratio exceeds it by is surely borne.
        """
        self.trend.step(ratio, noise_sd, step_s)
        self.friction.bear(max(self.trend.size - _SURELY * offset_sd, 0.0), step_s)
        self._growth.take(float(np.sqrt(ratio @ ratio)), step_s)
        self._scan_s, self._noise_sd = step_s, noise_sd

    def skip(self, gap_s: float) -> None:
        """Predict over a gap: friction walks, and windows begin anew."""
        self.friction.walk(gap_s)
        self._growth = GrowthEvidence()
        self._wander = ShareWander(self._x, self._y, len(self.friction.friction))

    def loosen(self, taxels: NDArray[np.bool_]) -> None:
        """Forget the gains of taxels (taxels,) that are read otherwise from now on."""
        self._evidence.loosen(taxels)

    def look(self, load: FloatArray, shear: FloatArray, noise_sd: float, step_s: float) -> None:
        """Take loads (taxels,) and shears (2, taxels) of the taxels.

        Parameters
        ----------
        noise_sd : float
            Of one entry of `shear`.
        step_s : float
            Time since the last look.
        """
        load = np.maximum(load, 0.0)
        whole = max(float(load.sum()), _TINY)
        mean = whole / len(load)
        total = self.total(shear)
        self._rings.advance(load, total)
        predicted = self._rings.taxel_forces()
        found = self._evidence.log_likelihood(
            shear / mean,
            predicted / mean,
            np.sqrt((self.total(predicted) ** 2).sum(axis=0)) / whole,
            load / mean,
            total / whole,
            noise_sd / mean,
        )
        if found is not None:
            self.friction.take(found)
        wanders = self._wander.log_odds(shear / whole, predicted / whole, load / whole, noise_sd / whole)
        self._odds = wanders
        if new := self._growth.log_odds(self._noise_sd, self._scan_s):
            self.friction.take_sliding(new)
        self.friction.walk(step_s)
        self._sticking = np.exp(-self._odds)
        self._slipping, self._part = self._rings.sliding_share(), load / whole
        # The area of a ball that sticks goes as the square of its stick radius (Johnson, 7.2).
        self._area = 1.0 - (1.0 - self._slipping @ self._part) ** 2

    def grip(self) -> Grip:
        """Return the present posterior; `compiled_grip.c` has the same."""
        trend, friction = self.trend, self.friction
        size, growth = trend.size, trend.growth
        is_unloading = growth < -2 * trend.rate_sd
        if self._compiled is not None:
            out = np.empty(12)
            state = (friction.weights, friction.met, self._sticking, self._area)
            self._is_gross = bool(
                self._compiled(
                    *(compiled.address(values) for values in state),
                    *(size, growth, trend.rate_sd, trend.is_fresh, self._is_gross, compiled.address(out)),
                )
            )
            share, p_sliding, p_incipient = out[9:].tolist()
            return Grip(
                out[:3], out[3:6], share, out[6:9], p_sliding, p_incipient, self._is_gross, is_unloading
            )
        slides, sticks = friction.sliding(self._odds)
        p_sliding = sum_in_order(slides)
        self._is_gross = p_sliding > (_GROSS_OFF if self._is_gross else _GROSS_ON)
        holds = friction.weights * (1.0 - friction.met)
        share = p_sliding + sum_in_order(sticks * self._area)
        partial = self._area >= INCIPIENT_SHARE
        if trend.is_fresh and growth > 0:  # rings are looked at later than the total shear
            partial |= size > INCIPIENT_USED * friction.friction
        scale = max(size, _LEAST_RATIO)
        return Grip(
            utilisation=friction.utilisation_quantiles(size, sticks if self._is_gross else holds, _QUANTILES),
            friction=friction.friction_quantiles(_QUANTILES),
            slipping_share=min(max(share, 0.0), 1.0),
            p_gross=p_gross_within(
                friction.log_used(size),
                holds,
                growth / scale,
                trend.rate_sd / scale,
                trend.is_fresh,
                HORIZONS_S,
            ),
            p_sliding=p_sliding,
            p_incipient=p_sliding + sum_in_order(sticks * partial),
            is_gross=self._is_gross,
            is_unloading=is_unloading,
        )

    def slipping_taxels(self) -> tuple[int, ...]:
        """Return the taxels of which a tenth or more slips."""
        area = 1.0 - (1.0 - self.friction.weights @ self._slipping) ** 2
        return tuple(np.flatnonzero((area >= INCIPIENT_SHARE) & (self._part > 0)).tolist())

"""State of one contact: from loads and shears of the taxels to the probability of gross slip.

Arrays in, numbers out; no clock. `ContactModel.follow` takes every scan, `ContactModel.look` the smoothed
loads and shears of every `STEP_S`, which may be delayed.

`compiled_contact.c` does the same with the same bits. Sums are therefore taken one term after the other, and
exponentials are those of the C library (`elementary`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grip.elementary import exp, length, sum_in_order, sums_in_order
from tactiled.detect.grip.forecast import forecast_numbers, p_gross_within
from tactiled.detect.grip.friction import FULL, LEAST_RATIO, FrictionPosterior, bear_numbers
from tactiled.detect.grip.growth import GrowthEvidence, growth_numbers
from tactiled.detect.grip.observe import approximation_taps
from tactiled.detect.grip.rings import MINDLIN_POWER, RingForces, mindlin_rings, rings_numbers
from tactiled.detect.grip.shares import ShareEvidence, shares_numbers
from tactiled.detect.grip.trend import Trend, trend_numbers
from tactiled.detect.grip.wander import ShareWander, wander_numbers

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
    utilisation, friction : sequence of 3 float
        Quantiles of 5, 50 and 95 %.
    slipping_share : float
    p_gross : sequence of 3 float
        That gross slip begins within `HORIZONS_S`.
    p_sliding : float
        That all of the contact slides now.
    p_incipient : float
        That a tenth of its area or more slips now.
    is_gross, is_unloading : bool
    """

    utilisation: Sequence[float]
    friction: Sequence[float]
    slipping_share: float
    p_gross: Sequence[float]
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
    history : (n, 3, taxels) float64
        Load, shear along x and along y of the newest scans; others fill it.

    Attributes
    ----------
    parts : (2, taxels) float64
        Zero of the shear, over the load; others set it.
    total : tuple of float
        Sums of the shear along x and y, and its moment.
    shear : (2, taxels) float64
        Over the total load.
    """

    def __init__(
        self, x: FloatArray, y: FloatArray, friction: FrictionPosterior, history: FloatArray
    ) -> None:
        self._x, self._y, self._history = x, y, history
        self.parts = np.zeros((2, len(x)))
        self.total = (0.0, 0.0, 0.0)
        self.shear: FloatArray = np.zeros((2, len(x)))
        self.friction = friction
        self.trend = Trend()
        n = len(friction.friction)
        self._rings = RingForces(friction.friction, x, y, mindlin_rings())
        self._evidence = ShareEvidence(friction.friction, len(x))
        self._growth = GrowthEvidence()
        self._scan_s = self._noise_sd = 0.0
        self._wander = ShareWander(x, y, n)
        self._odds = np.zeros(n)
        self._slipping = np.zeros((n, len(x)))  # share of each taxel's stiffness
        self._area = np.zeros(n)  # share of the contact area that slips
        self._sticking = np.ones(n)  # likelihood of sticking over that of sliding
        self._part = np.full(len(x), 1.0 / len(x))  # of the load
        self._is_gross = False

    @property
    def sliding_log_odds(self) -> float:
        """Mean log likelihood ratio of sliding over sticking at this moment."""
        return sum_in_order(self.friction.weights * self._odds)

    def measure(self, whole: float) -> None:
        """Take the newest loads and shears of the history, whose loads sum to `whole`."""
        newest = self._history[-1]
        borne = newest[1:] - self.parts * newest[0]
        x, y, moment = self._total(borne).tolist()
        self.total, self.shear = (x, y, moment), borne / whole

    def follow(self, whole: float, noise_sd: float, step_s: float, offset_sd: float = 0.0) -> None:
        """Measure, and follow the ratio of the total to its load.

        Parameters
        ----------
        whole : float
            Sum of the newest loads.
        noise_sd : float
            Of the ratio.
        step_s : float
            Time since the last ratio.
        offset_sd : float
            Of a constant part that is not known: only what the ratio exceeds it by is surely borne.
        """
        self.measure(whole)
        ratio = np.array(self.total) / whole
        self.trend.step(ratio, noise_sd, step_s)
        self.friction.bear(max(self.trend.size - _SURELY * offset_sd, 0.0), step_s)
        self._growth.take(length(ratio), step_s)
        self._scan_s, self._noise_sd = step_s, noise_sd

    def skip(self, gap_s: float) -> None:
        """Predict over a gap: friction walks, and windows begin anew."""
        self.friction.walk(gap_s)
        self._growth = GrowthEvidence()
        self._wander = ShareWander(self._x, self._y, len(self.friction.friction))

    def loosen(self, taxels: NDArray[np.bool_]) -> None:
        """Forget the gains of taxels (taxels,) that are read otherwise from now on."""
        self._evidence.loosen(taxels)

    def look(self, level: int, noise_sd: float, step_s: float) -> None:
        """Look at the shares of the taxels, in the coif1 approximation of a level.

        Parameters
        ----------
        noise_sd : float
            Of one entry of the approximated shear.
        step_s : float
            Time since the last look.
        """
        kernel = approximation_taps(level)[::-1, np.newaxis, np.newaxis]
        load, *sheared = (kernel * self._history[-len(kernel) :]).sum(axis=0)
        shear = np.array(sheared) - self.parts * load
        load = np.maximum(load, 0.0)
        whole = max(sum_in_order(load), _TINY)
        mean = whole / len(load)
        total = self._total(shear)
        self._rings.advance(load, total)
        predicted = self._rings.taxel_forces()
        found = self._evidence.log_likelihood(
            shear / mean,
            predicted / mean,
            np.sqrt((self._total(predicted) ** 2).sum(axis=0)) / whole,
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
        self._sticking = exp(-self._odds)
        self._slipping, self._part = self._rings.sliding_share(), load / whole
        # The area of a ball that sticks goes as the square of its stick radius (Johnson, 7.2).
        self._area = 1.0 - (1.0 - sums_in_order(self._slipping * self._part)) ** 2

    def grip(self) -> Grip:
        """Return the present posterior."""
        trend, friction = self.trend, self.friction
        size, growth = trend.size, trend.growth
        is_unloading = growth < -2 * trend.rate_sd
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
            utilisation=friction.utilisation_quantiles(
                size, sticks if self._is_gross else holds, _QUANTILES
            ).tolist(),
            friction=friction.friction_quantiles(_QUANTILES).tolist(),
            slipping_share=min(max(share, 0.0), 1.0),
            p_gross=p_gross_within(
                friction.log_used(size),
                holds,
                growth / scale,
                trend.rate_sd / scale,
                trend.is_fresh,
                HORIZONS_S,
            ).tolist(),
            p_sliding=p_sliding,
            p_incipient=p_sliding + sum_in_order(sticks * partial),
            is_gross=self._is_gross,
            is_unloading=is_unloading,
        )

    def _total(self, shear: FloatArray) -> FloatArray:
        """Return sums along x and y and the moment (3, ...) of shears (2, ..., taxels)."""
        x, y = shear
        moment = sums_in_order(y * self._x) - sums_in_order(x * self._y)
        return np.array([sums_in_order(x), sums_in_order(y), moment])

    def slipping_taxels(self) -> tuple[int, ...]:
        """Return the taxels of which a tenth or more slips."""
        area = 1.0 - (1.0 - sums_in_order(self.friction.weights * self._slipping.T)) ** 2
        return tuple(np.flatnonzero((area >= INCIPIENT_SHARE) & (self._part > 0)).tolist())


def contact_numbers(x: FloatArray, y: FloatArray, friction: FrictionPosterior) -> FloatArray:
    """Return the constants of a contact in the order of `struct contact_numbers`."""
    grip = LEAST_RATIO, math.log(FULL), friction.lowest, friction.cell, _LEAST_RATIO, _GROSS_ON, _GROSS_OFF
    return np.concatenate(
        [
            trend_numbers(),
            bear_numbers(),
            growth_numbers(),
            rings_numbers(x, y),
            shares_numbers(),
            wander_numbers(),
            [friction.diffusion, _TINY, _SURELY, *grip, INCIPIENT_SHARE, INCIPIENT_USED, *_QUANTILES],
            forecast_numbers(HORIZONS_S),
        ]
    )

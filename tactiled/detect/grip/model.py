"""State of one contact: from loads and shears of the taxels to the probability of gross slip.

Arrays in, numbers out; no clock. `ContactModel.follow` takes every scan, `ContactModel.look` the smoothed
loads and shears of every `STEP_S`, which may be delayed.
"""

import math
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.friction import FrictionPosterior
from tactiled.detect.grip.rings import RingForces, mindlin_rings
from tactiled.detect.grip.shares import ShareEvidence
from tactiled.detect.grip.trend import Trend

STEP_S = 0.02  # between looks at the shares: a fifth of the shortest horizon that is useful
HORIZONS_S = np.array([0.05, 0.1, 0.3])
_QUANTILES = np.array([0.05, 0.5, 0.95])
NEEDED_UTILISATION = 0.7  # that `needed_load` would leave


class Grip(NamedTuple):
    """Posterior after a scan.

    Attributes
    ----------
    utilisation, friction : (3,) float64
        Quantiles of 5, 50 and 95 %.
    slipping_share : float
    p_gross : (3,) float64
        Within `HORIZONS_S`.
    p_sliding : float
    is_unloading : bool
    """

    utilisation: FloatArray
    friction: FloatArray
    slipping_share: float
    p_gross: FloatArray
    p_sliding: float
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
        self._rings = RingForces(friction.friction, x, y, mindlin_rings())
        self._evidence = ShareEvidence(len(friction.friction), len(x))
        self._slipping = np.zeros(len(friction.friction))
        self._peak = 0.0

    def total(self, shear: FloatArray) -> FloatArray:
        """Return sums along x and y and the moment (3, ...) of shears (2, ..., taxels)."""
        moment = shear[1] @ self._x - shear[0] @ self._y
        return np.stack([shear[0].sum(axis=-1), shear[1].sum(axis=-1), moment])

    def follow(self, ratio: FloatArray, noise_sd: float, step_s: float) -> None:
        """Take the ratio (3,) of total shear and moment over load."""
        trend, friction = self.trend, self.friction
        trend.step(ratio, noise_sd, step_s)
        friction.change(step_s)
        friction.bear(trend.size)
        if trend.ended_at > 0:
            friction.trend_ended(trend.size, trend.ended_at, trend.end_rate)

    def take_ripple(self, log_odds: float) -> None:
        """Take what the wavelet details say of sliding (`ripple.sliding_log_odds`)."""
        self.friction.take_sliding(log_odds)

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
        mean = max(float(load.mean()), 1e-12)
        total = self.total(shear)
        rings, friction = self._rings, self.friction
        rings.advance(load, total)
        if np.any(slides := friction.sliding > 0.5):
            rings.hold_at_limit(load, slides)
        predicted = rings.taxel_forces()
        borne = np.sqrt((self.total(predicted) ** 2).sum(axis=0))
        size = math.sqrt(float(total @ total))
        # A hypothesis that slides predicts how the shear is shared, and not how much there is of it.
        scale = np.where(slides, size / np.maximum(borne, 1e-12), 1.0)
        found = self._evidence.log_likelihood(
            shear / mean,
            predicted * (scale[:, np.newaxis] / mean),
            load / mean,
            total / (mean * len(load)),
            noise_sd / mean,
            friction.weights,
        )
        if found is not None:
            friction.take(found)
        friction.walk(step_s)
        self._slipping = rings.sliding_share() @ load / (mean * len(load))

    def grip(self) -> Grip:
        """Return the present posterior."""
        trend, friction = self.trend, self.friction
        size = trend.size
        p_sliding = friction.p_sliding
        # The area of a ball that sticks goes as the square of its stick radius (Johnson, 7.2).
        slipping = 1.0 - (1.0 - self._slipping) ** 2
        share = float(friction.weights @ np.maximum(slipping, friction.sliding))
        return Grip(
            utilisation=friction.utilisation_quantiles(size, _QUANTILES),
            friction=friction.friction_quantiles(_QUANTILES),
            slipping_share=min(max(share, 0.0), 1.0),
            p_gross=friction.p_gross_within(size, trend.growth, trend.rate_sd, trend.end_rate, HORIZONS_S),
            p_sliding=p_sliding,
            is_unloading=trend.growth < -2 * trend.rate_sd,
        )

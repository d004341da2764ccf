"""Posterior of the friction coefficient on a logarithmic grid, and what follows from it.

Utilisation is the borne ratio over friction, so that its quantiles are those of friction, turned round. Each
grid value stands for a cell. What happens in a contact, `compiled_contact.c` does with the same bits, in the
same arrays.
"""

import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import WALK_PART
from tactiled.detect.grip.elementary import exp, sum_in_order

N_FRICTION = 32  # 64 give the same errors
_REACH = 1.7  # of the grid about the prior's median, in log: 2.8 of its widest standard deviations
_EXCESS_SD = (
    0.10  # of log ratio by which a sliding contact exceeds its friction: unequal taxels, speed; a prior
)
FULL = 0.97  # of the ratio at the limit: taxels of unequal friction slip one after the other
# Log ratios over which a limit is met: shear over load at gross slip is known to 10 % either way, by what
# gains, relieved sides and taxels of unequal friction leave.
SOFT = 0.2
_KINETIC_LEAST = 0.75  # of the static limit: kinetic friction of rubber is seldom less, a prior
# Mean duration of gross slip: a dropped object is lost within 1 s, an arm strokes for 1 to 5 s; a prior.
# An even slide and a rest after it look the same, so that nothing else tells when it ended.
_SLIDE_S = 3.0
_FALLEN = 0.95  # of the largest ratio: a limit is met anew only after the ratio fell below this part; a prior
LEAST_RATIO = 1e-9  # whose logarithm is taken
_LEAST_WEIGHT = 1e-300
_CARRIED = 0.7  # probability that the next contact is of the same hand and object: a prior
_CARRIED_SD = 0.15  # by which log friction differs between contacts of the same two, at most


class FrictionPosterior:
    """Weights of friction values, and the part of each that may slide.

    Parameters
    ----------
    median, log_sd : float
        Lognormal prior.

    Attributes
    ----------
    friction, log_friction : (N_FRICTION,) float64
    cell, lowest : float
        Width of a cell and lower end of the first one, in log friction.
    weights : (N_FRICTION,) float64
    met : (N_FRICTION,) float64
        Part of each cell whose limit is met, or was, with a ratio since that kinetic friction can bear.
    penalty : (N_FRICTION,) float64
        Minus the log likelihood of what the contact has borne.
    diffusion : float
        Of the weights by a walk of friction, in squared cells for each second, halved.
    walk_rates : (2, N_FRICTION - 1) float64
        Of the walk from each cell to the next and back, over the diffusion: the walk keeps the prior.
    """

    def __init__(self, median: float, log_sd: float) -> None:
        offsets = np.linspace(-_REACH, _REACH, N_FRICTION)
        self.cell = float(offsets[1] - offsets[0])
        self.log_friction = np.log(median) + offsets
        self.lowest = float(self.log_friction[0]) - self.cell / 2
        self.friction = np.exp(self.log_friction)
        # A cell adds its own variance; a prior narrower than a cell must not be lost between two.
        log_prior = -0.5 * offsets**2 / max(log_sd**2 - self.cell**2 / 12, self.cell**2 / 4)
        self._prior = np.exp(log_prior)
        self._prior /= self._prior.sum()
        self.weights = self._prior.copy()
        self._log_sd = log_sd
        self.diffusion = 0.5 * (WALK_PART * log_sd / self.cell) ** 2
        # A walk that only spreads makes every friction equally likely in the end, and what refutes low values
        # then drives friction up for ever. Detailed balance keeps the prior; the harmonic mean of two cells
        # keeps both rates below 2, however narrow it is.
        rise = np.diff(log_prior)
        self.walk_rates = 2.0 / (1.0 + np.exp(np.stack([-rise, rise])))
        self.met = np.zeros(N_FRICTION)
        self.penalty = np.zeros(N_FRICTION)
        self._level = 0.0  # largest ratio since it fell

    def end_contact(self) -> None:
        """Turn the posterior into the prior of the next contact: hand and object may be the same."""
        self.spread(min(_CARRIED_SD, self._log_sd / 2))
        self.weights[:] = _CARRIED * self.weights + (1 - _CARRIED) * self._prior
        self._forget_contact()

    def _forget_contact(self) -> None:
        self.met[:] = 0.0
        self.penalty[:] = 0.0
        self._level = 0.0  # largest ratio since it fell

    def take(self, log_likelihood: FloatArray) -> None:
        """Multiply the weights by likelihoods given as logarithms (N_FRICTION,)."""
        self.weights *= exp(log_likelihood - log_likelihood.max())
        self.weights /= sum_in_order(self.weights)

    def walk(self, step_s: float) -> None:
        """Let friction change for a time, around the prior."""
        self._diffuse(self.diffusion * step_s, *self.walk_rates)

    def spread(self, log_sd: float) -> None:
        """Widen the posterior by a standard deviation of log friction."""
        self._diffuse(0.5 * (log_sd / self.cell) ** 2, *np.ones_like(self.walk_rates))

    def bear(self, ratio: float, step_s: float) -> None:
        """Take the ratio of shear over load that the contact bears now.

        Shear borne beyond a value refutes it; each excess counts once. A value whose limit was met may slide
        until the ratio falls below what sliding bears.
        """
        before, self._level = self._level, min(max(self._level, ratio), ratio / _FALLEN)
        above = math.log(max(ratio, LEAST_RATIO)) - self.log_friction
        was_met, is_met = self._part_met(before), self._part_met(self._level)
        begins = np.maximum(is_met - was_met, 0.0) / np.maximum(1.0 - was_met, LEAST_RATIO)
        goes_on = np.where(above > math.log(_KINETIC_LEAST), self.met * math.exp(-step_s / _SLIDE_S), 0.0)
        self.met[:] = goes_on + (1.0 - goes_on) * begins
        penalty = np.maximum(self.penalty, 0.5 * (np.maximum(above, 0.0) / _EXCESS_SD) ** 2)
        if np.any(penalty > self.penalty):
            self.take(self.penalty - penalty)
            self.penalty[:] = penalty

    def _part_met(self, ratio: float) -> FloatArray:
        """Return the part of each cell whose limit a ratio meets."""
        above = math.log(max(ratio, LEAST_RATIO)) - self.log_friction
        return np.asarray(np.clip((above - math.log(FULL)) / SOFT + 0.5, 0.0, 1.0))

    def take_sliding(self, log_odds: float) -> None:
        """Take a log likelihood ratio of sliding over sticking, which is the same for all friction values."""
        slides = self.weights * self.met * math.exp(log_odds)
        weights = slides + self.weights * (1.0 - self.met)
        self.met[:] = slides / np.maximum(weights, _LEAST_WEIGHT)
        self.weights[:] = weights / sum_in_order(weights)

    def sliding(self, log_odds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what slides and what sticks of each cell, as probabilities that sum to 1.

        Parameters
        ----------
        log_odds : (N_FRICTION,) float64
            Log likelihood ratio of sliding over sticking at this moment.
        """
        slides = self.weights * self.met
        sticks = self.weights * (1.0 - self.met) * exp(-log_odds)
        total = sum_in_order(slides) + sum_in_order(sticks)
        return slides / total, sticks / total

    def log_used(self, ratio: float) -> FloatArray:
        """Return the logarithm of a ratio over that at gross slip, for each friction value."""
        return np.asarray(math.log(max(ratio, LEAST_RATIO)) - self.log_friction - math.log(FULL))

    def friction_quantiles(self, at: FloatArray) -> FloatArray:
        """Return quantiles of friction, interpolated within cells."""
        return exp(self._log_quantiles(self.weights, at))

    def utilisation_quantiles(self, ratio: float, sticks: FloatArray, at: FloatArray) -> FloatArray:
        """Return quantiles of the ratio over friction; 1 where the contact slides.

        Parameters
        ----------
        sticks : (N_FRICTION,) float64
            Probability of each friction value and that the contact sticks.
        """
        # P(u <= q) = P(friction >= ratio / q) of what sticks: the upper tail of friction.
        tail = at / max(sum_in_order(sticks), 1e-12)
        log_q = self._log_quantiles(sticks, np.clip(1.0 - tail, 0.0, 1.0))
        found = np.minimum(1.0, ratio / exp(log_q))
        return np.asarray(np.where(tail >= 1.0, 1.0, found))

    def _diffuse(self, part: float, up: FloatArray, down: FloatArray) -> None:
        """Move parts of the weights to neighbouring cells; beyond a half at once, they would be negative.

        Parameters
        ----------
        part : float
        up, down : (N_FRICTION - 1,) float64
            Rates from each cell to the next and back.
        """
        steps = max(1, round(part / 0.25))
        for _ in range(steps):
            flow = part / steps * (down * self.weights[1:] - up * self.weights[:-1])
            self.weights[:-1] += flow
            self.weights[1:] -= flow

    def _log_quantiles(self, weights: FloatArray, at: FloatArray) -> FloatArray:
        up_to = np.add.accumulate(weights)
        wanted = at * up_to[-1]
        cell = np.minimum(np.searchsorted(up_to, wanted), N_FRICTION - 1)
        below = np.where(cell > 0, up_to[cell - 1], 0.0)
        part = (wanted - below) / np.maximum(weights[cell], 1e-300)
        return np.asarray(self.lowest + self.cell * (cell + part))


def bear_numbers() -> FloatArray:
    """Return the constants of `FrictionPosterior.bear` in the order of `struct contact_numbers`."""
    return np.array(
        [
            LEAST_RATIO,
            math.log(FULL),
            SOFT,
            math.log(_KINETIC_LEAST),
            _SLIDE_S,
            _EXCESS_SD,
            _FALLEN,
            _LEAST_WEIGHT,
        ]
    )

"""Posterior of the friction coefficient on a logarithmic grid, and what follows from it.

Utilisation is the borne ratio over friction, so that its quantiles are those of friction, turned round. Each
grid value stands for a cell: a borne ratio within a cell has refuted part of it.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import EXCESS_SD, FALL_RATE, SLIDE_S, SOFT, WALK_PART

N_FRICTION = 32
_REACH = 1.7  # of the grid about the prior's median, in log: 2.8 of its widest standard deviations
_KINETIC_LEAST = 0.75  # of the static limit: kinetic friction of rubber is seldom less, a prior
_CARRIED = 0.7  # probability that the next contact is of the same hand and object: a prior
_CARRIED_SD = 0.15  # by which log friction differs between contacts of the same two, at most
_NODES = np.array([-2.334414, -0.741964, 0.741964, 2.334414])  # Gauss-Hermite of order 4, for unit variance
_NODE_WEIGHTS = np.array([0.045876, 0.454124, 0.454124, 0.045876])


class FrictionPosterior:
    """Weights of friction values, and the part of each that slides.

    Parameters
    ----------
    median, log_sd : float
        Lognormal prior.

    Attributes
    ----------
    friction : (N_FRICTION,) float64
    weights : (N_FRICTION,) float64
    sliding : (N_FRICTION,) float64
        Part of each cell whose limit was met, and which slides since.
    """

    def __init__(self, median: float, log_sd: float) -> None:
        offsets = np.linspace(-_REACH, _REACH, N_FRICTION)
        self._cell = float(offsets[1] - offsets[0])
        self._log = np.log(median) + offsets
        self.friction = np.exp(self._log)
        # A cell adds its own variance; a prior narrower than a cell must not be lost between two.
        self._prior = np.exp(-0.5 * offsets**2 / max(log_sd**2 - self._cell**2 / 12, self._cell**2 / 4))
        self._prior /= self._prior.sum()
        self.weights = self._prior.copy()
        self._walk_variance = (WALK_PART * log_sd) ** 2
        self._spread_steps = round((min(_CARRIED_SD, log_sd / 2) / self._cell) ** 2 / 0.5)
        self._forget_contact()

    def end_contact(self) -> None:
        """Turn the posterior into the prior of the next contact: hand and object may be the same."""
        spread = self.weights
        for _ in range(self._spread_steps):
            spread = self._diffused(spread, 0.25)  # adds a variance of half a cell squared
        self.weights = _CARRIED * spread + (1 - _CARRIED) * self._prior
        self._forget_contact()

    def _forget_contact(self) -> None:
        self.sliding = np.zeros(N_FRICTION)
        self._penalty = np.zeros(N_FRICTION)
        self._met = np.zeros(N_FRICTION)
        self._ended_at = 0.0

    def take(self, log_likelihood: FloatArray) -> None:
        """Multiply the weights by likelihoods given as logarithms (N_FRICTION,)."""
        weights = self.weights * np.exp(log_likelihood - log_likelihood.max())
        self.weights = weights / weights.sum()

    def walk(self, step_s: float) -> None:
        """Let friction change for a time."""
        self.weights = self._diffused(self.weights, 0.5 * self._walk_variance * step_s / self._cell**2)

    def bear(self, ratio: float) -> None:
        """Take the ratio of shear over load that the contact bears now.

        A value below it slides. Shear borne beyond a value refutes it; each excess counts once. A value that
        slides sticks again when the ratio falls below what sliding bears.
        """
        above = np.log(max(ratio, 1e-9)) - self._log
        met = np.clip(above / SOFT + 0.5, 0.0, 1.0)
        was_met = self._met > 0.5
        holds_on = above > np.log(_KINETIC_LEAST)
        new = np.maximum(met - self._met, 0.0) / np.maximum(1.0 - self._met, 1e-6)
        self._met = np.maximum(met, np.where(holds_on, self._met, 0.0))
        self.sliding = np.where(holds_on | ~was_met, self.sliding + new * (1 - self.sliding), 0.0)
        penalty = np.maximum(self._penalty, 0.5 * (np.maximum(above, 0.0) / EXCESS_SD) ** 2)
        if np.any(penalty > self._penalty):
            self.take(self._penalty - penalty)
            self._penalty = penalty

    def trend_ended(self, ratio: float, growth: float, end_rate: float) -> None:
        """Take the end of a growth of the ratio.

        An end at a ratio that was reached before carries no information. The likelihood of a new one is 1
        for a contact that slides. For one that sticks it is the probability that the motion ended by itself
        while the ratio crossed `EXCESS_SD`, the band in which sliding values are not yet refuted.

        Parameters
        ----------
        ratio, growth : float
            Ratio, and the rate (1/s) at which it grew before.
        end_rate : float
            Rate (1/s) at which trends end by themselves.
        """
        if ratio < self._ended_at * np.exp(EXCESS_SD):
            return
        self._ended_at = ratio
        crossing_s = EXCESS_SD * ratio / max(growth, 1e-9)
        sticks = (1 - self.sliding) * (1.0 - np.exp(-end_rate * crossing_s))
        left = self.sliding + sticks
        weights = self.weights * left
        if weights.sum() > 0:
            self.weights = weights / weights.sum()
            self.sliding = self.sliding / np.maximum(left, 1e-300)

    def take_sliding(self, log_odds: float) -> None:
        """Take a likelihood ratio of sliding over sticking, as a logarithm."""
        odds = float(np.exp(log_odds))
        left = self.sliding * odds + (1 - self.sliding)
        weights = self.weights * left
        self.weights = weights / weights.sum()
        self.sliding = self.sliding * odds / left

    def change(self, step_s: float) -> None:
        """Let slides end by themselves, and friction fall away."""
        ends = np.exp(-step_s / SLIDE_S)
        falls = 1.0 - np.exp(-step_s * FALL_RATE)
        self.sliding = self.sliding * ends + (1 - self.sliding) * falls

    @property
    def p_sliding(self) -> float:
        """Probability that all of the contact slides."""
        return float(self.weights @ self.sliding)

    def friction_quantiles(self, at: FloatArray) -> FloatArray:
        """Return quantiles of friction, interpolated within cells."""
        return np.asarray(np.exp(self._log_quantiles(self.weights, at)))

    def utilisation_quantiles(self, ratio: float, at: FloatArray) -> FloatArray:
        """Return quantiles of the ratio over friction; 1 where the contact slides."""
        sticking = self.weights * (1 - self.sliding)
        mass = float(sticking.sum())
        # P(u <= q) = P(friction >= ratio / q) of what sticks: the upper tail of friction.
        tail = at / max(mass, 1e-12)
        log_q = self._log_quantiles(sticking / max(mass, 1e-12), np.clip(1.0 - tail, 0.0, 1.0))
        found = np.minimum(1.0, ratio / np.exp(log_q))
        return np.asarray(np.where(tail >= 1.0, 1.0, found))

    def p_gross_within(
        self, ratio: float, growth: float, growth_sd: float, end_rate: float, horizons_s: FloatArray
    ) -> FloatArray:
        """Return the probability that gross slip begins within each horizon, or is there.

        The ratio grows on with a rate that is normally distributed, until the trend ends (exponentially
        distributed). Rates are four Gauss-Hermite nodes.
        """
        rates = np.maximum(growth + growth_sd * _NODES, 1e-9)  # (nodes,)
        reach = np.log(ratio + rates[:, np.newaxis] * horizons_s + 1e-12)  # (nodes, horizons)
        met = np.clip((reach[:, :, np.newaxis] - self._log) / SOFT + 0.5, 0.0, 1.0)
        time_s = np.maximum(self.friction - ratio, 0.0) / rates[:, np.newaxis]  # (nodes, friction)
        lasts = np.exp(-end_rate * np.minimum(time_s, 10.0))
        new = np.maximum(met - self._met, 0.0) / np.maximum(1.0 - self._met, 1e-6)
        new = new * lasts[:, np.newaxis] * self.weights * (1.0 - self.sliding)
        return np.asarray(np.minimum(self.p_sliding + _NODE_WEIGHTS @ new.sum(axis=2), 1.0))

    def _diffused(self, weights: FloatArray, part: float) -> FloatArray:
        spread = weights.copy()
        flow = part * (weights[1:] - weights[:-1])
        spread[:-1] += flow
        spread[1:] -= flow
        return spread

    def _log_quantiles(self, weights: FloatArray, at: FloatArray) -> FloatArray:
        edges = np.append(self._log - self._cell / 2, self._log[-1] + self._cell / 2)
        below = np.concatenate([[0.0], np.cumsum(weights)])
        return np.asarray(np.interp(at, below / max(below[-1], 1e-300), edges))

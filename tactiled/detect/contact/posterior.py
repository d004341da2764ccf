"""Posterior of what one contact does: utilisation in cells, or sliding.

The file is plain Python, which Cython compiles with the types of `posterior.pxd` (`tactiled.compiled`).
"""

from array import array
from collections.abc import Sequence
from itertools import pairwise
from math import exp, log, sqrt

from tactiled.detect.contact.friction import CONTACT_LOG_SD, FRICTION, FRICTION_LOG_SD
from tactiled.detect.contact.hysteresis import SURELY_OVER
from tactiled.detect.signal.front_end import zeros

HORIZONS_S = (0.05, 0.1, 0.3)  # choice
INCIPIENT_SHARE = 0.1  # choice: of the area that slips: what is called incipient slip
# derived: utilisation at which a tenth of a ball's area slips in first loading: the sticking share is (1 -
# u)^(2/3) (Mindlin 1949; Johnson, Contact Mechanics, 7.2). Above it, cells are narrow where a controller
# works.
INCIPIENT_USED = 1.0 - (1.0 - INCIPIENT_SHARE) ** 1.5
EDGES = (0.0, INCIPIENT_USED, 0.3, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0)  # choice
N_STATES = len(EDGES)
"""Cells of utilisation, and sliding, which is the last one."""
LEAST_GROSS_USED = EDGES[N_STATES - 2]  # derived: the cell below sliding
"""Utilisation, at least, while a gross slip is open: what slides bears its limit, up to uneven friction."""
# physical: probability of sliding where a ripple travels: hands that hold had one in 2 windows of 1.7 h
RIPPLE_P = 0.99
FIVE_PERCENT = 1.645  # derived: standard deviations from the median to the quantile of 95 %
LEAST_BORNE = 0.02  # physical: that a slide bears: the friction of wet ice
_LEAST_VARIANCE = 0.01  # prior: of the logarithm of friction: a ratio tells it to a tenth at best
_LOG_FRICTION = log(FRICTION)
# prior: part of the looks whose ratio over utilisation is not near friction, whatever is known of that, and
# the standard deviation of its logarithm in these, twice that of friction. In these worlds it is off by more
# than 0.45 in 0.1 to 6 % of looks.
_ASTRAY, _ASTRAY_LOG_SD = 0.03, 2.0 * FRICTION_LOG_SD
# prior: beyond so many standard deviations of friction and of what it is here, a state is implausible
_PLAUSIBLE_SDS = 2.0
_NEVER = 1e-12  # derived: keeps a quotient of two densities from being one of zeros, at any ratio
# prior: where the zero of shear is not known, part of the looks that say no more than the prior
_WITHOUT_ZERO = 0.5
# tuned: over which the logarithms of the probabilities are averaged: what errs in one look mostly does not in
# the next (chosen on other seeds of the worlds of `bench grip`)
_AVERAGE_S = 0.02


class Posterior:
    """Posterior of the states of one contact.

    Parameters
    ----------
    look_s : float
        Time from one look to the next.

    Attributes
    ----------
    cells : (N_STATES,) array of float
        Probability of each cell of utilisation, then of sliding.
    soon : tuple of 3 floats
        Probability that gross slip begins within `HORIZONS_S`, if the contact does not slide yet.
    utilisation : tuple of 3 floats
        Quantiles of 5, 50 and 95 %, as they are published.
    friction : tuple of 3 floats
        The same quantiles of friction, as a ratio, whichever slip is open.
    p_sliding, slipping_share : float
        As they are published.
    p_sliding_now, p_incipient : float
        Probability that all of the contact slides, whichever slip is open, and that a tenth of its area or
        more does.
    """

    def __init__(self, look_s: float) -> None:
        self.new_part = 1.0 - exp(-look_s / _AVERAGE_S)
        self.cells, self.shown, self.logs = zeros(N_STATES), zeros(N_STATES), zeros(N_STATES)
        self.edges = array("d", EDGES)
        middles = [(low + high) / 2 for low, high in pairwise(EDGES)]
        self.middles = array("d", [*middles, 1.0])
        self.shares = array("d", [*(1.0 - (1.0 - middle) ** (2.0 / 3.0) for middle in middles), 1.0])
        self.begin()

    def begin(self) -> None:
        """Forget the contact: every state is as likely."""
        self.is_begun = self.is_gross = False
        n = len(self.cells)
        for k in range(n):
            self.cells[k] = 1.0 / n
        self.soon = self.utilisation = self.friction = (0.0, 0.0, 0.0)
        self.p_sliding = self.slipping_share = 0.0
        self.p_sliding_now, self.p_incipient = self.cells[n - 1], 1.0 - self.cells[0]

    def take(
        self,
        scores: Sequence[float],
        soon_scores: Sequence[float],
        signs_odds: float,
        ratio: float,
        log_friction: float,
        variance: float,
        was_seen: bool,
        ripple_travels: bool,
    ) -> None:
        """Take the scores of a look.

        The log odds of sliding are the mean of those by both forests: on physics that was not learnt from, it
        ranks looks better than either.

        The trees have learnt from friction of one prior (`FRICTION`) and are not told what is known of it: by
        Bayes, each cell is as much likelier as what is known makes its friction likelier than that prior.
        Both have wide tails: of friction far from that prior, the trees have learnt little.

        Parameters
        ----------
        scores : (N_STATES,) float
            Of the states, as logarithms but for a constant.
        soon_scores : (4,) float
            Of no gross slip within 300 ms, and of one within 300, 100 and 50 ms.
        signs_odds : float
            Log odds of sliding by the trees of the signs, of this look and within limits; high where a ripple
            travels.
        log_friction, variance : float
            Of the logarithm of friction, as a ratio, when the contact began.
        was_seen : bool
            The zero of the shear is known: the contact was seen to begin.
        ripple_travels : bool
            A ripple travels over the taxels: proof of sliding.
        """
        n = len(self.cells)
        most = scores[0]
        for k in range(n - 1):
            most = max(most, scores[k])
        total = 0.0
        for k in range(n - 1):
            total += exp(scores[k] - most)
        rests = most + log(total)
        sliding = rests + 0.5 * (scores[n - 1] - rests + signs_odds)
        most = max(most, sliding)
        log_ratio = log(max(ratio, LEAST_BORNE))
        here = variance + CONTACT_LOG_SD * CONTACT_LOG_SD
        prior = FRICTION_LOG_SD * FRICTION_LOG_SD + CONTACT_LOG_SD * CONTACT_LOG_SD
        wide = _ASTRAY_LOG_SD * _ASTRAY_LOG_SD
        weigh_here, weigh_prior = (1.0 - _ASTRAY) / sqrt(here), (1.0 - _ASTRAY) / sqrt(prior)
        weigh_wide = _ASTRAY / _ASTRAY_LOG_SD
        no_zero = 0.0 if was_seen else _WITHOUT_ZERO
        total = 0.0
        for k in range(n):
            p = exp((scores[k] if k < n - 1 else sliding) - most)
            friction = log_ratio - log(self.middles[k])
            off, off_learnt = friction - log_friction, friction - _LOG_FRICTION
            misfit = off * off / here
            astray = weigh_wide * max(exp(-0.5 * off_learnt * off_learnt / wide), _NEVER)
            known = astray + weigh_here * exp(-0.5 * misfit)
            learnt = astray + weigh_prior * exp(-0.5 * off_learnt * off_learnt / prior)
            fits = no_zero + (1.0 - no_zero) * known / learnt
            if misfit > _PLAUSIBLE_SDS * _PLAUSIBLE_SDS:
                fits *= exp(-0.5 * (misfit - _PLAUSIBLE_SDS * _PLAUSIBLE_SDS))
            p *= _ASTRAY + (1.0 - _ASTRAY) * fits  # so that a friction that is wrong can be refuted
            self.cells[k] = p
            total += p
        is_over = self.is_gross and self.cells[n - 1] < SURELY_OVER * total
        is_taken_whole = is_over or not self.is_begun
        self.is_begun = True
        whole, total = total, 0.0
        for k in range(n):
            now = log(max(self.cells[k] / whole, 1e-12))
            self.logs[k] = now if is_taken_whole else self.logs[k] + self.new_part * (now - self.logs[k])
            self.cells[k] = exp(self.logs[k])
            total += self.cells[k]
        for k in range(n):
            self.cells[k] /= total
        if ripple_travels and self.cells[n - 1] < RIPPLE_P:
            left = (1.0 - RIPPLE_P) / (1.0 - self.cells[n - 1])
            for k in range(n - 1):
                self.cells[k] *= left
            self.cells[n - 1] = RIPPLE_P
        self.p_sliding_now, self.p_incipient = self.cells[n - 1], 1.0 - self.cells[0]
        most = max(max(soon_scores[0], soon_scores[1]), max(soon_scores[2], soon_scores[3]))
        none, in_300 = exp(soon_scores[0] - most), exp(soon_scores[1] - most)
        in_100, in_50 = exp(soon_scores[2] - most), exp(soon_scores[3] - most)
        total = none + in_300 + in_100 + in_50
        self.soon = in_50 / total, (in_50 + in_100) / total, (in_50 + in_100 + in_300) / total

    def publish(
        self,
        is_gross: bool,
        least_sliding: float,
        ratio: float,
        log_friction: float,
        variance: float,
    ) -> None:
        """Fill in what is published: a gross slip that is open is what is published, until it closes.

        Parameters
        ----------
        least_sliding : float
            Probability of sliding, at least, while one is.
        log_friction, variance : float
            Of the logarithm of friction, as a ratio, in the memory.
        """
        n = len(self.cells)
        self.is_gross = is_gross
        for k in range(n):
            self.shown[k] = self.cells[k]
        low = self._quantile(0.05)  # whichever slip is open: it may be over, and what is not sure must show
        if is_gross:
            sliding = self.cells[n - 1] / (self.cells[n - 2] + self.cells[n - 1])
            sliding = max(sliding, least_sliding)
            for k in range(n - 2):
                self.shown[k] = 0.0
            self.shown[n - 2], self.shown[n - 1] = 1.0 - sliding, sliding
        self.p_sliding = max(self.cells[n - 1], least_sliding) if is_gross else self.cells[n - 1]
        self.utilisation = low, self._quantile(0.5), self._quantile(0.95)
        share, mean, square = 0.0, 0.0, 0.0
        for k in range(n):
            share += self.shown[k] * self.shares[k]
            one = -log(self.middles[k])
            mean += self.cells[k] * one
            square += self.cells[k] * one * one
        self.slipping_share = 1.0 if is_gross else min(share, 1.0)
        if ratio > LEAST_BORNE:  # the ratio over utilisation, unless the memory knows more
            now = max(square - mean * mean, _LEAST_VARIANCE)
            if now < variance:
                log_friction, variance = log(ratio) + mean, now
        reach = FIVE_PERCENT * sqrt(variance)
        self.friction = exp(log_friction - reach), exp(log_friction), exp(log_friction + reach)

    def _quantile(self, wanted: float) -> float:
        """Return a quantile of utilisation, linear within a cell; sliding is 1."""
        up_to, value = 0.0, 1.0
        for k in range(len(self.cells) - 1):
            if up_to + self.shown[k] >= wanted:
                width = self.edges[k + 1] - self.edges[k]
                value = self.edges[k] + width * (wanted - up_to) / max(self.shown[k], 1e-12)
                break
            up_to += self.shown[k]
        return min(value, 1.0)

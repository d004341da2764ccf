"""Posterior of a contact from the scores of the trees, and the numbers that are published of it."""

from array import array
from collections.abc import Sequence
from itertools import pairwise
from math import exp, log, sqrt

INCIPIENT_SHARE = 0.1  # choice: of the area that slips: what is called incipient slip
# derived: utilisation at which a tenth of a ball's area slips in first loading: the sticking share is (1 -
# u)^(2/3) (Mindlin 1949; Johnson, Contact Mechanics, 7.2). Above it, cells are narrow where a controller
# works.
INCIPIENT_USED = 1.0 - (1.0 - INCIPIENT_SHARE) ** 1.5
EDGES = (0.0, INCIPIENT_USED, 0.3, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0)  # choice
N_STATES = len(EDGES)
"""Cells of utilisation, and sliding, which is the last one."""
LEAST_GROSS_USED = 0.9  # choice
"""Utilisation, at least, while a gross slip is open: what slides bears its limit, up to uneven friction."""
# physical: probability of sliding where a ripple travels: hands that hold had one in 2 windows of 1.7 h
RIPPLE_P = 0.99
_QUANTILES = (0.05, 0.5, 0.95)  # choice
FIVE_PERCENT = 1.645  # derived: standard deviations from the median to the quantile of 95 %
_LEAST_RATIO = 0.02  # physical: below it, the ratio says nothing of friction
# prior: of a cell: where hardly any of friction is in use, the ratio does not tell friction
_LEAST_MIDDLE = 0.05
_LEAST_VARIANCE = 0.01  # prior: of the logarithm of friction: a ratio tells it to a tenth at best
# prior: standard deviations of the logarithm of the ratio by which the friction that a state implies may err:
# in one contact by pressure, place and zero; over all contacts by gains of uncalibrated shear, too. Beyond so
# many deviations of this and of friction, a state is implausible.
_HERE_SD, _RATIO_SD, _PLAUSIBLE_SDS = 0.15, 0.3, 2.0
# prior: of friction in the worlds that the trees learnt from: see `GripParams`
_LEARNT_LOG, _LEARNT_SD = log(0.6), 0.6
# prior: part of the looks whose ratio says nothing of friction. In these worlds the ratio over friction and
# utilisation is off by more than 0.45 in log in 0.1 to 6 % of looks, in 37 to 87 % where the zero of the
# shear is not known.
_UNTOLD, _UNTOLD_WITHOUT_ZERO = 0.03, 0.5
_TINY = 1e-12  # derived


class Posterior:
    """Posterior of the states of one contact.

    Parameters
    ----------
    columns : sequence of int
        Places of the signs that the trees of the state are given.
    n_memory : int
        Length of the row of the memory.

    Attributes
    ----------
    row : array of float
        What these trees are given: signs, then the memory.
    cells : (N_STATES,) array of float
        Probability of each cell of utilisation, then of sliding.
    soon : (3,) array of float
        Probability that gross slip begins within 50, 100 and 300 ms, if the contact does not slide yet.
    utilisation : (3,) array of float
        Quantiles of 5, 50 and 95 %, as they are published.
    friction : (3,) array of float
        The same quantiles of friction, as a ratio, whichever slip is open.
    p_sliding, slipping_share : float
        As they are published.
    """

    def __init__(self, columns: Sequence[int], n_memory: int) -> None:
        self.columns = array("q", columns)
        self.row = array("d", bytes(8 * (len(columns) + n_memory)))
        self.cells = array("d", bytes(8 * N_STATES))
        self.shown = array("d", bytes(8 * N_STATES))
        self.soon = array("d", bytes(8 * 3))
        self.utilisation, self.friction = array("d", bytes(8 * 3)), array("d", bytes(8 * 3))
        self.edges = array("d", EDGES)
        middles = [max((low + high) / 2, _LEAST_MIDDLE) for low, high in pairwise(EDGES)]
        self.middles = array("d", [*middles, 1.0])
        self.shares = array("d", [*(1.0 - (1.0 - middle) ** (2.0 / 3.0) for middle in middles), 1.0])
        self.wanted = array("d", _QUANTILES)
        self.begin()

    def begin(self) -> None:
        """Forget the contact: every state is as likely."""
        for k in range(len(self.cells)):
            self.cells[k] = 1.0 / len(self.cells)
        for k in range(3):
            self.soon[k] = 0.0
        self.p_sliding = self.slipping_share = 0.0

    def gather(self, signs: Sequence[float], memory: Sequence[float]) -> None:
        """Fill `row` from the rows of the signs and of the memory."""
        n = len(self.columns)
        for k in range(n):
            self.row[k] = signs[self.columns[k]]
        for k in range(len(memory)):
            self.row[n + k] = memory[k]

    def take(
        self,
        scores: Sequence[float],
        soon_scores: Sequence[float],
        signs_odds: float,
        ratio: float,
        log_friction: float,
        variance: float,
        has_zero: int,
        ripple_travels: int,
    ) -> None:
        """Take the scores of a look.

        The log odds of sliding are the mean of those by both forests: on physics that was not learnt from, it
        ranks looks better than either.

        The trees have learnt from friction of one prior (`_LEARNT_LOG`) and are not told what is known of it:
        by Bayes, each cell is as much likelier as what is known makes its friction likelier than that prior.
        Frictions that leave both are made less likely: the trees say nothing of them.

        Parameters
        ----------
        scores : (N_STATES,) float
            Of the states, as logarithms but for a constant.
        soon_scores : (4,) float
            Of no gross slip within 300 ms, and of one within 300, 100 and 50 ms.
        signs_odds : float
            Log odds of sliding by the trees of the signs.
        log_friction, variance : float
            Of the logarithm of friction, as a ratio, when the contact began.
        has_zero : int
            1 where the zero of the shear is known: the contact was seen to begin.
        ripple_travels : int
            1 where a ripple travels over the taxels: proof of sliding.
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
        log_ratio = log(max(ratio, _LEAST_RATIO))
        sd = sqrt(variance + _RATIO_SD * _RATIO_SD)
        here = variance + _HERE_SD * _HERE_SD
        learnt = _LEARNT_SD * _LEARNT_SD + _HERE_SD * _HERE_SD
        untold = _UNTOLD if has_zero == 1 else _UNTOLD_WITHOUT_ZERO
        total = 0.0
        for k in range(n):
            p = exp((scores[k] if k < n - 1 else sliding) - most)
            friction = log_ratio - log(self.middles[k])
            off, off_learnt = friction - log_friction, friction - _LEARNT_LOG
            fits = sqrt(learnt / here) * exp(0.5 * (off_learnt * off_learnt / learnt - off * off / here))
            p *= untold + (1.0 - untold) * fits
            sds = abs(off) / sd
            if sds > _PLAUSIBLE_SDS:
                p *= exp(-0.5 * (sds * sds - _PLAUSIBLE_SDS * _PLAUSIBLE_SDS))
            self.cells[k] = max(p, _TINY)
            total += self.cells[k]
        for k in range(n):
            self.cells[k] /= total
        if ripple_travels == 1 and self.cells[n - 1] < RIPPLE_P:
            left = (1.0 - RIPPLE_P) / (1.0 - self.cells[n - 1])
            for k in range(n - 1):
                self.cells[k] *= left
            self.cells[n - 1] = RIPPLE_P
        most = max(max(soon_scores[0], soon_scores[1]), max(soon_scores[2], soon_scores[3]))
        none, in_300 = exp(soon_scores[0] - most), exp(soon_scores[1] - most)
        in_100, in_50 = exp(soon_scores[2] - most), exp(soon_scores[3] - most)
        total = none + in_300 + in_100 + in_50
        self.soon[0] = in_50 / total
        self.soon[1] = (in_50 + in_100) / total
        self.soon[2] = (in_50 + in_100 + in_300) / total

    def publish(
        self,
        is_gross: int,
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
        for k in range(n):
            self.shown[k] = self.cells[k]
        if is_gross == 1:
            sliding = self.cells[n - 1] / (self.cells[n - 2] + self.cells[n - 1])
            sliding = max(sliding, least_sliding)
            for k in range(n - 2):
                self.shown[k] = 0.0
            self.shown[n - 2], self.shown[n - 1] = 1.0 - sliding, sliding
        self.p_sliding = self.shown[n - 1]
        self._take_quantiles()
        share, mean, square = 0.0, 0.0, 0.0
        for k in range(n):
            share += self.shown[k] * self.shares[k]
            one = -log(self.middles[k])
            mean += self.cells[k] * one
            square += self.cells[k] * one * one
        self.slipping_share = 1.0 if is_gross == 1 else min(share, 1.0)
        if ratio > _LEAST_RATIO:  # the ratio over utilisation, unless the memory knows more
            now = max(square - mean * mean, _LEAST_VARIANCE)
            if now < variance:
                log_friction, variance = log(ratio) + mean, now
        reach = FIVE_PERCENT * sqrt(variance)
        self.friction[0] = exp(log_friction - reach)
        self.friction[1] = exp(log_friction)
        self.friction[2] = exp(log_friction + reach)

    def _take_quantiles(self) -> None:
        """Take quantiles of utilisation, linear within a cell; sliding is 1."""
        n = len(self.cells)
        for q in range(3):
            up_to, value = 0.0, 1.0
            for k in range(n - 1):
                if up_to + self.shown[k] >= self.wanted[q]:
                    width = self.edges[k + 1] - self.edges[k]
                    value = self.edges[k] + width * (self.wanted[q] - up_to) / max(self.shown[k], _TINY)
                    break
                up_to += self.shown[k]
            self.utilisation[q] = min(value, 1.0)

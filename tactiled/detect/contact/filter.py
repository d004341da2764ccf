"""The one filter of a contact: from loads and shears of the taxels to a posterior that all messages share.

Each look of 20 ms, trees judge the signs of the moment alone (`signs`); the odds that they give enter the
`Memory`; other trees weigh the memory and a few signs and give the `Posterior` of the state: utilisation in
cells, or sliding. The log odds of sliding are the mean of those by both, and the posterior is averaged over
some looks. A third forest gives the time to gross slip of what does not slide yet. All three are trained by
``./run train slip``. What is known of friction outlives the contact (`FrictionMemory`).

A slip opens and closes by thresholds on this one posterior (`SlipHysteresis`). What is published of the state
follows the slip that is open, so that slip events, grip messages and contact state never differ.

The file is plain Python, which Cython compiles with the types of `filter.pxd` (`tactiled.compiled`).
"""

from array import array
from bisect import bisect
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import exp, hypot, log, sqrt
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.signs import LEAST_RATIO, LOOK_S, NAMES
from tactiled.detect.signal.front_end import zeros
from tactiled.events.types import GripEvent, GripState

if TYPE_CHECKING:
    from tactiled.detect.contact.learnt import Learnt
    from tactiled.detect.contact.signs import Signs

HORIZONS_S = (0.05, 0.1, 0.3)  # choice
STATE_SIGNS = (
    *("load_unevenness", "loaded_part", "moment", "shear_load_correlation", "ratio", "log_ratio_of_largest"),
    *("since_largest_s", "own_ratio_sd", "own_ratio_most", "ratio_change_80ms", "log_ratio_change_300ms"),
    *("log_load_change_300ms", "above_least_500ms", "ratio_sd_160ms", "wander_noises_160ms", "log_noise"),
    *("ripple_travels", "acceleration", "is_seen"),
)
"""Signs that the second trees are given beside the memory."""
ODDS_S = (0.1, 0.4, 1.6, 6.0)  # choice: averaging times of the odds, each four times the one before
MEMORY_NAMES: tuple[str, ...] = (
    "odds",
    *(f"odds_{1000 * time_s:.0f}ms" for time_s in ODDS_S),
    *("odds_above_usual", "odds_largest", "filtered_odds", "part_sliding_10s", "movement_10s"),
    *("log_ratio_of_slid", "slid_s", "log_ratio_of_borne", "since_likely_s", "log_ratio_of_crossing"),
)
ROW_NAMES = (*NAMES, *STATE_SIGNS, *MEMORY_NAMES)
"""Names of the inputs by place: of the first trees, then of the second ones."""
LOAD_CHANGE = NAMES.index("log_load_change_300ms")
_INFINITE = float("inf")
_ALL_LEAVES, _MOST_LEAVES = 0xFFFFFFFF, 32  # derived: a bit for each leaf of a tree, in 32 bits
# derived: the five highest bits of a power of two times this number (modulo 2^32) are another number for each
# power (Leiserson, Prokop and Randall 1998), which is looked up
_DE_BRUIJN = 0x077CB531
_PLACES = array("i", sorted(range(_MOST_LEAVES), key=lambda bit: (_DE_BRUIJN << bit & _ALL_LEAVES) >> 27))
_LEAST_BORNE = 0.02  # physical: that a slide bears: the friction of wet ice

# --- memory
_MOST_ODDS, _LEAST_ODDS = 5.0, -4.0  # choice: one look is never surer than 1 in 150
_LONG_S = 10.0  # choice: in which the hand's own habits show
_PEAK_S = 1.0  # choice: decay of the largest odds
# prior: for which a slide, and a ratio that was borne without one, tell the ratio that friction bears
_BORNE_S = 20.0
# prior: rates of a filter with two states, 1/s: a prior of everyday hands, whose slips are seconds apart and
# short.
_ONSETS, _ENDS = 0.05, 1.0
# prior: of the odds of a look of 20 ms that is new: readings of neighbouring looks are alike
_FILTER_PART = 0.15

# --- friction
# physical: friction. Kinetic friction of a slide scatters by 0.12 in log for each 0.3 s of travel over other
# places.
_SLIDE_SD, _SLIDE_S = 0.12, 0.3
_WALK_SD = 0.03  # prior: of log friction in a second: warming, moisture, wear of what is held
# prior: of log friction from one contact with an object to the next, and of what a state implies of it in one
# contact: place and pressure differ
_CONTACT_SD = 0.15
_LEAST_SD = 0.07  # prior: friction that depends on load, speed and age is not known better by one number
_MOST_UNLOADED = -5.0  # choice: log of the load over that of 300 ms before: less is no load

# --- slips that open and close
# tuned: a slip closes when its probability was below this part of the threshold for so long. With half of it
# and 80 ms, one slide over an even surface is told several times (chosen on the worlds of `bench grip`).
_OFF, _OFF_S = 1.0 / 3.0, 0.15
# prior: probability below which a slip closes at once, if its threshold is higher: a slide that turns back
# is another one
_SURELY_OVER = 0.02
_GROWN = 1.1  # prior: of the least ratio since a slip closed, beyond which the next incipient one may open
_SURELY = 3.0  # choice: standard deviations: what noise may make is no slip
# choice: in which scans are averaged for a direction: so long after a gap or a touch, no slip opens
DIRECTION_S = 0.06

# --- posterior
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
_LEAST_VARIANCE = 0.01  # prior: of the logarithm of friction: a ratio tells it to a tenth at best
# prior: beyond so many standard deviations of friction and of what it is here, a state is implausible
_PLAUSIBLE_SDS = 2.0
# physical: friction of rubber on objects, its median and the standard deviation of its logarithm: between 0.2
# (wet, oily) and 2 (clean glass), and gains of uncalibrated shear add 0.3. It is the prior of the worlds that
# the trees learnt from, too.
FRICTION, FRICTION_LOG_SD = 0.6, 0.6
_LOG_FRICTION = log(FRICTION)
# prior: part of the looks whose ratio says nothing of friction; where the zero of shear is not known, part
# of the others that say no more than the prior. In these worlds the ratio over friction and utilisation is
# off by more than 0.45 in log in 0.1 to 6 % of looks, in 1 to 9 % where the zero is not known.
_UNTOLD, _WITHOUT_ZERO = 0.03, 0.5
# tuned: over which the logarithms of the probabilities are averaged: what errs in one look mostly does not in
# the next (chosen on other seeds of the worlds of `bench grip`)
_AVERAGE_S = 0.04

# --- what is published
NEEDED_UTILISATION = 0.7  # choice
"""Utilisation that `needed_load` would leave."""
# choice: standard deviations by which the ratio falls where a contact is unloaded: less shear, or a firmer
# grip
_SURELY_FALLS = 2.0
HISTORY_S = 1.0  # choice: in which the beginning of a slip is looked for


class SlipThresholds(NamedTuple):
    """Probabilities that a tenth of the area slips, or all of it, from which a slip is open."""

    incipient: float
    gross: float


SETTINGS: Mapping[str, SlipThresholds] = {
    "fast": SlipThresholds(incipient=0.7, gross=0.2),
    "balanced": SlipThresholds(incipient=0.9, gross=0.3),
    "quiet": SlipThresholds(incipient=0.98, gross=0.45),
}
"""Probabilities from which incipient and gross slip are reported, by setting (docs/slip.md).

Tuned on worlds of all generators, seeds from 500,000 and, of hands that hold, from 520,000.
"""


class Trees:
    """Gradient-boosted trees as flat arrays: one score for each output.

    No tree is walked. Each condition of a tree that a row fails crosses out the leaves on its left; the first
    leaf that is left is where the row goes (QuickScorer, Lucchese et al., SIGIR 2015). Conditions are sorted
    by feature and limit, so that those which fail come first: after a pause, memory is read in one go.

    Parameters
    ----------
    table : mapping
        ``first`` (outputs,) float64, scores before any tree; ``root`` and ``output`` (trees,), first node of
        each tree and the output that it adds to; ``links`` (nodes, 2) int32: twice the feature, and 1 more
        where a feature that is NaN goes left, or -1 in a leaf; then the right child (the left one is the next
        node); ``value`` (nodes,) float64, largest value that goes left, or score of a leaf.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        links, value = np.reshape(table["links"], (-1, 2)).tolist(), np.ravel(table["value"]).tolist()
        conditions: list[tuple[int, float, int, int, int]] = []
        leaves: list[float] = []
        leaf_of: list[int] = []  # of each tree, its first leaf

        def take(node: int, tree: int) -> int:
            """Take what is below a node; return how many leaves of the tree there are so far."""
            link, right = links[node]
            if link < 0:
                leaves.append(value[node])
                return len(leaves) - leaf_of[tree]
            before = len(leaves) - leaf_of[tree]
            up_to = take(node + 1, tree)
            left = _ALL_LEAVES ^ (1 << up_to) - (1 << before)
            conditions.append((link >> 1, value[node], link & 1, tree, left))
            return take(right, tree)

        self.first, self.output = array("d", table["first"]), array("i", table["output"])
        for tree, root in enumerate(table["root"]):
            leaf_of.append(len(leaves))
            if take(int(root), tree) > _MOST_LEAVES:
                raise ValueError(f"a tree has more than {_MOST_LEAVES} leaves")
        conditions.sort()
        n_features = max([one[0] for one in conditions], default=-1) + 1
        self.of_feature = array("i", [bisect(conditions, (k,)) for k in range(n_features + 1)])
        self.limit = array("d", [one[1] for one in conditions])
        self.nan_fails = array("b", [1 - one[2] for one in conditions])
        self.tree = array("i", [one[3] for one in conditions])
        self.left = array("I", [one[4] for one in conditions])  # leaves that are left where it fails
        self.leaf, self.leaf_of = array("d", leaves), array("i", leaf_of)
        self.reached = array("I", [_ALL_LEAVES] * len(self.output))
        self.scores = array("d", self.first)

    def evaluate(self, row: "array[float]") -> None:
        """Put the scores of a row of features into `scores`."""
        for t in range(len(self.output)):
            self.reached[t] = _ALL_LEAVES
        for feature in range(len(self.of_feature) - 1):
            value, end = row[feature], self.of_feature[feature + 1]
            for k in range(self.of_feature[feature], end):
                if value > self.limit[k] or (value != value and self.nan_fails[k]):
                    self.reached[self.tree[k]] &= self.left[k]
                elif value == value:
                    break  # the other limits are not less
        for k in range(len(self.first)):
            self.scores[k] = self.first[k]
        for t in range(len(self.output)):
            lowest = self.reached[t] & (~self.reached[t] + 1)
            place = _PLACES[(lowest * _DE_BRUIJN & _ALL_LEAVES) >> 27]
            self.scores[self.output[t]] += self.leaf[self.leaf_of[t] + place]


class Memory:
    """Memory of what one contact showed: odds of sliding over times, and ratios while it slid.

    What the signs say at one look repeats itself in the next, and a hand that moves much shows much: the
    trees that weigh the memory against the signs have learnt by how much.

    Parameters
    ----------
    base_odds : float
        Log odds of sliding in the data that the signs were learnt on.

    Attributes
    ----------
    row : array of float
        In the order of `MEMORY_NAMES`.
    """

    def __init__(self, base_odds: float) -> None:
        self.base_odds = base_odds
        self.row = zeros(len(MEMORY_NAMES))
        self.times_s = array("d", ODDS_S)
        self.begin_contact()

    def begin_contact(self) -> None:
        """Forget the contact."""
        for k in range(len(self.row)):
            self.row[k] = 0.0
        self.largest = _LEAST_ODDS
        self.filtered = log(_ONSETS / _ENDS)
        self.sliding_part = self.movement = 0.0
        self.slid_log = self.slid_s = 0.0
        self.borne = self.crossing_log = 0.0
        self.since_likely_s = _LONG_S
        self.before_log = log(LEAST_RATIO)
        self.is_likely = False

    def take(self, p: float, ratio: float, step_s: float, kept: float) -> None:
        """Take the probability of sliding by the signs of a look alone, and the ratio.

        Parameters
        ----------
        kept : float
            Part of the load that is left: `kept_load`.
        """
        row, n = self.row, len(self.times_s)
        p = min(max(p, 1e-6), 1.0 - 1e-6)
        log_ratio = log(max(ratio, LEAST_RATIO))
        odds = min(max(log(p / (1.0 - p)) - self.base_odds, _LEAST_ODDS), _MOST_ODDS)
        row[0] = odds
        for k in range(n):
            row[1 + k] += min(1.0, step_s / self.times_s[k]) * (odds - row[1 + k])
        self.largest = max(odds, self.largest - (self.largest - _LEAST_ODDS) * min(1.0, step_s / _PEAK_S))
        before = exp(self.filtered) / (1.0 + exp(self.filtered))
        prior = before * (1.0 - min(1.0, _ENDS * step_s)) + (1.0 - before) * _ONSETS * step_s
        new = _FILTER_PART * odds * step_s / LOOK_S
        self.filtered = min(max(log(prior / (1.0 - prior)) + new, -12.0), 12.0)
        part = min(1.0, step_s / _LONG_S)
        self.sliding_part += part * (p - self.sliding_part)
        self.movement += part * (min(abs(log_ratio - self.before_log) / step_s, 10.0) - self.movement)
        self.before_log = log_ratio
        if p > 0.5:
            if not self.is_likely:
                self.crossing_log = log_ratio
            self.is_likely = True
            self.since_likely_s = 0.0
        else:
            self.since_likely_s += step_s
            if p < 0.25:
                self.is_likely = False
        slides = exp(self.filtered) / (1.0 + exp(self.filtered))
        weight = slides * slides * kept * kept * step_s
        self.slid_s -= self.slid_s * min(1.0, step_s / _BORNE_S)
        self.slid_s += weight
        self.slid_log += weight / max(self.slid_s, 1e-9) * (log_ratio - self.slid_log)
        self.borne -= self.borne * min(1.0, step_s / _BORNE_S)
        if slides < 0.2:
            self.borne = max(self.borne, kept * ratio)
        row[1 + n] = row[2] - row[n]
        row[2 + n] = self.largest
        row[3 + n] = self.filtered
        row[4 + n] = self.sliding_part
        row[5 + n] = self.movement
        row[6 + n] = log_ratio - self.slid_log if self.slid_s > 0.05 else 0.0
        row[7 + n] = min(self.slid_s, 3.0)
        row[8 + n] = log_ratio - log(max(self.borne, LEAST_RATIO))
        row[9 + n] = min(self.since_likely_s, 2.0)
        row[10 + n] = log_ratio - self.crossing_log if self.since_likely_s < 2.0 else 0.0


def kept_load(log_load_change: float) -> float:
    """Return the part of the load that is left, for the change of its logarithm over the last 300 ms.

    While a load is taken away, shear that is left makes a large ratio, on a small part of the contact: it
    says less of friction, and what is borne is compared with the load before.
    """
    return exp(max(min(log_load_change, 0.0), _MOST_UNLOADED))


class FrictionMemory:
    """Friction of what is held, as a normal distribution of its logarithm; it outlives the contact.

    What is told as a slide measures it, and what is borne without a slide is a lower bound. The next contact
    is most likely of the same hand and object.

    Parameters
    ----------
    median, log_sd : float
        Before any contact, as a ratio, and the standard deviation of its logarithm.

    Attributes
    ----------
    log_mean, variance : float
        Mean and variance of the logarithm of friction.
    contact_log_mean, contact_variance : float
        The same when the contact began: trees that have seen the contact know what it has shown since.
    """

    def __init__(self, median: float, log_sd: float) -> None:
        self.expect(median, log_sd)

    def expect(self, median: float, log_sd: float) -> None:
        """Take friction from outside, as a ratio, with the standard deviation of its logarithm."""
        sd = max(log_sd, _LEAST_SD)
        self.log_mean, self.variance, self.most_variance = log(median), sd * sd, sd * sd
        self.begin_contact()

    def begin_contact(self) -> None:
        """Keep what is known before the contact."""
        self.contact_log_mean, self.contact_variance = self.log_mean, self.variance

    def end_contact(self) -> None:
        """Widen what is known: the next contact is another one."""
        self.widen(_CONTACT_SD)

    def widen(self, log_sd: float) -> None:
        """Widen what is known by a standard deviation of the logarithm."""
        self.variance = min(self.variance + log_sd * log_sd, self.most_variance)

    def walk(self, time_s: float) -> None:
        """Let friction change for a time."""
        self.variance = min(self.variance + _WALK_SD * _WALK_SD * time_s, self.most_variance)

    def learn(self, p_sliding: float, ratio: float, kept: float, step_s: float) -> None:
        """Learn from the ratio of a look.

        Parameters
        ----------
        p_sliding : float
            Of the look before, by the posterior. A slide that is no likelier than a rest teaches nothing,
            however long it seems to last.
        kept : float
            Part of the load that is left: `kept_load`.
        """
        log_ratio = log(max(ratio, LEAST_RATIO))
        self.walk(step_s)
        sure = max(2.0 * p_sliding - 1.0, 0.0) * kept
        information = sure * sure * step_s / (_SLIDE_S * _SLIDE_SD * _SLIDE_SD)
        gain = information / (1.0 / self.variance + information)
        self.log_mean += gain * (log_ratio - self.log_mean)
        self.variance = max(self.variance * (1.0 - gain), min(self.variance, _LEAST_SD * _LEAST_SD))
        if p_sliding < 0.5:
            self.log_mean = max(self.log_mean, log_ratio + log(kept))


class SlipHysteresis:
    """Open and close the slips of one contact.

    A slip opens at a probability and closes when that was below a third of it for 150 ms.

    Parameters
    ----------
    incipient_p, gross_p : float
        Probabilities that a tenth of the area slips, or all of it, from which a slip is open.
    """

    def __init__(self, incipient_p: float, gross_p: float, look_s: float) -> None:
        self.incipient_p, self.gross_p = incipient_p, gross_p
        self.n_off = max(1, round(_OFF_S / look_s))
        self.n_settle = round(DIRECTION_S / look_s)
        self.begin()

    def begin(self, *, is_seen: bool = True) -> None:
        """Begin a contact: one that was seen to begin had no shear before."""
        self.is_open = self.is_gross = False
        self.n_low = self.n_looks = 0
        self.least, self.ratio = 0.0 if is_seen else _INFINITE, _INFINITE

    @property
    def kind(self) -> str:
        """Kind of the slip that is open; empty for none."""
        return "gross" if self.is_gross else "incipient" if self.is_open else ""

    def settle(self) -> None:
        """Let no slip open or close for some looks; then an incipient one needs a ratio that has grown since.

        Where taxels are lost, the ratio changes, and what was seen of it before was in part their fault.
        """
        self.least, self.n_looks = _INFINITE, 0

    def close(self) -> None:
        """Close the slip, and let none open for some looks."""
        if self.is_open:
            self.least = self.ratio
        self.is_open = self.is_gross = False
        self.n_low = self.n_looks = 0

    def look(self, p_incipient: float, p_sliding: float, ratio: float, ratio_sd: float) -> None:
        """Take the posterior of a look, and the ratio of shear and load with the sd of its noise."""
        self.n_looks += 1
        self.ratio = ratio
        self.least = min(self.least, ratio)
        if self.n_looks <= self.n_settle:
            return
        if not self.is_gross and p_sliding >= self.gross_p:
            self.is_open = self.is_gross = True
            self.n_low = 0
        elif self.is_open:
            p = p_sliding if self.is_gross else p_incipient
            low = _OFF * (self.gross_p if self.is_gross else self.incipient_p)
            self.n_low = self.n_low + 1 if p < low else 0
            if self.n_low >= self.n_off or p < min(low, _SURELY_OVER):
                self.is_open = self.is_gross = False
                self.least = ratio
        elif p_incipient >= self.incipient_p and ratio >= _GROWN * self.least + _SURELY * ratio_sd:
            self.is_open = True
            self.n_low = 0


class Posterior:
    """Posterior of the states of one contact.

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
        for k in range(len(self.cells)):
            self.cells[k] = 1.0 / len(self.cells)
        self.soon = self.utilisation = self.friction = (0.0, 0.0, 0.0)
        self.p_sliding = self.slipping_share = 0.0

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
        log_ratio = log(max(ratio, _LEAST_BORNE))
        here = variance + _CONTACT_SD * _CONTACT_SD
        learnt = FRICTION_LOG_SD * FRICTION_LOG_SD + _CONTACT_SD * _CONTACT_SD
        no_zero = 0.0 if was_seen else _WITHOUT_ZERO
        total = 0.0
        for k in range(n):
            p = exp((scores[k] if k < n - 1 else sliding) - most)
            friction = log_ratio - log(self.middles[k])
            off, off_learnt = friction - log_friction, friction - _LOG_FRICTION
            misfit = off * off / here
            fits = sqrt(learnt / here) * exp(0.5 * (off_learnt * off_learnt / learnt - misfit))
            fits = no_zero + (1.0 - no_zero) * fits
            if misfit > _PLAUSIBLE_SDS * _PLAUSIBLE_SDS:
                fits *= exp(-0.5 * (misfit - _PLAUSIBLE_SDS * _PLAUSIBLE_SDS))
            p *= _UNTOLD + (1.0 - _UNTOLD) * fits
            self.cells[k] = p
            total += p
        is_over = self.is_gross and self.cells[n - 1] < _SURELY_OVER * total
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
        if ratio > _LEAST_BORNE:  # the ratio over utilisation, unless the memory knows more
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


class ContactFilter:
    """Filter of one contact after the other.

    Parameters
    ----------
    signs : Signs
        Signs of the taxels, at `look_s` of the same scan rate.
    friction, log_sd : float
        Median of friction before any contact, in units of the readings, and sd of its logarithm.
    incipient_p, gross_p : float
        Probabilities from which a slip is open; it closes below a third of them.
    radius_mm : float
        Mean distance of the taxels from their centre.

    Attributes
    ----------
    hysteresis : SlipHysteresis
        Slips at these two probabilities, which what is published follows.
    is_begun : bool
        The contact has a look: its load was large enough to tell.
    is_look : bool
        The newest scan completed a look.
    is_known : bool
        The zero of the shear was known at a look, or a slide was seen.
    slid_at : float
        Largest ratio since the gross slip opened that is open; 0.0 without one. A hand that grips harder
        lowers the ratio of a slide: friction is what the slide bore.
    rippled_s : float
        Length of the window in which a ripple travels over the taxels; 0.0 where none does.
    zero_sd : float
        Standard deviation of shear over load by what is not known of the zero of the shear.
    total_x, total_y, moment, load : float
        Sums of the newest scan.
    prior_p : float
        Probability that all of the contact slides, where there is no sign of it or against it.
    friction : tuple of 3 floats
        Quantiles of 5, 50 and 95 %, as they are published, in units of the readings.
    p_gross : tuple of 3 floats
        Probability that gross slip begins within `HORIZONS_S`, if the contact does not slide yet; 1 while a
        gross slip is open.
    """

    def __init__(
        self,
        signs: "Signs",
        learnt: "Learnt",
        rate_hz: float,
        friction: float,
        log_sd: float,
        incipient_p: float,
        gross_p: float,
        radius_mm: float = 1.0,
        unit: Literal["N", "relative"] = "relative",
    ) -> None:
        self.signs, self.radius_mm, self.unit = signs, radius_mm, unit
        self.per_friction = signs.shear_per_friction
        self.n_look, self.look_s = scans_of_look(rate_hz), signs.look_s
        self.growth_s = signs.n_growth * self.look_s
        self.sign_trees, self.state_trees, self.soon_trees = learnt.signs, learnt.state, learnt.soon
        self.base_odds = learnt.base_odds
        self.prior_p = 1.0 / (1.0 + exp(-self.base_odds))
        self.memory = Memory(self.base_odds)
        self.friction_memory = FrictionMemory(friction / self.per_friction, log_sd)
        self.posterior = Posterior(self.look_s)
        self.hysteresis = SlipHysteresis(incipient_p, gross_p, self.look_s)
        self.columns = array("q", [NAMES.index(name) for name in STATE_SIGNS])
        self.row = zeros(len(STATE_SIGNS) + len(MEMORY_NAMES))
        # Each access to an array of a compiled class makes a view, which takes a microsecond.
        self.sign_row, self.over_load = signs.row, signs.over_load
        self.n_kept = max(2, round(HISTORY_S * rate_hz))
        self.past = zeros(self.n_kept * (5 + len(self.over_load)))
        self.begin(is_seen=True)

    def begin(self, *, is_seen: bool) -> None:
        """Begin a contact, whose touch was seen or not."""
        self.signs.begin(is_seen=is_seen)
        self.memory.begin_contact()
        self.friction_memory.begin_contact()
        self.posterior.begin()
        self.hysteresis.begin(is_seen=is_seen)
        self.is_known = is_seen
        self.is_begun = self.is_look = False
        self.n_past = self.newest = 0
        self.ratio = self.slid_at = self.rippled_s = self.zero_sd = 0.0
        self.weigh(0.0, 0.0, 0.0, 0.0)
        self.publish()

    def restart(self) -> None:
        """Begin windows anew, after a gap in which the contact went on."""
        self.signs.restart()
        self.posterior.is_begun = False
        self.hysteresis.close()
        self.publish()

    def weigh(self, total_x: float, total_y: float, moment: float, load: float) -> None:
        """Set the sums of the newest scan."""
        self.total_x, self.total_y, self.moment, self.load = total_x, total_y, moment, max(load, 1e-9)

    def take(
        self,
        time_s: float,
        reading: FloatArray,
        zero: FloatArray,
        noise: float,
        acceleration: float,
        was_seen: bool,
        rippled_s: float,
        touches: bool,
    ) -> None:
        """Take a scan; each look of 20 ms, the first scan of a contact among them, changes the posterior.

        Parameters
        ----------
        reading : (3 * taxels,) float64
            Loads, shears along x and shears along y.
        zero : (2 * taxels,) float64
            Shear that pressing alone makes, over the load.
        noise : float
            Standard deviation of a taxel's shear in one scan, in units of the readings.
        acceleration : float
            Of the hand, as announced, m/s^2; NaN where it is not.
        was_seen : bool
            The contact was seen to begin, or most of its load to come, so that its zero of shear is known.
        rippled_s : float
            Length of the window in which a ripple travels over the taxels: proof of sliding (`travelling`).
        touches : bool
            The contact gate sees a contact; without one, no slip is open, and friction is not learnt.
        """
        signs = self.signs
        signs.take(reading, zero)
        self.rippled_s = rippled_s
        self.is_look = not self.is_begun or signs.n_scans >= self.n_look
        if self.is_look:
            self.look(noise, acceleration, was_seen, touches)
        if not touches:
            self.hysteresis.close()
        if self.is_look or not touches:
            self.publish()
        self.is_begun = True
        self.weigh(signs.total_x, signs.total_y, signs.moment, signs.total_load)
        if touches:
            self._keep(time_s)

    def look(self, noise: float, acceleration: float, was_seen: bool, touches: bool) -> None:
        """Look at the scans that `signs` has taken; parameters as in `take`."""
        signs, friction, ripple_travels = self.signs, self.friction_memory, self.rippled_s > 0.0
        signs.look(noise, acceleration)
        self.ratio = signs.ratio
        self.sign_trees.evaluate(self.sign_row)
        p = 1.0 / (1.0 + exp(-min(max(self.sign_trees.scores[0], -30.0), 30.0)))
        p = max(p, RIPPLE_P) if ripple_travels else p
        kept = kept_load(self.sign_row[LOAD_CHANGE])
        if was_seen and touches:  # what the gate takes for noise tells nothing of friction
            friction.learn(self.p_sliding_now, self.ratio, kept, self.look_s)
        self.memory.take(p, self.ratio, self.look_s, kept)
        n = len(self.columns)
        for k in range(n):
            self.row[k] = self.sign_row[self.columns[k]]
        for k in range(len(self.memory.row)):
            self.row[n + k] = self.memory.row[k]
        self.state_trees.evaluate(self.row)
        self.soon_trees.evaluate(self.row)
        self.posterior.take(
            self.state_trees.scores,
            self.soon_trees.scores,
            self.base_odds + self.memory.row[0],
            self.ratio,
            friction.contact_log_mean,
            friction.contact_variance,
            was_seen,
            ripple_travels,
        )
        self.hysteresis.look(self.p_incipient, self.p_sliding_now, self.ratio, self.ratio_sd)
        self.is_known = self.is_known or was_seen or self.hysteresis.is_gross
        self.slid_at = max(self.slid_at, self.ratio) if self.hysteresis.is_gross else 0.0

    def publish(self) -> None:
        """Fill in the posterior as it is published."""
        posterior, slips, friction = self.posterior, self.hysteresis, self.friction_memory
        posterior.publish(
            slips.is_gross, _OFF * slips.gross_p, self.ratio, friction.log_mean, friction.variance
        )
        if slips.is_gross:
            slid_at = self.per_friction * max(self.slid_at, _LEAST_BORNE)
            self.friction = LEAST_GROSS_USED * slid_at, slid_at, slid_at / LEAST_GROSS_USED
            self.p_gross = 1.0, 1.0, 1.0
        else:
            self.friction = self.friction_now
            self.p_gross = posterior.soon

    def _keep(self, time_s: float) -> None:
        """Keep the scan for the beginning of a slip."""
        width = 5 + len(self.over_load)
        self.newest = self.newest + 1 if self.newest + 1 < self.n_kept else 0
        self.n_past = min(self.n_past + 1, self.n_kept)
        at = self.newest * width
        self.past[at], self.past[at + 1] = time_s, self.p_sliding_now
        self.past[at + 2] = self.total_x / self.load
        self.past[at + 3] = self.total_y / self.load
        self.past[at + 4] = self.moment / self.load
        for k in range(width - 5):
            self.past[at + 5 + k] = self.over_load[k]

    def forget_past(self) -> None:
        """Forget all scans but the newest one: how shear came to what it is was another slip."""
        self.n_past = min(self.n_past, 1)

    def kept_scans(self) -> FloatArray:
        """Return the scans of the last second, the newest one last, as a table.

        Its columns are time, probability of sliding, ratio of total shear and load along x and y and of the
        moment, and the shears of the taxels along x, then along y, over the total load.
        """
        rows = (np.arange(self.newest - self.n_past, self.newest) + 1) % self.n_kept
        return np.asarray(np.asarray(self.past).reshape(self.n_kept, -1)[rows])

    def event(self, time_s: float, is_trusted: bool, is_late: bool) -> GripEvent:
        """Return the event of the newest scan."""
        low, median, high = self.posterior.utilisation
        friction_low, friction, friction_high = self.friction
        in_50, in_100, in_300 = self.p_gross
        share, is_known = self.posterior.slipping_share, self.is_known and self.is_begun
        state: GripState = "unknown"
        if not is_known:  # it may hold or slide, with any shear: nothing is in use for sure, nor free
            low, median, high = 0.0, 0.5, 1.0
            if self.hysteresis.is_open:
                state, low = "partial", INCIPIENT_USED
        elif self.hysteresis.is_gross:
            state = "gross"
        elif self.hysteresis.is_open:
            state = "partial"
            median, high = max(median, INCIPIENT_USED), max(high, INCIPIENT_USED)
        elif self.signs.growth < -_SURELY_FALLS * (sqrt(2.0) * self.ratio_sd / self.growth_s):
            state = "unloading"
        else:
            state = "partial" if share > INCIPIENT_SHARE else "sticking"
        # What is not known of the zero is more shear that may be borne.
        size = hypot(self.total_x, self.total_y, self.moment) + FIVE_PERCENT * self.zero_sd * self.load
        needed_load = size / (NEEDED_UTILISATION * friction_low)
        return GripEvent(
            time_s=time_s,
            utilisation=median,
            utilisation_low=low,
            utilisation_high=high,
            friction=friction,
            friction_low=friction_low,
            friction_high=friction_high,
            slipping_share=share,
            p_sliding=self.posterior.p_sliding,
            p_gross_50ms=in_50,
            p_gross_100ms=in_100,
            p_gross_300ms=in_300,
            load=self.load,
            shear_x=self.total_x,
            shear_y=self.total_y,
            torsion=self.moment * self.radius_mm + 0.0,  # never -0.0
            unit=self.unit,
            needed_load=needed_load if is_known else max(needed_load, self.load),
            state=state,
            valid=is_trusted and self.is_begun,
            late=is_late,
        )

    @property
    def p_sliding_now(self) -> float:
        """Probability that all of the contact slides, whichever slip is open."""
        return self.posterior.cells[N_STATES - 1]

    @property
    def p_incipient(self) -> float:
        """Probability that a tenth of its area or more slips."""
        return 1.0 - self.posterior.cells[0]

    @property
    def friction_now(self) -> tuple[float, float, float]:
        """Quantiles of friction of 5, 50 and 95 %, in units of the readings, whichever slip is open."""
        low, median, high = self.posterior.friction
        return self.per_friction * low, self.per_friction * median, self.per_friction * high

    @property
    def ratio_sd(self) -> float:
        """Standard deviation of the ratio of a look by the noise of its readings, in units of friction."""
        return self.signs.ratio_noise / self.per_friction / sqrt(self.n_look)

    @property
    def size(self) -> float:
        """Ratio of the newest scan: by the ellipsoid of Howe and Cutkosky (1996), compared with friction."""
        return hypot(self.total_x / self.load, self.total_y / self.load, self.moment / self.load)


def scans_of_look(rate_hz: float) -> int:
    """Return the number of scans of a look."""
    return max(1, round(LOOK_S * rate_hz))

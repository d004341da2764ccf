"""Memory of what one contact showed: odds of sliding over times, and ratios while it slid.

The file is plain Python, which Cython compiles with the types of `memory.pxd` (`tactiled.compiled`).
"""

from array import array
from math import exp, log

from tactiled.detect.contact.signs import LEAST_RATIO, LOOK_S
from tactiled.detect.signal.front_end import zeros

ODDS_S = (0.1, 0.4, 1.6, 6.0)  # choice: averaging times of the odds, each four times the one before
MEMORY_NAMES: tuple[str, ...] = (
    "odds",
    *(f"odds_{1000 * time_s:.0f}ms" for time_s in ODDS_S),
    *("odds_above_usual", "odds_largest", "filtered_odds", "part_sliding_10s", "movement_10s"),
    *("log_ratio_of_slid", "slid_s", "log_ratio_of_borne", "since_likely_s", "log_ratio_of_crossing"),
)
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
_MOST_UNLOADED = -5.0  # choice: log of the load over that of 300 ms before: less is no load


class Memory:
    """Odds and ratios of one contact so far.

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

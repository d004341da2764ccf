"""Memory of what a contact showed: odds of sliding over times, ratios while it slid, and friction.

What the signs say at one look repeats itself in the next, and a hand that moves much shows much: the trees
that weigh the memory against the signs have learnt by how much (`filter`). Friction outlives the contact:
the next one is most likely of the same hand and object.
"""

from array import array
from math import exp, log, sqrt

ODDS_S = (0.1, 0.4, 1.6, 6.0)  # choice: averaging times of the odds, each four times the one before
NAMES: tuple[str, ...] = (
    "odds",
    *(f"odds_{1000 * time_s:.0f}ms" for time_s in ODDS_S),
    *("odds_above_usual", "odds_largest", "filtered_odds", "part_sliding_10s", "movement_10s"),
    *("log_ratio_of_slid", "slid_s", "log_ratio_of_borne", "since_likely_s", "log_ratio_of_crossing"),
    *("log_ratio_of_friction", "log_friction_sd"),
)
_MOST_ODDS, _LEAST_ODDS = 5.0, -4.0  # choice: one look is never surer than 1 in 150
_LONG_S = 10.0  # choice: in which the hand's own habits show
_PEAK_S = 1.0  # choice: decay of the largest odds
_SLID_S = 20.0  # prior: for which a slide tells the ratio that friction bears
_BORNE_S = 20.0  # prior: for which a ratio that was borne without a slide does
_LEAST_RATIO = 0.01  # derived: below it the logarithm of a ratio is that of noise
# prior: rates of a filter with two states, 1/s: a prior of everyday hands, whose slips are seconds apart and
# short.
_ONSETS, _ENDS = 0.05, 1.0
# prior: of the odds of a look of 20 ms that is new: readings of neighbouring looks are alike
_FILTER_PART = 0.15
_LOOK_S = 0.02  # derived: that of `signs`
_MOST_UNLOADED = -5.0  # choice: log of the load over that of 300 ms before: less is no load
# physical: friction. Kinetic friction of a slide scatters by 0.12 in log for each 0.3 s of travel over other
# places.
_SLIDE_SD, _SLIDE_S = 0.12, 0.3
_WALK_SD = 0.03  # prior: of log friction in a second: warming, moisture, wear of what is held
# prior: of log friction from one contact with an object to the next: place and pressure differ
_CONTACT_SD = 0.15
_LEAST_SD = 0.07  # prior: friction that depends on load, speed and age is not known better by one number


class Memory:
    """Memory of one contact after the other.

    Parameters
    ----------
    friction, log_sd : float
        Median of friction before any contact, as a ratio, and the standard deviation of its logarithm.
    base_odds : float
        Log odds of sliding in the data that the signs were learnt on.

    Attributes
    ----------
    row : array of float
        In the order of `NAMES`.
    log_friction, variance : float
        Mean and variance of the logarithm of friction.
    """

    def __init__(self, friction: float, log_sd: float, base_odds: float) -> None:
        self.base_odds = base_odds
        self.row = array("d", bytes(8 * len(NAMES)))
        self.means = array("d", bytes(8 * len(ODDS_S)))
        self.times_s = array("d", ODDS_S)
        self.expect(friction, log_sd)
        self.begin_contact()

    def forget_object(self) -> None:
        """Forget friction: another object is held, or the skin was changed."""
        self.log_friction, self.variance = self.first_log, self.first_variance

    def expect(self, friction: float, log_sd: float) -> None:
        """Take friction from outside, as a ratio, with the standard deviation of its logarithm."""
        self.first_log, self.first_variance = log(friction), max(log_sd, _LEAST_SD) * max(log_sd, _LEAST_SD)
        self.forget_object()

    def widen(self, log_sd: float) -> None:
        """Widen what is known of friction by a standard deviation of its logarithm."""
        self.variance = min(self.variance + log_sd * log_sd, self.first_variance)

    def walk(self, time_s: float) -> None:
        """Let friction change for a time."""
        self.variance = min(self.variance + _WALK_SD * _WALK_SD * time_s, self.first_variance)

    def begin_contact(self) -> None:
        """Forget all of the contact but friction."""
        for k in range(len(self.times_s)):
            self.means[k] = 0.0
        self.largest = _LEAST_ODDS
        self.filtered = log(_ONSETS / _ENDS)
        self.sliding_part = self.movement = 0.0
        self.slid_log = self.slid_s = 0.0
        self.borne = self.crossing_log = 0.0
        self.since_likely_s = _LONG_S
        self.before_log = log(_LEAST_RATIO)
        self.n = 0
        self.is_likely = 0

    def end_contact(self) -> None:
        """Widen what is known of friction: the next contact is another one."""
        self.variance = min(self.variance + _CONTACT_SD * _CONTACT_SD, self.first_variance)

    def take(self, p: float, ratio: float, step_s: float, log_load_change: float = 0.0) -> None:
        """Take the probability of sliding by the signs of a look alone, and the ratio.

        While a load is taken away, shear that is left makes a large ratio, on a small part of the contact: it
        says less of friction, and what is borne is compared with the load before.

        Parameters
        ----------
        step_s : float
            Time since the last look.
        log_load_change : float
            Change of the logarithm of the load over the last 300 ms.
        """
        kept = exp(max(min(log_load_change, 0.0), _MOST_UNLOADED))
        p = min(max(p, 1e-6), 1.0 - 1e-6)
        log_ratio = log(max(ratio, _LEAST_RATIO))
        odds = min(max(log(p / (1.0 - p)) - self.base_odds, _LEAST_ODDS), _MOST_ODDS)
        self.n += 1
        for k in range(len(self.times_s)):
            self.means[k] += min(1.0, step_s / self.times_s[k]) * (odds - self.means[k])
        self.largest = max(odds, self.largest - (self.largest - _LEAST_ODDS) * min(1.0, step_s / _PEAK_S))
        before = exp(self.filtered) / (1.0 + exp(self.filtered))
        prior = before * (1.0 - min(1.0, _ENDS * step_s)) + (1.0 - before) * _ONSETS * step_s
        new = _FILTER_PART * odds * step_s / _LOOK_S
        self.filtered = min(max(log(prior / (1.0 - prior)) + new, -12.0), 12.0)
        part = min(1.0, step_s / _LONG_S)
        self.sliding_part += part * (p - self.sliding_part)
        self.movement += part * (min(abs(log_ratio - self.before_log) / step_s, 10.0) - self.movement)
        self.before_log = log_ratio
        if p > 0.5:
            if self.is_likely == 0:
                self.crossing_log = log_ratio
            self.is_likely = 1
            self.since_likely_s = 0.0
        else:
            self.since_likely_s += step_s
            if p < 0.25:
                self.is_likely = 0
        slides = exp(self.filtered) / (1.0 + exp(self.filtered))
        weight = slides * slides * kept * kept * step_s
        self.slid_s -= self.slid_s * min(1.0, step_s / _SLID_S)
        self.slid_s += weight
        self.slid_log += weight / max(self.slid_s, 1e-9) * (log_ratio - self.slid_log)
        self.borne -= self.borne * min(1.0, step_s / _BORNE_S)
        if slides < 0.2:
            self.borne = max(self.borne, kept * ratio)
        self._learn_friction(slides, log_ratio, kept, step_s)
        self._fill(odds, log_ratio)

    def _learn_friction(self, slides: float, log_ratio: float, kept: float, step_s: float) -> None:
        """Let friction walk; a slide measures it, and what is borne without a slide is a lower bound."""
        self.walk(step_s)
        information = slides * slides * kept * kept * step_s / _SLIDE_S / (_SLIDE_SD * _SLIDE_SD)
        gain = information / (1.0 / self.variance + information)
        self.log_friction += gain * (log_ratio - self.log_friction)
        self.variance = max(self.variance * (1.0 - gain), min(self.variance, _LEAST_SD * _LEAST_SD))
        bears = log_ratio + log(kept)
        if slides < 0.5 and bears > self.log_friction:
            self.log_friction = bears

    def _fill(self, odds: float, log_ratio: float) -> None:
        row, n = self.row, len(self.times_s)
        row[0] = odds
        for k in range(n):
            row[1 + k] = self.means[k]
        row[1 + n] = self.means[1] - self.means[n - 1]
        row[2 + n] = self.largest
        row[3 + n] = self.filtered
        row[4 + n] = self.sliding_part
        row[5 + n] = self.movement
        row[6 + n] = log_ratio - self.slid_log if self.slid_s > 0.05 else 0.0
        row[7 + n] = min(self.slid_s, 3.0)
        row[8 + n] = log_ratio - log(max(self.borne, _LEAST_RATIO))
        row[9 + n] = min(self.since_likely_s, 2.0)
        row[10 + n] = log_ratio - self.crossing_log if self.since_likely_s < 2.0 else 0.0
        row[11 + n] = log_ratio - self.log_friction
        row[12 + n] = sqrt(self.variance)

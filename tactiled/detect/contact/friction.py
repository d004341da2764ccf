"""Friction of what is held, which outlives the contact.

The file is plain Python, which Cython compiles with the types of `friction.pxd` (`tactiled.compiled`).
"""

from math import hypot, log

from tactiled.array import Array
from tactiled.detect.contact.signs import LEAST_RATIO

# physical: friction of rubber on objects, its median and the standard deviation of its logarithm: between 0.2
# (wet, oily) and 2 (clean glass), and gains of uncalibrated shear add 0.3. It is the prior of the worlds that
# the trees learnt from, too.
FRICTION, FRICTION_LOG_SD = 0.6, 0.6
# prior: of the logarithm of the reading of shear over that of the load where both forces are equal, of chips
# in counts whose array states no `shear_per_friction`: a magnetic skin of others (uSkin) has a fifth of what
# is assumed, which are two standard deviations
SCALE_LOG_SD = 0.8
# prior: of log friction from one contact with an object to the next, and of what a state implies of it in one
# contact: place and pressure differ
CONTACT_LOG_SD = 0.15
# physical: friction. Kinetic friction of a slide scatters by 0.12 in log for each 0.3 s of travel over other
# places.
_SLIDE_SD, _SLIDE_S = 0.12, 0.3
_WALK_SD = 0.03  # prior: of log friction in a second: warming, moisture, wear of what is held
_LEAST_SD = 0.07  # prior: friction that depends on load, speed and age is not known better by one number


def prior_log_sd(array: Array) -> float:
    """Return the standard deviation of log friction before any contact with an array."""
    return FRICTION_LOG_SD if array.is_shear_scaled else hypot(FRICTION_LOG_SD, SCALE_LOG_SD)


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
        self.widen(CONTACT_LOG_SD)

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

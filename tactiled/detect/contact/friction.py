"""Friction of the object that is held, as a normal distribution of its logarithm; it outlives the contact.

What is told as a slide measures it, and what is borne without a slide is a lower bound. A rest of a minute
whose signs are doubtful teaches nothing. The next contact is most likely of the same hand and object.
"""

from math import exp, log

# physical: friction. Kinetic friction of a slide scatters by 0.12 in log for each 0.3 s of travel over other
# places.
_SLIDE_SD, _SLIDE_S = 0.12, 0.3
_WALK_SD = 0.03  # prior: of log friction in a second: warming, moisture, wear of what is held
# prior: of log friction from one contact with an object to the next: place and pressure differ
_CONTACT_SD = 0.15
_LEAST_SD = 0.07  # prior: friction that depends on load, speed and age is not known better by one number
_LEAST_RATIO = 0.01  # derived: below it the logarithm of a ratio is that of noise
_MOST_UNLOADED = -5.0  # choice: log of the load over that of 300 ms before: less is no load


def kept_load(log_load_change: float) -> float:
    """Return the part of the load that is left, for the change of its logarithm over the last 300 ms.

    While a load is taken away, shear that is left makes a large ratio, on a small part of the contact: it
    says less of friction, and what is borne is compared with the load before.
    """
    return exp(max(min(log_load_change, 0.0), _MOST_UNLOADED))


class FrictionMemory:
    """Friction of one contact after the other.

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
        self.log_mean, self.variance, self._most_variance = log(median), sd * sd, sd * sd
        self.begin_contact()

    def begin_contact(self) -> None:
        """Keep what is known before the contact."""
        self.contact_log_mean, self.contact_variance = self.log_mean, self.variance

    def end_contact(self) -> None:
        """Widen what is known: the next contact is another one."""
        self.widen(_CONTACT_SD)

    def widen(self, log_sd: float) -> None:
        """Widen what is known by a standard deviation of the logarithm."""
        self.variance = min(self.variance + log_sd * log_sd, self._most_variance)

    def walk(self, time_s: float) -> None:
        """Let friction change for a time."""
        self.variance = min(self.variance + _WALK_SD * _WALK_SD * time_s, self._most_variance)

    def learn(self, p_sliding: float, ratio: float, kept: float, step_s: float) -> None:
        """Learn from the ratio of a look.

        Parameters
        ----------
        p_sliding : float
            Of the look before, by the posterior. A slide that is no likelier than a rest teaches nothing.
        kept : float
            Part of the load that is left: `kept_load`.
        """
        log_ratio = log(max(ratio, _LEAST_RATIO))
        self.walk(step_s)
        sure = max(2.0 * p_sliding - 1.0, 0.0) * kept
        information = sure * sure * step_s / (_SLIDE_S * _SLIDE_SD * _SLIDE_SD)
        gain = information / (1.0 / self.variance + information)
        self.log_mean += gain * (log_ratio - self.log_mean)
        self.variance = max(self.variance * (1.0 - gain), min(self.variance, _LEAST_SD * _LEAST_SD))
        if p_sliding < 0.5:
            self.log_mean = max(self.log_mean, log_ratio + log(kept))

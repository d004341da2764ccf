"""Evidence for sliding from how fast and in which course the ratio of shear to load grew before it stayed.

A ratio stays where friction is met, or where the hand stops. Three things tell them apart, at any noise:

* A contact that slides stays where its limit is, and a hand may stop anywhere: that the ratio stays just at
  the limit of a friction value is a coincidence where that value sticks, and certain where it slides.
* A contact that is moved comes to its limit in a travel of tenths of a millimetre, often within some
  hundredths of a second; a hand takes longer to change what it bears. The fastest voluntary changes of force
  last 0.1 s from beginning to end (Freund and Buedingen, Exp. Brain Res. 31, 1978).
* At even speed the ratio rises by Mindlin's curve, ``1 - (1 - x)^(3/2)``: it is slow near the limit. A load
  that is laid on comes evenly and stops; a hand that sets its force ends by minimum jerk (Flash and Hogan,
  J. Neurosci. 5, 1985), which is slower yet.

Each growth counts once. How long a slide goes on is for `friction` to say.
"""

import collections
import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.friction import SOFT

_HISTORY_S = 1.0  # a growth from half of the ratio that takes longer says nothing
# Stops of a hand in one e-fold of the ratio, a prior: forces are set on a logarithmic scale (Weber), and a
# hand that has doubled the ratio goes on by two thirds in the mean. 1 and 2 give the same reports at
# thresholds of `gross_p` that differ by a third.
_HAND_STOPS = 2.0
_STAYS_AT = -math.log(_HAND_STOPS * SOFT)  # log odds of a ratio that stays where a limit is met
# Lognormal prior of the time in which a hand brings the ratio from half to 0.95 of where it stays.
_HAND_S, _HAND_LOG_SD = 0.12, 1.0
_RARE = 1e-3  # least probability of a hand that fast: impacts
_HALF, _SLOWS, _NEARLY, _STAYS = 0.5, 0.9, 0.95, 0.98  # parts of the ratio that stays
# Logarithm of the time from 0.9 to 0.98 of the ratio over a fifth of that from 0.5 to 0.9, which are equal
# where it grows evenly: mean and standard deviation of a slide, of an even growth, of one by minimum jerk.
_SLIDE, _EVEN, _SMOOTH = (0.53, 0.4), (0.0, 0.2), (1.03, 0.4)
_OTHER = 0.02  # density of any other course
_FEW = 3  # scans, below which a course has no shape
_LEAST = 0.05  # ratio, below which offsets grow and fall
_NOISY = 0.05  # of the ratio: with more noise, the times are not known
# A ratio that was larger by twice this part has turned, as in a swing; noise counts up to so many deviations.
_TURN, _NOISES = 0.01, 3.0


class GrowthEvidence:
    """Course of the ratio in one contact."""

    def __init__(self) -> None:
        self._sizes: collections.deque[float] = collections.deque()
        self._n = 0  # scans so far
        self._taken = 0.0  # log odds of the growth that was taken last
        self._taken_at = -1  # scan at which it was taken first

    def take(self, size: float, step_s: float) -> None:
        """Take the ratio of a scan."""
        self._n += 1
        self._sizes.append(size)
        if len(self._sizes) > _HISTORY_S / step_s:
            self._sizes.popleft()

    def log_odds(self, size_sd: float, step_s: float) -> float:
        """Return the log likelihood ratio of sliding over sticking that is new since this was asked before.

        Parameters
        ----------
        size_sd : float
            Noise of a ratio.
        step_s : float
            Time between scans.
        """
        if not self._sizes:  # scans are further apart than what is remembered
            return 0.0
        sizes = np.array(self._sizes)
        level = float(sizes[-2:].mean())
        below = np.flatnonzero(sizes < _HALF * level)
        if level < max(_LEAST, size_sd / _NOISY) or not len(below):
            return 0.0
        found = _of_growth(sizes[below[-1] :], level, size_sd, step_s)
        if found is None:
            return 0.0
        began = self._n - len(sizes) + int(below[-1])
        if began >= self._taken_at:
            self._taken, self._taken_at = 0.0, self._n
        new, self._taken = found - self._taken, found
        return new


def _of_growth(rise: FloatArray, level: float, size_sd: float, step_s: float) -> float | None:
    """Return the log odds of a growth (n,) from half of the level; None while the ratio does not stay."""
    half, slows, nearly, stays = (step_s * _crossing(rise, part * level) for part in _PARTS)
    stayed_s = step_s * (len(rise) - 1) - nearly
    took_s = max(nearly - half, step_s)
    # Averaged over so many scans that noise is no turn; the ratio must have stayed for as long.
    noise = _NOISES * size_sd / (_TURN * level)
    n = max(1, math.ceil(noise * noise))
    if stayed_s < max(took_s, max(2, n) * step_s):
        return None
    total = np.append(0.0, np.add.accumulate(rise))
    averaged = (total[n:] - total[:-n]) / n
    fell = max(averaged.max() - averaged[-1] - _TURN * level, rise.max() - level - _NOISES * size_sd)
    if fell > _TURN * level:
        return None
    z = math.log(took_s / _HAND_S) / _HAND_LOG_SD
    found = _STAYS_AT - math.log(max(0.5 * (1.0 + math.erf(z / math.sqrt(2.0))), _RARE))
    if slows - half >= _FEW * step_s:
        course = math.log(max(stays - slows, 0.5 * step_s) / (0.2 * (slows - half)))
        holds = 0.5 * (_density(course, *_EVEN) + _density(course, *_SMOOTH))
        found += math.log((_density(course, *_SLIDE) + _OTHER) / (holds + _OTHER))
    return found


_PARTS = (_HALF, _SLOWS, _NEARLY, _STAYS)


def _crossing(rise: FloatArray, value: float) -> float:
    """Return the scan, between two, at which a growth (n,) first comes to a value; its end if it does not."""
    reached = rise >= value
    k = int(np.argmax(reached))
    if not reached[k]:
        return float(len(rise) - 1)
    return k - 1 + float((value - rise[k - 1]) / (rise[k] - rise[k - 1])) if k else 0.0


def _density(value: float, mean: float, sd: float) -> float:
    """Return a normal density, up to the factor that all have."""
    return math.exp(-0.5 * ((value - mean) / sd) ** 2) / sd


def growth_numbers() -> FloatArray:
    """Return the constants of `GrowthEvidence` in the order of `struct growth_numbers`."""
    looks = _LEAST, _NOISY, _TURN, _NOISES, _FEW
    hand = _HAND_S, _HAND_LOG_SD, _RARE
    return np.array([_HISTORY_S, *_PARTS, *looks, *hand, *_SLIDE, *_EVEN, *_SMOOTH, _OTHER, _STAYS_AT])

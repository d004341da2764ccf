"""Evidence for sliding from how fast and in which course the ratio of shear to load grew before it stayed.

A ratio stays where friction is met, or where the hand stops. Two things tell them apart, at any noise:

* A contact that is moved comes to its limit in a travel of tenths of a millimetre, often within some
  hundredths of a second; a hand takes longer to change what it bears. The fastest voluntary changes of force
  last 0.1 s from beginning to end (Freund and Buedingen, Exp. Brain Res. 31, 1978).
* At even speed the ratio rises by Mindlin's curve, ``1 - (1 - x)^(3/2)``: it is slow near the limit. A load
  that is laid on comes evenly and stops; a hand that sets its force ends by minimum jerk (Flash and Hogan,
  J. Neurosci. 5, 1985), which is slower yet.

The evidence fades, since a slide is over some time and the ratio stays nevertheless.
"""

import collections
import math

import numpy as np

from tactiled.array import FloatArray

_HISTORY_S = 1.0  # a growth from half of the ratio that takes longer says nothing
# Lognormal prior of the time in which a hand brings the ratio from half to 0.95 of where it stays.
_HAND_S, _HAND_LOG_SD = 0.12, 1.0
_RARE = 1e-3  # least probability of a hand that fast: impacts
_HALF, _SLOWS, _NEARLY, _STAYS = 0.5, 0.9, 0.95, 0.98  # parts of the ratio that stays
# Logarithm of the time from 0.9 to 0.98 of the ratio over a fifth of that from 0.5 to 0.9, which are equal
# where it grows evenly: mean and standard deviation of a slide, of an even growth, of one by minimum jerk.
_SLIDE, _EVEN, _SMOOTH = (0.53, 0.4), (0.0, 0.2), (1.03, 0.4)
_OTHER = 0.02  # density of any other course
_FEW = 3  # scans, below which a course has no shape
_SLIDE_S = 0.4  # mean duration of gross slip, as in `friction`
_LEAST = 0.05  # ratio, below which offsets grow and fall
_NOISY = 0.05  # of the ratio: with more noise, the times are not known
_TURNED, _NOISES = 1.02, 3.0  # of the ratio, and of its noise: it has been larger, as in a swing
_SAME = 0.15  # relative change of a ratio that stays


class GrowthEvidence:
    """Course of the ratio in one contact."""

    def __init__(self) -> None:
        self._sizes: collections.deque[float] = collections.deque()
        self._found = 0.0  # log odds when the ratio began to stay
        self._level, self._took_s, self._stayed_s = 0.0, 0.0, 0.0

    def take(self, size: float, step_s: float) -> None:
        """Take the ratio of a scan."""
        self._sizes.append(size)
        if len(self._sizes) > _HISTORY_S / step_s:
            self._sizes.popleft()

    def log_odds(self, size_sd: float, step_s: float, since_s: float) -> float:
        """Return the log likelihood ratio of sliding over sticking; 0 while the ratio grows.

        Parameters
        ----------
        size_sd : float
            Noise of the newest ratio.
        step_s, since_s : float
            Time between scans, and since this was asked before.
        """
        sizes = np.array(self._sizes)
        level = float(sizes[-2:].mean())
        self._stayed_s += since_s
        if level < max(_LEAST, size_sd / _NOISY):
            self._found = 0.0
        elif len(below := np.flatnonzero(sizes < _HALF * level)):
            self._grown(sizes[below[-1] :], level, size_sd, step_s)
        elif abs(level - self._level) > _SAME * level:
            self._found = 0.0
        fades = max(self._stayed_s - self._took_s, 0.0) / _SLIDE_S
        return max(self._found - fades, 0.0) if self._found > 0 else self._found

    def _grown(self, rise: FloatArray, level: float, size_sd: float, step_s: float) -> None:
        """Evaluate a growth (n,) from half of the level."""
        half, slows, nearly, stays = (step_s * _crossing(rise, part * level) for part in _PARTS)
        self._stayed_s = step_s * (len(rise) - 1) - nearly
        took_s = max(nearly - half, step_s)
        self._level, self._found, self._took_s = level, 0.0, took_s
        has_turned = rise.max() > _TURNED * level + _NOISES * size_sd
        if has_turned or self._stayed_s < max(took_s, 2 * step_s):
            return
        z = math.log(took_s / _HAND_S) / _HAND_LOG_SD
        self._found = -math.log(max(0.5 * (1.0 + math.erf(z / math.sqrt(2.0))), _RARE))
        if slows - half >= _FEW * step_s:
            course = math.log(max(stays - slows, 0.5 * step_s) / (0.2 * (slows - half)))
            holds = 0.5 * (_density(course, *_EVEN) + _density(course, *_SMOOTH))
            self._found += math.log((_density(course, *_SLIDE) + _OTHER) / (holds + _OTHER))


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

"""What comes again and again: a hum, a shaking arm, an object that sticks and slips.

Shear that came and went is no news for a while: what follows must outgrow it to be said, and while the swings
go on they are not forgotten. Swings as large as a slip look like slips that turn back and forth, and may be:
the first few are said one by one, then the slip is said to go on until the shear rests. Who grips on the
first grips on, and is not told of each swing.
"""

import math

import numpy as np

from tactiled.array import FloatArray

# A slip that follows on a swing of nine tenths of what friction bears still outgrows it by so much.
_NEWS = 1.1
# Kept for the first time, half of it forgotten in each of the second: a tug or a start of the arm is followed
# by its like within some seconds.
_KEPT_S, _FORGET_S = 2.0, 4.0
# Slips that begin so soon after one another are of one motion: half the period of 0.42 Hz, below the tremor
# of hands and the sway of arms. A finger that strokes back and forth takes longer, and each stroke is one.
_SOON_S = 1.2
_FEW = 3  # that are said one by one
_RESTS_S = 1.0  # a shake of 0.5 Hz rests shorter
_OUTGROWN = 1.25  # times the largest swing: something else
OUTGROWS_S = 0.1  # ago it began to, give or take the half: the swing it came out of hides when
_NOISE_SDS = 6.0


class SwingHistory:
    """Memory of the slips of a contact.

    Parameters
    ----------
    rate_hz : float
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._size, self._at = 0.0, 0
        self._begun = -math.inf
        self._n_soon = 0

    def least(self, index: int) -> float:
        """Shear over pressure that came and went of late: what is news outgrows it."""
        since_s = max((index - self._at) / self._rate_hz - _KEPT_S, 0.0)
        return self._size * math.pow(2.0, -since_s / _FORGET_S)

    def record_swing(self, size: float, index: int) -> None:
        """Shear over pressure rose by so much and fell back."""
        self._size, self._at = max(_NEWS * size, self.least(index)), index

    def go_on(self, index: int) -> None:
        """Something moves that is no news: it goes on, and is not forgotten meanwhile."""
        self._size, self._at = self.least(index), index

    def begin(self, index: int) -> None:
        """A slip is said."""
        is_soon = index - self._begun < _SOON_S * self._rate_hz
        self._n_soon = self._n_soon + 1 if is_soon else 0
        self._begun = index

    @property
    def are_many(self) -> bool:
        """Whether enough of them were said one by one."""
        return self._n_soon >= _FEW


class ShakeTracker:
    """A slip that goes back and forth, until it rests or is outgrown.

    Parameters
    ----------
    index : int
        Newest scan.
    shear : (3,) float64
        Motion over pressure there.
    largest : float
        Of the slip so far, over pressure.
    rate_hz : float
    least : float
        Shear over pressure of a change that counts.
    is_known : bool
        How large it gets; else its first second shows.
    """

    def __init__(
        self,
        index: int,
        shear: FloatArray,
        largest: float,
        rate_hz: float,
        least: float,
        *,
        is_known: bool = False,
    ) -> None:
        self.rests_since = index
        self._shear = shear
        self.largest = largest if is_known else max(largest, extent(shear))
        self._seen_until = -math.inf if is_known else index + _RESTS_S * rate_hz
        self._rate_hz, self._least = rate_hz, least

    def is_outgrown(self, index: int, shear: FloatArray) -> bool:
        """Whether a scan's motion over pressure is beyond all swings of its first second."""
        now = extent(shear)
        if index <= self._seen_until:
            self.largest = max(self.largest, now)
        return now > _OUTGROWN * self.largest

    def rests(self, index: int, shear: FloatArray, noise: float) -> bool:
        """Whether a scan's motion over pressure, with its noise, has stayed where it was for long enough."""
        if extent(shear - self._shear) > max(self._least, _NOISE_SDS * noise):
            self._shear, self.rests_since = shear, index
        return index - self.rests_since > _RESTS_S * self._rate_hz


def extent(vector: FloatArray) -> float:
    """Length of a motion (3,)."""
    return float(np.sqrt((vector**2).sum()))

"""Repeated shear: a hum, a shaking arm, an object that sticks and slips.

After a swing of shear, later shear is reported only if it is larger; the memory of the swing fades unless
swings continue. During sustained shaking, the first few swings are reported one by one, then as a single slip
until shear is steady. A gripper that reacts to the first swing is therefore not sent an event for each.
"""

import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip.gross import NOISE_SDS

# A slip that follows on a swing of nine tenths of what friction bears still outgrows it by so much.
_LEAST_GROWTH_OVER_SWING = 1.1
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


class SwingHistory:
    """Size of recent swings of a contact, and how often slips began.

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
        """Return the shear over pressure that a new slip must exceed because of recent swings."""
        since_s = max((index - self._at) / self._rate_hz - _KEPT_S, 0.0)
        return self._size * math.pow(2.0, -since_s / _FORGET_S)

    def record_swing(self, size: float, index: int) -> None:
        """Record that shear over pressure rose by `size` and fell back."""
        self._size, self._at = max(_LEAST_GROWTH_OVER_SWING * size, self.least(index)), index

    def go_on(self, index: int) -> None:
        """Keep the size of swings that continue from fading."""
        self._size, self._at = self.least(index), index

    def begin(self, index: int) -> None:
        """Record the onset of a reported slip."""
        is_soon = index - self._begun < _SOON_S * self._rate_hz
        self._n_soon = self._n_soon + 1 if is_soon else 0
        self._begun = index

    @property
    def are_many(self) -> bool:
        """True if enough swings were reported one by one."""
        return self._n_soon >= _FEW


class ShakeTracker:
    """Follow sustained shaking until shear is steady or exceeds the swings.

    Parameters
    ----------
    index : int
        Newest scan.
    shear : (3,) float64
        Shear over pressure at that scan.
    largest : float
        Largest shear over pressure of the slip so far.
    rate_hz : float
    least : float
        Shear over pressure of a change that counts.
    is_known : bool
        `largest` is final; otherwise the first second may raise it.
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
        """Return True if shear over pressure exceeds all swings of the first second."""
        now = extent(shear)
        if index <= self._seen_until:
            self.largest = max(self.largest, now)
        return now > _OUTGROWN * self.largest

    def rests(self, index: int, shear: FloatArray, noise: float) -> bool:
        """Return True if shear over pressure has stayed within noise for `_RESTS_S`."""
        if extent(shear - self._shear) > max(self._least, NOISE_SDS * noise):
            self._shear, self.rests_since = shear, index
        return index - self.rests_since > _RESTS_S * self._rate_hz


def extent(vector: FloatArray) -> float:
    """Return the length of a motion (3,)."""
    return float(np.sqrt((vector**2).sum()))

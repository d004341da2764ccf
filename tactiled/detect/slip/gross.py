"""Track a gross slip, or a slip whose shear fell back, until it ends, turns or sticks again.

During gross slip, shear is proportional to pressure, so the ratio of the two is followed once it is steady.
The ratio drops when the motion ends with a recoil, reverses, or breaks away again. It grows when the skin
sticks again under a growing load. Each drop ends the slip; shear of the opposite sign shows that it reversed.

A skin that stops without recoil keeps its shear, and no reading of a smooth plate changes (in the demo's
scene, none by 0.01 mV; the rubber keeps creeping at 0.1 mV/s). The slip is therefore reported as continuing
until the shear relaxes, changes again, or the contact lifts.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

_RISES = 0.05  # of the steepest: a response that grows slower has come to its limit
FELL_PART = 0.15  # of the rise: more than creep and unequal taxels make of a load that stays
NOISE_SDS = 6.0  # a change of shear below this many standard deviations of its noise does not count
# A load that stays near its limit looks like gross slip until it grows again: by little, and for any setting.
GROWS_PART = 0.1
# An extreme lasts until the response has left it by more than ripple and noise.
NEAR_PART, NEAR_SDS = 0.03, 3.0
# Of gross slip's shear, the other way: a load that is taken off leaves less, one that turns leaves as much.
_REVERSED_PART = 0.1
_RESTED_S = 0.1
_TURN_DEG = 30.0
TURNED_S = 0.2  # as `heading`: a tap that shoves the skin aside is over sooner

SlipOutcome = Literal["gross", "stalled", "back", "again", "turned", "reversed", "rests"]


class SlipDecision(NamedTuple):
    """Decision on a slip.

    Attributes
    ----------
    outcome : str
        ``gross``: all of it slips. ``stalled``: shear stays, nothing slips. ``back``: shear falls, it has
        ended. ``again``: gross slip had ended, shear grows again. ``turned``: it goes on in another
        direction. After it fell back: ``reversed``, it slips the other way; ``again``; ``rests``.
    at_index : float
        Scan of the change.
    sd_scans : float
    """

    outcome: SlipOutcome
    at_index: float
    sd_scans: float


@dataclass
class TimedExtreme:
    """Extreme value, with the scan at which the response was last near it."""

    value: float
    index: int


class RecoilTracker:
    """Follow shear that fell back until it rests or becomes another slip.

    Parameters
    ----------
    low, high : TimedExtreme
        Extremes of the level, which is shear over pressure.
    rate_hz : float
    least : float
        Shear over pressure of a change that counts.
    reversed_below : float
        Shear over pressure below which a slip in the opposite direction has begun.
    may_grow : bool
        A renewed growth is another slip.
    """

    def __init__(
        self,
        low: TimedExtreme,
        high: TimedExtreme,
        rate_hz: float,
        least: float,
        reversed_below: float,
        *,
        may_grow: bool,
    ) -> None:
        self._low, self._high = low, high
        self._rate_hz, self._least = rate_hz, least
        self._reversed_below, self._may_grow = reversed_below, may_grow

    def step(self, index: int, shear: float, level: float, noise: float) -> SlipDecision | None:
        """Process a scan: shear and the rising side's level over pressure, and the noise of both."""
        if shear < self._reversed_below:
            return SlipDecision("reversed", self._high.index, (index - self._high.index) / 4)
        if level < self._low.value - max(NEAR_PART * self._high.value, NEAR_SDS * noise):
            self._low = TimedExtreme(level, index)
        if self._may_grow and level - self._low.value > max(self._least, NOISE_SDS * noise):
            return SlipDecision("again", self._low.index, (index - self._low.index) / 2)
        if index - self._low.index > _RESTED_S * self._rate_hz:
            return SlipDecision("rests", self._low.index, 0.0)
        return None


class GrossSlipTracker:
    """Follow a gross slip until it ends, turns or sticks again.

    Parameters
    ----------
    along : list of float
        Unit vector (3,) of the response's growth.
    steepest : float
        Steepest slope of the response, steps per scan.
    rate_hz : float
    least : float
        Shear over pressure of a change that counts.
    settled : int
        Scan after which the level is evaluated.
    """

    def __init__(
        self, along: list[float], steepest: float, rate_hz: float, least: float, settled: int
    ) -> None:
        self._along = along
        self._steepest = steepest
        self._rate_hz, self._least = rate_hz, least
        self._settled = settled
        self._settles = True
        self._n_turned = 0
        self._low, self._high = TimedExtreme(0.0, settled), TimedExtreme(0.0, settled)

    def step(
        self, index: int, sides: tuple[float, float, float], level: float, slope: float, noise: float
    ) -> SlipDecision | None:
        """Process a scan: motion (x, y, turn), level, slope in steps per scan, noise of the level."""
        still_rises = self._settles and slope > _RISES * self._steepest
        if index <= self._settled or still_rises:
            self._low, self._high = TimedExtreme(level, index), TimedExtreme(level, index)
            return None
        self._settles = False
        if turned := self._has_turned(index, sides):
            return turned
        near = max(NEAR_PART * self._high.value, NEAR_SDS * noise)
        self._low.value, self._high.value = min(self._low.value, level), max(self._high.value, level)
        if level <= self._low.value + near:
            self._low.index = index
        if level >= self._high.value - near:
            self._high.index = index
        if self._high.value - level > max(self._least, NOISE_SDS * noise, FELL_PART * self._high.value):
            return SlipDecision("back", self._high.index, (index - self._high.index) / 2)
        if level - self._low.value > max(GROWS_PART * self._low.value, NOISE_SDS * noise):
            return SlipDecision("again", self._low.index, (index - self._low.index) / 2)
        return None

    def recoil(self, index: int, level: float) -> RecoilTracker:
        """Make the tracker of shear that fell back at a scan."""
        below = -max(self._least, _REVERSED_PART * self._high.value)
        return RecoilTracker(
            TimedExtreme(level, index), self._high, self._rate_hz, self._least, below, may_grow=True
        )

    def _has_turned(self, index: int, sides: tuple[float, float, float]) -> SlipDecision | None:
        """Detect a turn of the motion; friction, and so the response, points along the motion."""
        size = math.sqrt(sum(s * s for s in sides))
        along = sum(a * s for a, s in zip(self._along, sides, strict=True))
        is_off = along < math.cos(math.radians(_TURN_DEG)) * size
        self._n_turned = self._n_turned + 1 if is_off else 0
        if self._n_turned <= TURNED_S * self._rate_hz:
            return None
        return SlipDecision("turned", index - self._n_turned, self._n_turned / 2)

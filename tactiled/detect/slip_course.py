"""A slip from its onset on: does it become gross, does it end, does it turn back?

Shear that grows is answered by Mindlin's curve (Mindlin, J. Appl. Mech. 16, 1949: the tangential force on a
ball rises as ``1 - (1 - x)^(3/2)`` with the travel x): steep at first, flat when everything slips. A pull on
a held object rises as it likes and then stays at what friction bears. Either way gross slip is where the
response stops following the motion: its slope falls to `_FLAT` of the steepest. At x = 0.9, where nine tenths
slip, Mindlin's slope is 0.32 of that at the start.

A load that stops growing below the friction limit has the same shape. Only its size tells: as little shear
over pressure as that is no gross slip on any likely surface. A response that falls back at once is a load
that goes again; one that falls much faster than it rose has broken away (stick-slip).

While all slips, shear goes with pressure, so their ratio is followed, once it has come to rest at its
limit. It drops when the motion ends with a recoil, turns back, or breaks away again; it grows when the skin
sticks again under a growing load. What drops has ended, be it by recoil or by turning back: that is known
when little of the shear is left. A skin that just stops keeps its shear, and nothing shows before it moves
again or lifts.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip_limit import Limit
from tactiled.detect.slip_response import PRESSURE, motion

_FLAT = 0.3
_LINE_S = 0.05  # of the line through the newest responses whose slope is looked at: five scans at 100 Hz
# By Mindlin's curve nine tenths slip when friction has reached 1 - 0.1^(3/2) of its limit.
_NINE_TENTHS = 0.968
_INSTANT_SD = 1.0  # scans: where between two it lies, and what noise adds
_SHAPE_SD_PART = 0.03  # of the time since the onset: what real curves differ from Mindlin's
# The line is longer where noise would make its slope uncertain by more than this part of the steepest.
_SLOPE_SD_PART = 0.15
_STALLED_S = 0.3  # flat for so long below what is gross: the load stays, nothing slips any more
_FELL_PART = 0.15  # of the rise: more than creep and unequal taxels make of a load that stays
_BROKE_AWAY = 3.0  # a fall so many times as steep as the steepest rise is no unloading
# Pressure alone moves twice a side by some three times itself, shear moves the pressure by an eighth of it.
_COMMON = 4.0
# Pressure that grew with the shear by more than this of it is a load that came at a slant: slip itself moves
# the pressure by an eighth, jolts by up to 0.65, slanted loads on the physical families by 1.1 to 1.7.
_PRESSED = 0.8
_NOISE_SDS = 6.0  # a fall within the noise is none
# An extreme lasts until the response has left it by more than ripple and noise.
_NEAR_PART, _NEAR_SDS = 0.03, 3.0
_RISES = 0.05  # of the steepest: a response that grows slower has come to its limit
_LEFT_PART = 0.3  # of gross slip's shear: skins and rubber that just stop keep more
_RESTED_S = 0.1
_SETTLE_S = 0.05  # after a break-away, before the new level is one
_ASIDE = 0.5  # shear that grows by so much of the steepest, at more than 60 degrees from where it grew
_TURN_DEG = 30.0
_TURNED_S = 0.2  # as `heading`: a tap that shoves the skin aside is over sooner

Fate = Literal["gross", "stalled", "back", "again", "turned", "reversed", "rests"]


class Verdict(NamedTuple):
    """What became of a slip.

    Attributes
    ----------
    fate : str
        ``gross``: all of it slips. ``stalled``: shear stays, nothing slips. ``back``: shear falls, it has
        ended. ``again``: gross slip had ended, shear grows again. ``turned``: it goes on in another
        direction. After it fell back: ``reversed``, it slips the other way; ``again``; ``rests``.
    at_index : float
        Scan at which that began.
    sd_scans : float
    """

    fate: Fate
    at_index: float
    sd_scans: float


@dataclass
class _Level:
    """An extreme, and when the response was last at it."""

    value: float
    index: int


class Course:
    """Follows one slip.

    Parameters
    ----------
    along : (3,) float64
        Unit vector of the response's growth.
    start : (7,) float64
        Response where it began.
    even : (7,) float64
        Response of an even pressure of 1.
    index : int
        Newest scan.
    delay : float
        How many scans ago it began.
    slope : float
        Of the growth so far, steps a scan.
    rate_hz : float
    least, gross : float
        Shear over pressure of a change that counts, and of gross slip.
    limit : Limit
    """

    def __init__(
        self,
        along: FloatArray,
        start: FloatArray,
        even: FloatArray,
        index: int,
        delay: float,
        slope: float,
        rate_hz: float,
        least: float,
        gross: float,
        limit: Limit,
    ) -> None:
        self.along = along
        self.is_gross = self.is_over = self._was_gross = False
        self._along: list[float] = along.tolist()
        # Twice the side that rises stands for both: what it may miss is that the other bottoms out.
        self._sides = 2 * np.concatenate([np.maximum(along, 0.0), np.maximum(-along, 0.0)])
        self._start = self._risen(start)
        self._even = self._risen(even)
        self._begun = index - delay
        self._steepest = slope
        self._rate_hz = rate_hz
        self._least, self._gross = least, gross
        self._limit = limit
        self._start_shear, self._start_pressure = float(along @ motion(start)), float(start[PRESSURE])
        self._least_line = max(4, round(_LINE_S * rate_hz))
        self._top = _Level(-math.inf, index)
        self._top_pressure = 0.0
        self._low, self._high = _Level(0.0, index), _Level(0.0, index)
        self._top_shear = 0.0
        self._n_flat = self._n_turned = 0
        self._level_from = 0
        self._settles = True

    def shift(self, by: FloatArray) -> None:
        """Other taxels make the response from now on, which jumps by (7,)."""
        jump = self._risen(by)
        self._start += jump
        self._top.value += jump

    def excursion(self, row: FloatArray) -> float:
        """How far shear went, over the pressure of the newest response (7,)."""
        return (self._top.value - self._start) / float(row[PRESSURE])

    def _risen(self, row: FloatArray) -> float:
        sides = row[:PRESSURE].tolist()
        return float(sum(w * s for w, s in zip(self._sides.tolist(), sides, strict=True)))

    def step(self, index: int, seen: FloatArray, steps: FloatArray, noise: float) -> Verdict | None:
        """Take in a scan.

        Parameters
        ----------
        index : int
        seen : (window, 7) float64
            Responses, newest last.
        steps : (window, channels) float64
            The readings that they are of.
        noise : float
            Standard deviation of the response along the slip.
        """
        pressure = float(seen[-1, PRESSURE])
        if pressure <= 0:
            return None
        x, y, turn = motion(seen[-1]).tolist()
        shear = self._along[0] * x + self._along[1] * y + self._along[2] * turn
        if self.is_gross or self.is_over:
            level = self._risen(seen[-1]) / pressure - self._even
            if self.is_over:
                return self._step_back(index, shear / pressure, level, noise / pressure)
            slope = self._risen(self._trend(seen, self._least_line))
            return self._step_gross(index, (x, y, turn), level, slope, noise / pressure)
        return self._step_incipient(index, seen, steps, shear, pressure, noise)

    def _step_incipient(
        self, index: int, seen: FloatArray, steps: FloatArray, shear: float, pressure: float, noise: float
    ) -> Verdict | None:
        noise *= math.sqrt(2)  # one side of two, twice
        n = self._line_scans(noise, len(seen))
        trend = self._trend(seen, n)
        slope = self._risen(trend)
        speed = max(abs(slope), float(np.sqrt((motion(trend) ** 2).sum())))
        response = self._risen(seen[-1])
        if response > self._top.value:
            self._top.value, self._top_pressure, self._top_shear = response, pressure, shear
        fall = self._top.value - response
        if fall <= max(_NEAR_PART * (self._top.value - self._start), _NEAR_SDS * noise):
            self._top.index = index
        if fall > max(
            self._least * pressure,
            _FELL_PART * (self._top.value - self._start),
            _NOISE_SDS * noise,
            _COMMON * abs(pressure - self._top_pressure),
        ):
            since = max(index - self._top.index, 1)
            broke = fall / since > _BROKE_AWAY * self._steepest
            if broke and self._top_shear >= self._gross * pressure:
                return self._go_gross(index, self._top.index, _INSTANT_SD, round(_SETTLE_S * self._rate_hz))
            level = response / pressure - self._even
            self.is_over = True
            self._low, self._high = _Level(level, index), _Level(level, self._top.index)
            return Verdict("back", self._top.index, since / 2)
        # The largest that is sure, not the largest that noise made.
        self._steepest = max(self._steepest, slope - 2 * noise * math.sqrt(12) / n**1.5)
        self._n_flat = self._n_flat + 1 if speed < _FLAT * self._steepest else 0
        aside = speed > _ASIDE * self._steepest and abs(slope) < _ASIDE * speed
        self._n_turned = self._n_turned + 1 if aside else 0
        knee = (
            index - self._n_flat - 0.35 * n + 0.5
        )  # a line is flat by so much when most of it is past the knee
        still_there = self._top.index == index  # a load that goes again, if slowly, does not stay at its top
        is_flat = self._n_flat > n // 2 and still_there
        if not self._n_flat:
            self._limit.take(shear - self._start_shear, index - self._begun, steps[-n:])
        if is_flat and shear >= self._gross * pressure and not self._load_stops(knee, shear, pressure, steps):
            return self._go_gross(index, *self._reached(index, seen), 0)
        if self._n_flat > max(n, _STALLED_S * self._rate_hz):
            return Verdict("stalled", knee, n / 4)
        if self._n_turned > max(n, _TURNED_S * self._rate_hz):
            return Verdict("turned", index - self._n_turned, n / 2)
        return None

    def _load_stops(self, knee: float, shear: float, pressure: float, steps: FloatArray) -> bool:
        """Whether the load came to rest where the shear did, and friction need not have."""
        risen = shear - self._start_shear
        pressed = pressure - self._start_pressure > _PRESSED * risen
        return pressed or self._limit.holds(risen, knee - self._begun, steps[-self._n_flat :])

    def _trend(self, seen: FloatArray, n: int) -> FloatArray:
        """Slopes (7,) of a line through the newest n scans: sums of whole numbers, exact in any order."""
        line = 2.0 * np.arange(n) - (n - 1)
        return np.asarray((line @ seen[-n:]) * 6 / (n * (n * n - 1.0)))

    def _reached(self, index: int, seen: FloatArray) -> tuple[float, float]:
        """Scan at which nine tenths slipped, with its sigma, now that the response stands at its limit."""
        courses = seen[:, :PRESSURE] @ self._sides
        limit = float(courses[-max(self._n_flat, 1) :].mean())
        below = np.flatnonzero(courses < self._start + _NINE_TENTHS * (limit - self._start))
        at = index - (len(seen) - 1.5 - (float(below[-1]) if len(below) else 0.0))
        return at, math.hypot(_INSTANT_SD, _SHAPE_SD_PART * (at - self._begun))

    def _line_scans(self, noise: float, most: int) -> int:
        """The variance of a slope is 12 noise^2 / n^3."""
        wanted = (noise * math.sqrt(12) / (_SLOPE_SD_PART * max(self._steepest, 1e-9))) ** (2 / 3)
        return int(min(max(self._least_line, math.ceil(wanted)), most))

    def _go_gross(self, index: int, at: float, sd_scans: float, settle_scans: int) -> Verdict:
        self.is_gross = True
        self._level_from = index + 1 + settle_scans
        return Verdict("gross", at, sd_scans)

    def _step_gross(
        self, index: int, sides: tuple[float, float, float], level: float, slope: float, noise: float
    ) -> Verdict | None:
        still_rises = self._settles and slope > _RISES * self._steepest
        if index <= self._level_from or still_rises:
            self._low, self._high = _Level(level, index), _Level(level, index)
            return None
        self._settles = False
        if turned := self._has_turned(index, sides):
            return turned
        near = max(_NEAR_PART * self._high.value, _NEAR_SDS * noise)
        self._low.value, self._high.value = min(self._low.value, level), max(self._high.value, level)
        if level <= self._low.value + near:
            self._low.index = index
        if level >= self._high.value - near:
            self._high.index = index
        least = max(self._least, _NOISE_SDS * noise)
        if self._high.value - level > max(least, _FELL_PART * self._high.value):
            self.is_over, self.is_gross, self._was_gross = True, False, True
            self._low = _Level(level, index)
            return Verdict("back", self._high.index, (index - self._high.index) / 2)
        if level - self._low.value > max(least, _FELL_PART * self._low.value):
            return Verdict("again", self._low.index, (index - self._low.index) / 2)
        return None

    def _step_back(self, index: int, shear: float, level: float, noise: float) -> Verdict | None:
        turned_round = (
            level < _LEFT_PART * self._high.value
            if self._was_gross
            else shear < -max(self._gross, self._least)
        )
        if turned_round:
            return Verdict("reversed", self._high.index, (index - self._high.index) / 4)
        if level < self._low.value - max(_NEAR_PART * self._high.value, _NEAR_SDS * noise):
            self._low = _Level(level, index)
        if self._was_gross and level - self._low.value > max(self._least, _NOISE_SDS * noise):
            return Verdict("again", self._low.index, (index - self._low.index) / 2)
        if index - self._low.index > _RESTED_S * self._rate_hz:
            return Verdict("rests", self._low.index, 0.0)
        return None

    def _has_turned(self, index: int, sides: tuple[float, float, float]) -> Verdict | None:
        """Friction points along the motion: the response turns with it."""
        size = math.sqrt(sum(s * s for s in sides))
        along = sum(a * s for a, s in zip(self._along, sides, strict=True))
        is_off = along < math.cos(math.radians(_TURN_DEG)) * size
        self._n_turned = self._n_turned + 1 if is_off else 0
        if self._n_turned <= _TURNED_S * self._rate_hz:
            return None
        return Verdict("turned", index - self._n_turned, self._n_turned / 2)

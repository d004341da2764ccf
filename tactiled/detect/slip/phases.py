"""Phases of a slip after its onset: incipient, gross, ended or reversed.

Under a growing travel x, shear follows Mindlin's curve (J. Appl. Mech. 16, 1949: the tangential force on a
ball rises as ``1 - (1 - x)^(3/2)``): steep at first, flat when all of the contact slips. A pull on a held
object rises in any way and then stays at the friction limit. In both cases, gross slip is where the response
stops following the motion: its slope falls to `_FLAT` of the steepest slope. At x = 0.9, where nine
tenths slip, Mindlin's slope is 0.32 of that at the start.

A load that stops growing below the friction limit has the same shape. Three criteria distinguish it: little
shear over pressure is no gross slip on any likely surface; pressure that came with the shear and stops with
it is a load; and the taxels' shares of the shear differ (`slip.friction_limit`). A response that falls back
at once is a load that is removed; one that falls much faster than it rose has broken away (stick-slip).
`slip.gross` follows the slip from there.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.slip.friction_limit import FrictionLimitTest
from tactiled.detect.slip.gross import (
    FELL_PART,
    GROWS_PART,
    NEAR_PART,
    NEAR_SDS,
    NOISE_SDS,
    TURNED_S,
    GrossSlipTracker,
    RecoilTracker,
    SlipDecision,
    TimedExtreme,
)
from tactiled.detect.slip.kink import KinkEstimate
from tactiled.detect.slip.plateau import PlateauTracker
from tactiled.detect.slip.response import PRESSURE, motion, rising_half

_FLAT = 0.3
_LINE_S = 0.04  # length of the line fitted to the newest responses: four scans at 100 Hz
# The slope must stay below `_FLAT` for half the line; a shorter time suffices where shear is this many times
# the least of gross slip. On
# seeds 1001 to 1006 of the physical families gross slip is then said 42 ms after it began and not 50, and no
# load that stops is called gross; at 1.3 times one in a dozen cable tugs is, at 1.0 arm motion too. A load
# that goes again at a third of the speed it came with is falling by so much of the steepest by then.
_CLEARLY, _GOES = 1.6, 0.05
# By Mindlin's curve nine tenths slip when friction has reached 1 - 0.1^(3/2) of its limit.
_NINE_TENTHS = 0.968
_INSTANT_SD = 0.8  # scans: where between two it lies, and what noise adds
# Of the time since the onset: what real curves differ from Mindlin's, one way and either way, on seeds 1001
# to 1012 of the physical families.
_LATE_PART, _SHAPE_SD_PART = 0.03, 0.03
# The line is lengthened where noise makes its slope uncertain by more than this part of the steepest slope.
_SLOPE_SD_PART = 0.15
# Flat for so long, scans that noise bends taken off twice, below what is gross: the load stays, nothing slips
# any more.
_STALLED_S, _BENT_SCANS = 0.3, 2
_BROKE_AWAY = 3.0  # a fall so many times as steep as the steepest rise is no unloading
# Pressure alone moves twice a side by some three times itself, shear moves the pressure by an eighth of it.
_PRESSURE_CHANGES = 4.0
# Pressure that grew with the shear by more than this of it is a load that came at a slant: slip itself moves
# the pressure by an eighth, jolts by up to 0.65, slanted loads on the physical families by 1.1 to 1.7.
_PRESSED = 0.8
# A small growth of shear makes it unlikely that the friction limit was reached.
_LITTLE = 0.2
_SETTLE_S = 0.05  # after a break-away, before the new level is one
_ASIDE = 0.5  # shear that grows by so much of the steepest, at more than 60 degrees from where it grew


class SlipPhaseTracker:
    """Follow the phases of one slip.

    Parameters
    ----------
    along : (3,) float64
        Unit vector of the response's growth.
    start : (7,) float64
        Response at the onset.
    even : (7,) float64
        Response of an even pressure of 1.
    index : int
        Newest scan.
    began : KinkEstimate
        Onset, in scans before the newest.
    slope : float
        Slope of the growth so far, steps per scan.
    rate_hz : float
    least, gross : float
        Least shear over pressure of a change that counts, and that of gross slip.
    limit : FrictionLimitTest
    """

    def __init__(
        self,
        along: FloatArray,
        start: FloatArray,
        even: FloatArray,
        index: int,
        began: KinkEstimate,
        slope: float,
        rate_hz: float,
        least: float,
        gross: float,
        limit: FrictionLimitTest,
    ) -> None:
        self.along = along
        self._along: list[float] = along.tolist()
        # Twice the side that rises stands for both: what it may miss is that the other bottoms out.
        self._sides = 2 * rising_half(along)
        self._start = self._risen(start)
        self._even = self._risen(even)
        self._begun, self._began = index - began.delay_scans, began
        self._steepest = slope
        self._rate_hz = rate_hz
        self._least, self._gross = least, gross
        self._limit = limit
        self._start_shear, self._start_pressure = float(along @ motion(start)), float(start[PRESSURE])
        self._least_line = max(4, round(_LINE_S * rate_hz))
        self._top = TimedExtreme(-math.inf, index)
        self._top_pressure = 0.0
        self._top_shear = 0.0
        self._n_flat = self._n_still = self._n_turned = 0
        self._rest = PlateauTracker(rate_hz)
        self._flat_at = index
        self._after: GrossSlipTracker | RecoilTracker | None = None

    def shift(self, by: FloatArray, read: NDArray[np.bool_]) -> None:
        """Change to the taxel set `read` (taxels,), by which the response jumps by (7,)."""
        if not by.any():
            return
        jump, shear, pressure = self._risen(by), float(self.along @ motion(by)), float(by[PRESSURE])
        self._start += jump
        self._top.value += jump
        self._start_shear += shear
        self._top_shear += shear
        self._start_pressure += pressure
        self._top_pressure += pressure
        self._limit.keep(read)
        self._rest.shift(shear)

    def excursion(self, row: FloatArray) -> float:
        """Return the largest growth of shear over the pressure of the newest response (7,)."""
        return (self._top.value - self._start) / float(row[PRESSURE])

    def swing(self, row: FloatArray) -> float:
        """Return the fall of shear since its maximum over the pressure of the newest response (7,)."""
        return (self._top_shear - float(self.along @ motion(row))) / float(row[PRESSURE])

    def look_back(self, steps: FloatArray) -> None:
        """Collect the taxels' shares between onset and detection from the kept readings."""
        ago = min(int(self._began.delay_scans), len(steps) - 1)
        for row in range(len(steps) - 1 - ago, len(steps)):
            self._limit.take(self._began.delay_scans - (len(steps) - 1 - row), steps[row])

    def _risen(self, row: FloatArray) -> float:
        sides = row[:PRESSURE].tolist()
        return float(sum(w * s for w, s in zip(self._sides.tolist(), sides, strict=True)))

    def step(self, index: int, seen: FloatArray, steps: FloatArray, noise: float) -> SlipDecision | None:
        """Process a scan and return the decision it brings, if any.

        Parameters
        ----------
        index : int
        seen : (window, 7) float64
            Responses, newest last; the newest pressure is positive.
        steps : (window, channels) float64
            Readings of these responses.
        noise : float
            Standard deviation of the response along the slip.
        """
        pressure = float(seen[-1, PRESSURE])
        x, y, turn = motion(seen[-1]).tolist()
        shear = self._along[0] * x + self._along[1] * y + self._along[2] * turn
        if self._after is None:
            return self._step_incipient(index, seen, steps, shear, pressure, noise)
        level, noise = self._risen(seen[-1]) / pressure - self._even, noise / pressure
        if isinstance(self._after, RecoilTracker):
            return self._after.step(index, shear / pressure, level, noise)
        slope = self._risen(self._trend(seen, self._least_line))
        decision = self._after.step(index, (x, y, turn), level, slope, noise)
        if decision is not None and decision.outcome == "back":
            self._after = self._after.recoil(index, level)
        return decision

    def _step_incipient(
        self, index: int, seen: FloatArray, steps: FloatArray, shear: float, pressure: float, noise: float
    ) -> SlipDecision | None:
        noise *= math.sqrt(2)  # one side of two, twice
        n = self._line_scans(noise, len(seen))
        trend = self._trend(seen, n)
        slope = self._risen(trend)
        speed = max(abs(slope), float(np.sqrt((motion(trend) ** 2).sum())))
        response = self._risen(seen[-1])
        if response > self._top.value:
            self._top.value, self._top_pressure, self._top_shear = response, pressure, shear
        fall = self._top.value - response
        if fall <= max(NEAR_PART * (self._top.value - self._start), NEAR_SDS * noise):
            self._top.index = index
        if fall > max(
            self._least * pressure,
            FELL_PART * (self._top.value - self._start),
            NOISE_SDS * noise,
            _PRESSURE_CHANGES * abs(pressure - self._top_pressure),
        ):
            since = max(index - self._top.index, 1)
            broke = fall / since > _BROKE_AWAY * self._steepest
            if broke and self._top_shear >= self._gross * pressure:
                return self._go_gross(index, self._top.index, _INSTANT_SD, round(_SETTLE_S * self._rate_hz))
            level = response / pressure - self._even
            low, high = TimedExtreme(level, index), TimedExtreme(level, self._top.index)
            reversed_below = -max(self._gross, self._least)
            self._after = RecoilTracker(low, high, self._rate_hz, self._least, reversed_below, may_grow=False)
            return SlipDecision("back", self._top.index, since / 2)
        # The largest that is sure, not the largest that noise made.
        self._steepest = max(self._steepest, slope - 2 * noise * math.sqrt(12) / n**1.5)
        is_flat = speed < _FLAT * self._steepest
        self._n_flat = self._n_flat + 1 if is_flat else 0
        self._n_still = max(self._n_still + (1 if is_flat else -_BENT_SCANS), 0)
        aside = speed > _ASIDE * self._steepest and abs(slope) < _ASIDE * speed
        self._n_turned = self._n_turned + 1 if aside else 0
        still_there = self._top.index == index  # a load that goes again, if slowly, does not stay at its top
        is_clear = 0 < _CLEARLY * self._gross * pressure < shear and slope > -_GOES * self._steepest
        is_over = self._n_flat > (1 if is_clear else n // 2) and still_there
        if self._n_flat:
            self._flat_at = index
        else:
            self._limit.take(index - self._begun, steps[-1])
            self._rest.goes_on()
        if is_over and shear >= self._gross * pressure:
            odds = functools.partial(self._odds, shear, pressure, steps)
            if self._rest.is_gross(self._n_flat, shear, noise, odds):
                return self._go_gross(index, *self._reached(index, seen), 0)
        beyond = shear - self._rest.doubtful_at
        if beyond > max(GROWS_PART * self._rest.doubtful_at, NOISE_SDS * noise):
            return SlipDecision("again", self._flat_at, (index - self._flat_at) / 2)
        may_slip = math.isfinite(self._rest.doubtful_at)
        if not may_slip and self._n_still > max(n, _STALLED_S * self._rate_hz):
            return SlipDecision("stalled", index - self._n_still - 0.35 * n, n / 4)
        if self._n_turned > max(n, TURNED_S * self._rate_hz):
            return SlipDecision("turned", index - self._n_turned, n / 2)
        return None

    def _odds(self, shear: float, pressure: float, steps: FloatArray) -> float:
        """Return the log odds that friction is at its limit where shear has stopped growing."""
        grown = shear - self._start_shear
        if pressure - self._start_pressure > _PRESSED * grown:
            return -math.inf  # a load came to rest, and shear with it
        odds = self._limit.odds(steps[-self._n_flat :])
        if odds is None:
            return math.inf
        if grown <= 0:
            return -math.inf
        # Shear may be zero: arrays without shear channels have no least shear of gross slip.
        return odds if grown >= _LITTLE * shear else odds + math.log(grown / (_LITTLE * shear))

    def _trend(self, seen: FloatArray, n: int) -> FloatArray:
        """Return the slopes (7,) of a line through the newest n scans, or all that are kept.

        Sums of whole numbers: exact in any order.
        """
        n = min(n, len(seen))
        line = 2.0 * np.arange(n) - (n - 1)
        return np.asarray((line @ seen[-n:]) * 6 / (n * (n * n - 1.0)))

    def _reached(self, index: int, seen: FloatArray) -> tuple[float, float]:
        """Return the scan at which nine tenths slipped, with its standard deviation in scans."""
        courses = seen[:, :PRESSURE] @ self._sides
        limit = float(courses[-max(self._n_flat, 1) :].mean())
        below = np.flatnonzero(courses < self._start + _NINE_TENTHS * (limit - self._start))
        at = index - (len(seen) - 1.5 - (float(below[-1]) if len(below) else 0.0))
        if at <= self._begun:  # it was over when it could be seen
            return self._begun, self._began.sd_scans
        at = min(at + _LATE_PART * (at - self._begun), float(index))
        return at, math.hypot(_INSTANT_SD, _SHAPE_SD_PART * (at - self._begun))

    def _line_scans(self, noise: float, most: int) -> int:
        """Return the length of the line; the variance of its slope is 12 noise^2 / n^3."""
        wanted = (noise * math.sqrt(12) / (_SLOPE_SD_PART * max(self._steepest, 1e-9))) ** (2 / 3)
        return int(min(max(self._least_line, math.ceil(wanted)), most))

    def _go_gross(self, index: int, at: float, sd_scans: float, settle_scans: int) -> SlipDecision:
        settled = index + 1 + settle_scans
        self._after = GrossSlipTracker(self._along, self._steepest, self._rate_hz, self._least, settled)
        return SlipDecision("gross", at, sd_scans)

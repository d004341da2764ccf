"""Which gratings the joint fit can tell apart, from array, rate and speed, before any board is plugged in.

At an angle between groove normal and motion (the tilt) and a speed v, grooves of period D ripple with
``f = v cos(tilt) / D``. Too fast for the scan rate they are aliased; of too slow ones a window holds too few.
Between, they are ambiguous where another grating of the allowed periods looks alike (`rivals`), and beyond
the largest tilt the skin slides along them and feels nothing.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.estimator import JointParams
from tactiled.detect.grooves.model import ALIASED
from tactiled.doctor.rivals import Rivals, rivals

Limit = Literal["set", "aliased", "ambiguous", "too-few-periods"]
# Channels of a real skin stray from their wave by 0.05 rad and more. Of N channels two waves that differ by d
# (rms) are then told apart by a log-likelihood of N d^2 / (2 0.05^2), and 7 is a wrong answer in a thousand.
_STRAY_RAD, _NEEDED = 0.05, 7.0
# Where slip says the direction: its own sigma, and by how much grooves turn friction aside.
_SLIP_SD_DEG = 3.4
_SLACK_SIGMAS = 3.0  # by which frequency and wave vector may disagree
TILTS_DEG = (0.0, 30.0, 60.0, 75.0)
_PERIODS = 60  # tried from the finest to the coarsest


@dataclass(frozen=True)
class Range:
    """Periods that are told at a tilt; none where `to_mm` is not above `from_mm`.

    Attributes
    ----------
    tilt_deg : float
        Between groove normal and motion, either way.
    below, above : str
        What becomes of finer grooves and of coarser ones; "set": `min_period_mm` or `max_period_mm` ends it.
    alike : tuple of (period_mm, angle_deg) pairs
        Two gratings that cannot be told apart, the first at this tilt; empty where there are none.
    """

    tilt_deg: float
    from_mm: float
    to_mm: float
    below: Limit
    above: Limit
    alike: tuple[tuple[float, float], ...] = ()

    @property
    def is_empty(self) -> bool:
        """True where no period at all is resolved."""
        return self.to_mm <= self.from_mm


def ranges(array: Array, params: JointParams, rate_hz: float, speed_mm_s: float) -> list[Range]:
    """What is told at each of `TILTS_DEG`; a speed of 0 is not known, and then bounds no period."""
    scene = _Scene(array, params, speed_mm_s)
    low_mm, high_mm = params.min_period_mm, params.max_period_mm
    found = []
    for tilt_deg in (tilt for tilt in TILTS_DEG if tilt <= params.max_tilt_deg):
        below: Limit = "set"
        above: Limit = "set"
        first_mm, last_mm = low_mm, high_mm
        if speed_mm_s > 0:
            across_mm_s = speed_mm_s * float(np.cos(np.radians(tilt_deg)))
            finest_mm = across_mm_s / (ALIASED * rate_hz)
            coarsest_mm = across_mm_s * params.criteria.max_window_s / params.min_periods
            if finest_mm > first_mm:
                first_mm, below = finest_mm, "aliased"
            if coarsest_mm < last_mm:
                last_mm, above = coarsest_mm, "too-few-periods"
        found.append(scene.told(Range(tilt_deg, first_mm, last_mm, below, above)))
    return found


def has_direction(array: Array, params: JointParams) -> bool:
    """Whether the direction of motion is configured, or slip can say it."""
    return params.direction_deg is not None or array.has_shear


class _Scene:
    """An array, and what is known of the motion."""

    def __init__(self, array: Array, params: JointParams, speed_mm_s: float) -> None:
        direction_deg = params.direction_deg or 0.0
        self.direction_deg = direction_deg
        self.params = params
        self.has_direction = has_direction(array, params)
        self.heading = np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
        self.is_tied = speed_mm_s > 0 and self.has_direction
        self.direction_sd = 0.0 if params.direction_deg is not None else float(np.radians(_SLIP_SD_DEG))
        self.speed_sd = params.speed_sd_mm_s / speed_mm_s if speed_mm_s > 0 else 0.0
        alike_rad = _STRAY_RAD * float(np.sqrt(2 * _NEEDED / array.n_channels))
        lists = []
        if self.is_tied:
            lists.append(rivals(array, params.min_period_mm, alike_rad, direction_deg + 90.0))
        if not self.is_tied or self.direction_sd or self.speed_sd:
            lists.append(rivals(array, params.min_period_mm, alike_rad))
        both = [np.concatenate([found.per_mm, -found.per_mm]) for found in lists]
        self.rivals = Rivals(np.concatenate(both), np.concatenate([np.tile(r.apart_rad, 2) for r in lists]))

    def told(self, limits: Range) -> Range:
        """The widest stretch of periods within limits that look like no others."""
        if limits.is_empty:
            return limits
        periods_mm = np.geomspace(limits.from_mm, limits.to_mm, _PERIODS)
        alike: list[tuple[tuple[float, float], ...]] = [
            next((pair for sign in (1, -1) if (pair := self._alike(mm, sign * limits.tilt_deg))), ())
            for mm in periods_mm
        ]
        is_told = np.array([not pair for pair in alike])
        if is_told.all():
            return limits
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_told, [0]])))
        first, end = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0], default=(0, 0))
        example = next(pair for pair in reversed(alike[: first or None]) if pair) if first else ()
        example = example or next(pair for pair in alike[end:] if pair)
        return Range(
            limits.tilt_deg,
            float(periods_mm[first]),
            float(periods_mm[max(end - 1, first)]),
            "ambiguous" if first or not end else limits.below,
            "ambiguous" if end < _PERIODS else limits.above,
            example,
        )

    def _alike(self, period_mm: float, tilt_deg: float) -> tuple[tuple[float, float], ...]:
        """Find the allowed grating that is hardest to tell from this one: (this, other), or () if none."""
        angle = np.radians(self.direction_deg + tilt_deg)
        k = 2 * np.pi / period_mm * np.array([np.cos(angle), np.sin(angle)])
        others = k + self.rivals.per_mm
        size = np.hypot(others[:, 0], others[:, 1])
        params = self.params
        allowed = (size >= 2 * np.pi / params.max_period_mm) & (size <= 2 * np.pi / params.min_period_mm)
        along = others @ self.heading
        if self.has_direction:
            allowed &= along >= size * np.cos(np.radians(params.max_tilt_deg))
        if self.is_tied:
            off = np.abs(self.rivals.per_mm @ self.heading)
            slack = np.hypot(along * self.speed_sd, size * self.direction_sd)
            allowed &= off <= _SLACK_SIGMAS * slack + 1e-6 * size
        if not allowed.any():
            return ()
        other = others[int(np.argmin(np.where(allowed, self.rivals.apart_rad, np.inf)))]
        return (period_mm, _within_90(self.direction_deg + tilt_deg)), _reading(other)


def _reading(k: FloatArray) -> tuple[float, float]:
    return float(2 * np.pi / np.hypot(*k)), _within_90(float(np.degrees(np.arctan2(k[1], k[0]))))


def _within_90(angle_deg: float) -> float:
    """A groove normal has no sense."""
    return float((angle_deg + 90) % 180 - 90)

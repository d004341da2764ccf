"""Outcomes of the fit of one window: an answer, a period without an angle, or a refusal; and their events."""

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG, Candidate, TextureEvent, TextureStatus


@dataclass(frozen=True, eq=False)
class TrackedWave:
    """Fitted wave, as `track` looks for it in later windows, wherever these begin and end."""

    k: FloatArray  # (2,): wave vector, radians per millimetre
    phase_per_travel: float  # radians per millimetre, or per second where no speed was given
    n_harmonics: int
    # (3,): factors that the fit found for the standard deviations of period, angle and speed
    scale: FloatArray
    noise_inflation: float  # ratio of the noise at the line to that of white noise


@dataclass(frozen=True, eq=False, kw_only=True)
class GrooveAnswer:
    """Period and angle of the one grating in view, and the speed where none was given."""

    status: ClassVar[Literal["ok"]] = "ok"
    frequency_hz: float
    snr_db: float
    period_mm: float
    angle_deg: float
    speed_mm_s: float  # the given one, or the estimate; 0 where the direction of the motion is not known
    covariance: FloatArray  # (3, 3): of period (mm), angle (radians) and speed (mm/s)
    uses_given_speed: bool  # False where no speed was given, or where the phases contradict the given one
    error_probability: float = 0.0  # probability that another interpretation of the phases is true
    stray_rad: float = 0.0  # root-mean-square stray of the channels' phases from the wave
    # None where stronger lines had to be removed: then the wave cannot be tracked
    wave: TrackedWave | None = None

    @property
    def period_sd_mm(self) -> float:
        """Standard deviation of the period."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def angle_sd_deg(self) -> float:
        """Standard deviation of the angle."""
        return float(np.degrees(np.sqrt(self.covariance[1, 1])))

    @property
    def speed_sd_mm_s(self) -> float:
        """Standard deviation of the speed."""
        return float(np.sqrt(self.covariance[2, 2]))


@dataclass(frozen=True, kw_only=True)
class PeriodOnly:
    """Period of grooves whose angle cannot be told."""

    status: ClassVar[Literal["period-only"]] = "period-only"
    frequency_hz: float
    snr_db: float
    # The gratings in view, the strongest first: periods and their intervals, weighted by shares of the power
    gratings: tuple[Candidate, ...]


@dataclass(frozen=True)
class Refusal:
    """Reason why a window has no answer, with the line that was looked at, if any."""

    status: TextureStatus
    frequency_hz: float = 0.0
    snr_db: float = 0.0
    candidates: tuple[Candidate, ...] = ()  # gratings that the phases cannot tell apart
    stray_rad: float = 0.0  # as for `GrooveAnswer`, where it was estimated


class NewPattern(Refusal):
    """Refusal because the newest scans show another pattern than those before (`track`)."""


Outcome = GrooveAnswer | PeriodOnly | Refusal


class FitSpan(NamedTuple):
    """End and length of the scans that a fit used, and the speed that was set for them (0: unknown)."""

    end_s: float
    window_s: float
    given_speed_mm_s: float


def texture_event(span: FitSpan, fit: Outcome, answered_s: float, speed_sd_mm_s: float) -> TextureEvent:
    """Report an outcome at the instant of a scan; a given speed stands where the fit has no other."""
    event = TextureEvent(
        time_s=span.end_s,
        answered_s=answered_s,
        status=fit.status,
        frequency_hz=fit.frequency_hz,
        window_s=span.window_s,
        snr_db=fit.snr_db,
        estimator="joint",
    )
    if span.given_speed_mm_s > 0:
        given_mm_s = span.given_speed_mm_s
        event = replace(event, speed_mm_s=given_mm_s, speed_sd_mm_s=speed_sd_mm_s, speed_source="given")
    if isinstance(fit, Refusal):
        return replace(event, candidates=fit.candidates, stray_rad=fit.stray_rad)
    if isinstance(fit, PeriodOnly):
        first = fit.gratings[0]
        return replace(
            event,
            period_mm=first.period_mm,
            period_sd_mm=first.period_sd_mm,
            period_min_mm=first.period_min_mm,
            period_max_mm=first.period_max_mm,
            angle_sd_deg=UNKNOWN_SD_DEG,
            candidates=fit.gratings if len(fit.gratings) > 1 else (),
        )
    event = replace(event, period_mm=fit.period_mm, period_sd_mm=fit.period_sd_mm)
    if fit.speed_mm_s > 0 and not fit.uses_given_speed:
        found_mm_s, sd_mm_s = fit.speed_mm_s, fit.speed_sd_mm_s
        event = replace(event, speed_mm_s=found_mm_s, speed_sd_mm_s=sd_mm_s, speed_source="estimated")
    return replace(event, angle_deg=fit.angle_deg, angle_sd_deg=fit.angle_sd_deg, stray_rad=fit.stray_rad)

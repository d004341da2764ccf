"""Texture events: what a fit made of a window, as subscribers see it."""

from dataclasses import replace
from typing import NamedTuple

from tactiled.detect.grooves.outcome import Outcome, PeriodOnly, Refusal
from tactiled.events.types import UNKNOWN_SD_DEG, TextureEvent

ESTIMATOR = "joint"


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
        estimator=ESTIMATOR,
    )
    if span.given_speed_mm_s > 0:
        event = replace(
            event,
            speed_mm_s=span.given_speed_mm_s,
            speed_sd_mm_s=speed_sd_mm_s,
            speed_source="given",
        )
    if isinstance(fit, Refusal):
        return replace(event, candidates=fit.candidates, stray_rad=fit.stray_rad)
    event = replace(event, period_mm=fit.period_mm, period_sd_mm=fit.period_sd_mm)
    if isinstance(fit, PeriodOnly):
        shortest_mm, longest_mm = fit.period_range_mm
        return replace(
            event,
            period_min_mm=shortest_mm,
            period_max_mm=longest_mm,
            angle_sd_deg=UNKNOWN_SD_DEG,
            candidates=fit.candidates,
        )
    if fit.speed_mm_s > 0 and not fit.uses_given_speed:
        event = replace(
            event,
            speed_mm_s=fit.speed_mm_s,
            speed_sd_mm_s=fit.speed_sd_mm_s,
            speed_source="estimated",
        )
    return replace(event, angle_deg=fit.angle_deg, angle_sd_deg=fit.angle_sd_deg, stray_rad=fit.stray_rad)

"""Windows that are asked for their grating: the answer beside the truth.

Every function here makes its trials from a seed: the same arguments, the same trials. An answer is wrong, as
against inexact, when somewhere on the array its groove phase is more than a quarter turn off: it then sits on
another lobe of the likelihood, which is what an unresolved integer ambiguity looks like.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.texture import grooveless
from bench.texture.signal import ARRAY, RATE_HZ, Bound, Wave, bound, draw_grating, readings
from tactiled.array import FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.grooves.window import FitWindow

Quantity = Literal["period", "angle"]
QUANTITIES: tuple[Quantity, ...] = ("period", "angle")
MIN_PERIODS = 3.0  # in a window: the aims are stated from here on
_WRONG_TURNS = 0.25
_FREE_EVERY = 5  # one trial of the grid in five may have fewer periods
_NAN = float("nan")


@dataclass(frozen=True)
class Estimate:
    """Period (mm) or angle (degrees) of a window; NaN where it was not answered."""

    error: float = _NAN  # signed
    # sd, bound: the sigma that the answer states, and the least that any unbiased estimator has
    sd: float = _NAN
    bound: float = _NAN


@dataclass(frozen=True)
class Trial:
    """One window and its answer."""

    window_s: float
    is_speed_known: bool
    status: str
    period: Estimate = Estimate()
    angle: Estimate = Estimate()
    is_wrong: bool = False  # "ok", and on another lobe; or "ok" where there are no grooves
    # snr_db, periods: of a cell of the grid: noise, and number of periods in the window
    snr_db: float = _NAN
    periods: float = _NAN

    def of(self, quantity: Quantity) -> Estimate:
        """Return the estimate of the period or of the angle."""
        return self.period if quantity == "period" else self.angle


def compare(answer: GrooveAnswer | Refusal, wave: Wave, least: Bound, /, **fields: Any) -> Trial:
    """Put an answer beside the truth and the bound; `fields` are the other ones of `Trial`."""
    if isinstance(answer, Refusal):
        return Trial(status=answer.status, **fields)
    period_bound_mm, angle_bound_deg = least
    angle_deg = (answer.angle_deg - wave.angle_deg + 90) % 180 - 90  # a groove normal has no sense
    return Trial(
        status="ok",
        period=Estimate(answer.period_mm - wave.period_mm, answer.period_sd_mm, period_bound_mm),
        angle=Estimate(angle_deg, answer.angle_sd_deg, angle_bound_deg),
        is_wrong=turns_off(wave, answer.period_mm, answer.angle_deg) > _WRONG_TURNS,
        **fields,
    )


def turns_off(wave: Wave, period_mm: float, angle_deg: float) -> float:
    """Largest error of an answer's groove phase on the array, in turns, its middle in phase."""
    true, found = _per_mm(wave.period_mm, wave.angle_deg), _per_mm(period_mm, angle_deg)
    found = found if found @ true >= 0 else -found
    places = np.column_stack([ARRAY.x_mm - ARRAY.x_mm.mean(), ARRAY.y_mm - ARRAY.y_mm.mean()])
    return float(np.abs(places @ (found - true)).max())


def _per_mm(period_mm: float, angle_deg: float) -> FloatArray:
    angle = np.radians(angle_deg)
    return np.array([np.cos(angle), np.sin(angle)]) / period_mm


def joint(
    volts: FloatArray, offset_s: FloatArray, wave: Wave, *, is_speed_known: bool
) -> GrooveAnswer | Refusal:
    """Fit one window (n, channels) by the core of the joint estimator.

    Of the wave it is given the direction of motion, and the speed where that is known.
    """
    motion = WaveMotion(wave.speed_mm_s if is_speed_known else 0.0, 0.0, wave.direction_deg, 0.0)
    time_s = np.arange(len(volts)) / RATE_HZ
    return fit_wave(FitWindow(volts, time_s, offset_s, channel_layout(ARRAY), motion, WaveParams()))


def grid_trial(window_s: float, snr_db: float, is_speed_known: bool, seed: int) -> Trial:
    """Ask the joint fit for a drawn grating in white noise."""
    rng = np.random.default_rng([seed, round(10 * window_s), round(snr_db) + 100, is_speed_known])
    periods = 0.0 if seed % _FREE_EVERY == _FREE_EVERY - 1 else MIN_PERIODS
    grating = draw_grating(rng, window_s, snr_db, periods)
    volts = readings(grating, rng)
    answer = joint(volts, grating.sensed.offset_s, grating.wave, is_speed_known=is_speed_known)
    least = bound(grating.wave, grating.sensed, grating.time_s, is_speed_known=is_speed_known)
    fields = {"window_s": window_s, "is_speed_known": is_speed_known, "snr_db": snr_db}
    return compare(answer, grating.wave, least, periods=grating.periods, **fields)


def grooveless_trial(name: str, is_speed_known: bool, seed: int) -> Trial:
    """Ask the joint fit for the grating of a surface without one: any answer is wrong."""
    rng = np.random.default_rng([seed, *name.encode(), is_speed_known])
    volts, offset_s = grooveless.readings(name, rng)
    slide = Wave(1.0, 0.0, grooveless.SPEED_MM_S)  # of which the period is not asked
    answer = joint(volts, offset_s, slide, is_speed_known=is_speed_known)
    return Trial(grooveless.WINDOW_S, is_speed_known, answer.status, is_wrong=answer.status == "ok")

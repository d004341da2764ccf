"""Windows that are asked for their grating: the answer beside the truth.

Every function here makes its trials from a seed: the same arguments, the same trials. An answer is wrong, as
against inexact, when somewhere on the array its groove phase is more than a quarter turn off: it then sits on
another lobe of the likelihood, which is what an unresolved integer ambiguity looks like.

Slides (`track_trials`) are seen as they would be live, and each of their answers is a window that is counted.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bench.texture import grooveless
from bench.texture.signal import RATE_HZ, Bound, Wave, bound, draw_grating, readings, scan_times_s
from tactiled.array import FloatArray, load_array
from tactiled.detect.grooves.estimator import JointTexture
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal
from tactiled.detect.grooves.params import JointParams, WaveParams
from tactiled.detect.grooves.window import FitWindow
from tactiled.detect.signal.slip_gate import KnownSliding, KnownSlips
from tactiled.events.types import TextureEvent
from tactiled.samples.block import regular_block

Quantity = Literal["period", "angle"]
GratingAnswer = GrooveAnswer | Refusal | TextureEvent
QUANTITIES: tuple[Quantity, ...] = ("period", "angle")
ARRAY = load_array("wang2019-3x3")
MIN_PERIODS = 3.0  # in a window: the aims are stated from here on
MEMORIES = (0.9, 0.97)  # of noise from scan to scan: 0.1 s and 0.33 s at 100 Hz
COLOURED_WINDOWS_S = (1.0, 2.0)
COLOURED_SNRS_DB = (10.0, 15.0, 20.0)
SLIDE_S = 12.6
COMPARED_S = (2.0, 5.0, 8.0, 12.0)  # ends of the windows that are set over the bound, since the slide began
_GAINS = (0.7, 1.3)
_SLIDE_PARAMS = JointParams(settle_s=0.0)
_WRONG_TURNS = 0.25
_FREE_EVERY = 5  # one trial of the grid in five may have fewer periods
_SLOW_HZ = 5.0  # ripples are slower: there such noise has most of its power (80 % and 94 %)
_NAN = float("nan")


@dataclass(frozen=True)
class Estimate:
    """Period (mm) or angle (degrees) of a window; NaN where it was not answered, or the bound not asked."""

    error: float = _NAN  # signed
    # sd, bound: the sigma that the answer states, and the least that any unbiased estimator has
    sd: float = _NAN
    bound: float = _NAN


@dataclass(frozen=True)
class Trial:
    """One window and its answer."""

    noise: str  # or surface
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


def compare(answer: GratingAnswer, wave: Wave, least: Bound | None = None, /, **fields: Any) -> Trial:
    """Put an answer beside the truth and the bound; `fields` are the other ones of `Trial`."""
    if isinstance(answer, Refusal) or answer.status != "ok":
        return Trial(status=answer.status, **fields)
    period_bound_mm, angle_bound_deg = least if least is not None else (_NAN, _NAN)
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
    grating = draw_grating(ARRAY, rng, window_s, snr_db, periods)
    volts = readings(grating, rng)
    answer = joint(volts, grating.sensed.offset_s, grating.wave, is_speed_known=is_speed_known)
    least = None
    if answer.status == "ok":
        least = bound(grating.wave, grating.sensed, grating.time_s, is_speed_known=is_speed_known)
    fields = {"window_s": window_s, "is_speed_known": is_speed_known, "snr_db": snr_db}
    return compare(answer, grating.wave, least, noise=noise_name(0.0), periods=grating.periods, **fields)


def noise_name(memory: float) -> str:
    """Name of the noise whose autoregression has this coefficient."""
    return f"AR(1), {memory:g}" if memory else "white noise"


def coloured_trial(memory: float, seed: int) -> Trial:
    """Ask the joint fit for a short window of a few periods in autocorrelated noise.

    There phases are told apart worst, and windows are cheap. Such noise (an autoregression of order 1 in each
    channel) has its power where ripples are slow, and lends false lines. Odd seeds are given the speed.
    """
    rng = np.random.default_rng([seed, round(100 * memory)])
    window_s, snr_db = float(rng.choice(COLOURED_WINDOWS_S)), float(rng.choice(COLOURED_SNRS_DB))
    is_known = seed % 2 == 1
    grating = draw_grating(ARRAY, rng, window_s, snr_db, MIN_PERIODS, _SLOW_HZ)
    volts = readings(grating, rng, memory)
    answer = joint(volts, grating.sensed.offset_s, grating.wave, is_speed_known=is_known)
    fields = {"window_s": window_s, "snr_db": snr_db, "periods": grating.periods}
    return compare(answer, grating.wave, noise=noise_name(memory), is_speed_known=is_known, **fields)


def grooveless_trial(name: str, is_speed_known: bool, seed: int) -> Trial:
    """Ask the joint fit for the grating of a surface without one: any answer is wrong."""
    volts, offset_s = grooveless.readings(name, ARRAY, np.random.default_rng(seed))
    slide = Wave(1.0, 0.0, grooveless.SPEED_MM_S)  # of which the period is not asked
    answer = joint(volts, offset_s, slide, is_speed_known=is_speed_known)
    return Trial(name, grooveless.WINDOW_S, is_speed_known, answer.status, is_wrong=answer.status == "ok")


def track_trials(snr_db: float, memory: float, seed: int) -> list[Trial]:
    """Answers and refusals of a slide over one grating; odd seeds are given the speed.

    Those at `COMPARED_S` have their bound, where the noise is white.
    """
    rng = np.random.default_rng([seed, round(snr_db) + 100, round(100 * memory)])
    grating = draw_grating(ARRAY, rng, COMPARED_S[0], snr_db, MIN_PERIODS)
    wave, time_s = grating.wave, scan_times_s(SLIDE_S)
    gain = rng.uniform(*_GAINS, ARRAY.n_channels)
    sensed = replace(grating.sensed, amplitude_volts=gain * grating.sensed.amplitude_volts)
    grating = replace(grating, sensed=sensed, time_s=time_s)
    is_known = seed % 2 == 1
    # The direction is configured: that of a slip is less sure, and would leave a known speed nothing to tie.
    params = _SLIDE_PARAMS.model_copy(update={"direction_deg": wave.direction_deg})
    volts = readings(grating, rng, memory)
    events = online_answers(params, volts, sensed.offset_s, wave, is_speed_known=is_known)
    longest_s, noise = params.criteria.max_window_s, noise_name(memory)
    trials = []
    for event in events:
        end_s = round(event.time_s + 1 / RATE_HZ, 3)
        used_s = time_s[(time_s >= end_s - longest_s - 1e-9) & (time_s < end_s - 1e-9)]
        least = None
        if event.status == "ok" and not memory and end_s in COMPARED_S:
            least = bound(wave, sensed, used_s, is_speed_known=is_known)
        fields = {"is_speed_known": is_known, "window_s": end_s, "snr_db": snr_db}
        trials.append(compare(event, wave, least, noise=noise, **fields))
    return trials


def online_answers(
    params: JointParams, volts: FloatArray, offset_s: FloatArray, wave: Wave, *, is_speed_known: bool
) -> Iterator[TextureEvent]:
    """Events of the online estimator, in blocks of ten scans as they would come live, the slip given."""
    estimator, slips = JointTexture(ARRAY, params), KnownSlips(KnownSliding())
    if is_speed_known:
        estimator.set_speed(wave.speed_mm_s, 0)
    block = regular_block(volts, RATE_HZ, channel_offset_s=offset_s)
    for first in range(0, len(block), 10):
        part = block[first : first + 10]
        events = estimator.process(part, slips.process(part))
        yield from (event for event in events if isinstance(event, TextureEvent))

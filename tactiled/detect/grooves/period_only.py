"""Period of grooves whose angle cannot be told.

Without shear channels or with unknown places, the phases of a window give no wave vector. Its lines
(`lines`) still give the frequency f of the ripple, and a known speed v bounds the period: grooves whose
normal is tilted from the motion by t have the period v cos(t) / f. So the period is within
``[v cos(max_tilt_deg) / f, v / f]`` and within the permitted periods. Stated is the upper end, which is that
of motion across the grooves where that is permitted. Without a speed the answer is "ambiguous", with the
frequency alone.

Phases still tell grooves from a machine. Where the strongest swing moves all channels at once, it may be
the load as a whole, with a motor or an arm, and the answer is "machine", unless a line that travels is the
strongest of what is left beside that swing and its harmonics. What is slower than a few
periods in the window and changes more than a line is no drift but a ripple that the window is too short for:
"too-few-periods".

Ripples above 0.45 of the scan rate are taken for slower ones: unlike phases, a line does not show aliasing.
"""

from dataclasses import replace

import numpy as np

from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.lines import SpectralLine, spectral_lines, strongest_swing, swing_spectrum
from tactiled.detect.grooves.model import ALIASED
from tactiled.detect.grooves.outcome import GrooveAnswer, Outcome, PeriodOnly, Refusal
from tactiled.detect.grooves.window import FitWindow
from tactiled.events.types import Candidate

# choice: probability of a line in one window of noise. Windows of a slide overlap and are tested every 0.2 s:
# about ten are independent, so that 1 slide in 1000 over a flat surface has an answer.
_FALSE_ALARMS = 1e-4
# prior: power of a fundamental over that of the strongest harmonic. Ridges that every second one is a little
# higher than the other have less.
_LEAST_FUNDAMENTAL = 0.1
_MOST_MULTIPLE = 3  # prior: a higher harmonic is never the strongest line of a ridge
_SAME_LINE_PERIODS = 1.5  # derived: in the window: lines of a Hann window that are nearer are one
# prior: a joint answer may exceed the period of motion across the grooves by this: the given speed has an
# error.
_SPEED_ERROR = 1.1
# tuned: channels that swing at once may do so because the load as a whole does, with a motor or an arm. Over
# a length L along the motion, grooves of period D give sin(2 pi L / D) / (2 pi L / D) of the power in phase:
# 0.8 at D = 5.6 L. Set on the recordings of FabricSlide and BioTac_slide_20_50.
_MOST_IN_PHASE = 0.8
_INTERVAL_SDS = 2.0  # choice: standard deviations that widen the interval of the period at both ends


def fit_wave_or_line(window: FitWindow) -> Outcome:
    """Fit one window jointly, and where that has no answer, by its lines."""
    fit = fit_wave(window) if len(window.layout.places_mm) > 1 else Refusal("ambiguous")
    if isinstance(fit, GrooveAnswer) and _agrees(fit, window):
        return fit
    line = fit_line(window)
    return line if line.frequency_hz > 0 or fit.status == "ok" else fit


def fit_line(window: FitWindow) -> PeriodOnly | Refusal:
    """Fit one window by its lines alone."""
    readings, chosen = window.good_readings()
    if not len(chosen):
        return Refusal("saturated")
    duration_s = window.duration_s
    band_hz = _band_hz(window, (len(readings) - 1) / duration_s if duration_s > 0 else 0.0)
    spectrum = swing_spectrum(readings)
    lines = spectral_lines(spectrum, window.time_s, _FALSE_ALARMS, band_hz)
    band_cycles = band_hz[0] * duration_s, band_hz[1] * duration_s
    strongest = strongest_swing(spectrum, band_cycles)
    waves = [line for line in lines if line.in_phase <= _MOST_IN_PHASE]
    if strongest.in_phase > _MOST_IN_PHASE:
        beside = strongest_swing(spectrum, band_cycles, without=strongest.cycles)
        is_line = bool(waves) and abs(waves[0].frequency_hz * duration_s - beside.cycles) < _SAME_LINE_PERIODS
        if beside.in_phase > _MOST_IN_PHASE or not is_line:
            return Refusal("machine", strongest.cycles / duration_s)
    if not waves:
        return Refusal("too-few-periods" if strongest.is_slow else "low-snr")
    gratings = _fundamentals(waves, _SAME_LINE_PERIODS / duration_s)
    if gratings[0].over_others < 1.0:
        return Refusal("too-few-periods")
    if window.motion.speed_mm_s == 0:
        return Refusal("ambiguous", gratings[0].frequency_hz, float(10 * np.log10(gratings[0].power)))
    answers = [_of_line(line, window) for line in gratings]
    return replace(answers[0], candidates=_candidates(gratings, answers))


def period_range(frequency_hz: float, speed_mm_s: float, max_tilt_deg: float) -> tuple[float, float]:
    """Shortest and longest period (mm) of a frequency, for all tilts up to a bound."""
    longest = speed_mm_s / frequency_hz
    return longest * float(np.cos(np.radians(max_tilt_deg))), longest


def _agrees(fit: GrooveAnswer, window: FitWindow) -> bool:
    """Return True where a joint answer is possible with the given speed."""
    speed_mm_s = window.motion.speed_mm_s
    if speed_mm_s == 0:
        return True
    shortest, longest = period_range(fit.frequency_hz, speed_mm_s, window.params.max_tilt_deg)
    return shortest / _SPEED_ERROR <= fit.period_mm <= longest * _SPEED_ERROR


def _band_hz(window: FitWindow, rate_hz: float) -> tuple[float, float]:
    """Frequencies at which grooves within the limits can pass."""
    motion, params = window.motion, window.params
    fastest = ALIASED * rate_hz
    if motion.speed_mm_s == 0:
        return 0.0, fastest
    slowest = motion.speed_mm_s * float(np.cos(np.radians(params.max_tilt_deg))) / params.max_period_mm
    return slowest / _SPEED_ERROR, min(fastest, _SPEED_ERROR * motion.speed_mm_s / params.min_period_mm)


def _fundamentals(lines: list[SpectralLine], apart_hz: float) -> list[SpectralLine]:
    """Lines without the harmonics of others, the grating with the strongest line first."""
    left, found = list(lines), []
    while left:
        strongest = left[0]
        below = [
            line
            for line in left[1:]
            for multiple in range(2, _MOST_MULTIPLE + 1)
            if abs(multiple * line.frequency_hz - strongest.frequency_hz) < apart_hz
            and line.power >= _LEAST_FUNDAMENTAL * strongest.power
        ]
        fundamental = min(below, key=lambda line: line.frequency_hz, default=strongest)
        found.append(fundamental)
        left = [line for line in left if not _is_multiple(line, fundamental, apart_hz)]
    return found


def _is_multiple(line: SpectralLine, fundamental: SpectralLine, apart_hz: float) -> bool:
    multiple = max(1, round(line.frequency_hz / fundamental.frequency_hz))
    return abs(line.frequency_hz - multiple * fundamental.frequency_hz) < apart_hz


def _of_line(line: SpectralLine, window: FitWindow) -> PeriodOnly:
    motion, params = window.motion, window.params
    relative = line.frequency_sd_hz / line.frequency_hz
    shortest, longest = period_range(line.frequency_hz, motion.speed_mm_s, params.max_tilt_deg)
    sd_mm = float(np.hypot(longest * relative, motion.speed_sd_mm_s / line.frequency_hz))
    period_mm = min(longest, params.max_period_mm)  # shorter than `longest`: the grooves are tilted
    low_mm = max(shortest - _INTERVAL_SDS * sd_mm, min(params.min_period_mm, period_mm))
    high_mm = min(longest + _INTERVAL_SDS * sd_mm, params.max_period_mm)
    return PeriodOnly(
        frequency_hz=line.frequency_hz,
        snr_db=float(10 * np.log10(line.power)),
        period_mm=period_mm,
        period_sd_mm=sd_mm,
        period_range_mm=(low_mm, high_mm),
    )


def _candidates(gratings: list[SpectralLine], answers: list[PeriodOnly]) -> tuple[Candidate, ...]:
    """All gratings in view, where there are several, weighted by their shares of the power."""
    if len(gratings) < 2:
        return ()
    total = sum(line.power for line in gratings)
    return tuple(
        Candidate(
            period_mm=answer.period_mm,
            angle_deg=0.0,
            weight=line.power / total,
            period_sd_mm=answer.period_sd_mm,
            period_min_mm=answer.period_range_mm[0],
            period_max_mm=answer.period_range_mm[1],
        )
        for line, answer in zip(gratings, answers, strict=True)
    )

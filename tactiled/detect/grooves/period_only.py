"""Period of grooves whose angle cannot be told, from the spectral lines of all channels together.

Without shear channels, with unknown places, or where all channels feel the ripple at the same time, phases
give no wave vector. A narrow line still shows that the skin slides over something periodic. Its frequency f
is that of the ripple, and a known speed v bounds the period: grooves whose normal is tilted from the motion
by t have the period v cos(t) / f. So the period is within ``[v cos(max_tilt_deg) / f, v / f]`` and within the
permitted periods. Stated is the upper end, that of motion across the grooves where that is permitted. Without
a speed the answer is "ambiguous", with the frequency alone.

1. Each channel loses a cubic trend and gets a Hann window. Lines are bins that stand out of noise of an even
   colour (`_pooled_power`, `_significant_bins`). Without this rule, 12 of the 24 slides of FabricSlide have
   the right period and 6 a wrong one; with all rules 24 and 0.
2. Uneven ridges on a rough surface widen the line, and their noise is shared and far from even: then no line
   is significant. Where the strongest bin of the summed spectrum has `_STANDS_OUT` times the power of any
   other, except its own lobe and its harmonics, that bin is the line. A slope has no such bin, and a
   resonance is wider than the lobe where the window holds enough of its periods. Without this rule, 19 of
   the 24 are right and none is wrong.
3. Noise of a skin lies between white and a random walk: towards higher frequencies its power does not rise,
   and the power of its changes does not fall. A bin that is stronger than a line by that measure, in the unit
   of the readings, is no noise beside it but a signal that is not explained: "too-few-periods". Without this
   rule, 21 of the 24 are right and 3 wrong.
4. Phases still tell grooves from a machine. Where the strongest swing, or one of which it is a harmonic,
   moves all channels at once, it may be the load as a whole, with a motor or an arm, and the answer is
   "machine", unless a line that travels is the strongest of what is left beside that swing and its harmonics.

Ripples above 0.45 of the scan rate are taken for slower ones, unless phases show it ("aliased"): a line does
not show aliasing.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import ALIASED, TINY
from tactiled.detect.grooves.outcome import GrooveAnswer, Outcome, PeriodOnly, Refusal
from tactiled.detect.grooves.swings import (
    HARMONICS,
    LEAST_CYCLES,
    LOBE,
    SwingSpectrum,
    apart_from,
    swing_spectrum,
)
from tactiled.detect.grooves.window import FitWindow
from tactiled.events.types import Candidate

# choice: probability of a line in one window of noise. Windows of a slide overlap and are tested every 0.2 s:
# about ten are independent, so that 1 slide in 1000 over a flat surface has an answer.
_FALSE_ALARMS = 1e-4
# prior: power of a fundamental over that of the strongest harmonic. Ridges that every second one is a little
# higher than the other have less.
_LEAST_FUNDAMENTAL = 0.1
_SAME_LINE_PERIODS = 1.5  # derived: in the window: lines of a Hann window that are nearer are one
# prior: a joint answer may exceed the period of motion across the grooves by this: the given speed has an
# error.
_SPEED_ERROR = 1.1
# tuned: channels that swing at once may do so because the load as a whole does, with a motor or an arm. Over
# a length L along the motion, grooves of period D give sin(2 pi L / D) / (2 pi L / D) of the power in phase:
# 0.8 at D = 5.6 L. Set on the recordings of FabricSlide and BioTac_slide_20_50.
_MOST_IN_PHASE = 0.8
_INTERVAL_SDS = 2.0  # choice: standard deviations that widen the interval of the period at both ends
# physical: a Hann window uses the ends of the signal little, which costs 1.4 to 1.5; noise that channels
# share and stamps that jitter by a tenth cost up to 1.4 more (research/README.md, `sensors`).
_SD_OVER_BOUND = 2.0
# tuned: power of the strongest bin over any other, and least periods. Of 6000 windows of noise that all
# channels share (178 scans, power over frequency with slopes of 0.5, 1 and 2), 9 have such a bin with 7
# periods or more, 36 with 6, 121 with 5; an answer needs it in two windows at one place. Set on
# the recordings of FabricSlide and BioTac_slide_20_50.
_STANDS_OUT = 5.0
_LEAST_PHASES = 4  # derived: channels: phases of fewer agree by chance
_LEAST_DOMINANT_CYCLES = 7  # tuned: on the same recordings
# tuned: the level has 3 coefficients, and each line takes 5 bins. With 24 bins and a level of 5 coefficients,
# resonances passed for lines on 4 of 8 slides (the same bench, seeds 0 to 3 at 20 and 100 Hz); 40 bins are
# 2.4 s at 35.6 Hz.
_LEAST_BINS = 40
# prior: bins to either side whose level a line must exceed: enough for a t test with few degrees of freedom
# lost, and so few that a parabola follows a resonance that is as wide as ten bins.
_AROUND = 20


class SpectralLine(NamedTuple):
    """Line of the pooled spectrum."""

    frequency_hz: float
    frequency_sd_hz: float
    over_noise: float  # power over that of the noise beside it, summed over the channels
    # Its power over what noise between white and a random walk would have at its frequency, if the strongest
    # bin that belongs to no line were that noise
    over_others: float
    # Part of its power with which all channels swing at once, in phase or opposite, from 0 to 1, each channel
    # by its own size; 0 where channels are too few to tell
    in_phase: float


def fit_wave_or_line(window: FitWindow) -> Outcome:
    """Fit one window jointly, and where that has no answer, by its lines, unless these are aliased."""
    fit = fit_wave(window) if len(window.layout.places_mm) > 1 else Refusal("ambiguous")
    if fit.status == "aliased" or (isinstance(fit, GrooveAnswer) and _agrees(fit, window)):
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
    lines = spectral_lines(spectrum, window.time_s, band_hz)
    waves = [line for line in lines if line.in_phase <= _MOST_IN_PHASE]
    # What stands out from noise midway between white and a random walk has the largest power times frequency.
    bins = np.arange(len(spectrum.values))
    swing = bins * (np.abs(spectrum.values) ** 2).sum(axis=1)
    in_band = (bins >= max(LEAST_CYCLES, band_hz[0] * duration_s)) & (bins <= band_hz[1] * duration_s)
    if not in_band.any():
        return Refusal("too-few-periods" if band_hz[1] * duration_s < LEAST_CYCLES else "aliased")
    strongest = int(np.argmax(np.where(in_band, swing, 0.0)))
    machine = _machine_bin(spectrum, strongest)
    if machine is not None:
        beside = int(np.argmax(np.where(in_band & apart_from(bins, machine), swing, 0.0)))
        is_line = bool(waves) and abs(waves[0].frequency_hz * duration_s - beside) < _SAME_LINE_PERIODS
        if _in_phase(spectrum.values[beside], spectrum.sd) > _MOST_IN_PHASE or not is_line:
            return Refusal("machine", machine / duration_s)
    if not waves:
        is_slow = int(np.argmax(swing)) < _LEAST_DOMINANT_CYCLES
        return Refusal("too-few-periods" if is_slow else "low-snr")
    gratings = _fundamentals(waves, _SAME_LINE_PERIODS / duration_s)
    if gratings[0].over_others < 1.0:
        return Refusal("too-few-periods")
    frequency_hz, snr_db = gratings[0].frequency_hz, float(10 * np.log10(gratings[0].over_noise))
    if window.motion.speed_mm_s == 0:
        return Refusal("ambiguous", frequency_hz, snr_db)
    power = sum(line.over_noise for line in gratings)
    periods = tuple(_period(line, window, line.over_noise / power) for line in gratings)
    return PeriodOnly(frequency_hz=frequency_hz, snr_db=snr_db, gratings=periods)


def _machine_bin(spectrum: SwingSpectrum, strongest: int) -> int | None:
    """Return the bin of a swing of all channels at once that is the strongest, or has it as a harmonic.

    A harmonic of a machine need not move all channels at once: it may tilt the skin.
    """
    power = (np.abs(spectrum.values) ** 2).sum(axis=1)
    found = [strongest]
    for harmonic in HARMONICS:
        if (first := round(strongest / harmonic)) >= _LEAST_DOMINANT_CYCLES:
            near = power[first - LOBE : first + LOBE + 1]
            peak = first - LOBE + int(np.argmax(near))
            if abs(peak - first) < LOBE and power[peak] >= _LEAST_FUNDAMENTAL * power[strongest]:
                found.append(peak)
    at_once = (at for at in found if _in_phase(spectrum.values[at], spectrum.sd) > _MOST_IN_PHASE)
    return next(at_once, None)


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
            for multiple in HARMONICS
            if abs(multiple * line.frequency_hz - strongest.frequency_hz) < apart_hz
            and line.over_noise >= _LEAST_FUNDAMENTAL * strongest.over_noise
        ]
        fundamental = min(below, key=lambda line: line.frequency_hz, default=strongest)
        found.append(fundamental)
        first_hz = fundamental.frequency_hz
        left = [
            line
            for line in left
            if abs(line.frequency_hz - max(1, round(line.frequency_hz / first_hz)) * first_hz) >= apart_hz
        ]
    return found


def _period(line: SpectralLine, window: FitWindow, weight: float) -> Candidate:
    """Period of a line at the given speed, with its interval."""
    motion, params = window.motion, window.params
    relative = line.frequency_sd_hz / line.frequency_hz
    shortest, longest = period_range(line.frequency_hz, motion.speed_mm_s, params.max_tilt_deg)
    sd_mm = float(np.hypot(longest * relative, motion.speed_sd_mm_s / line.frequency_hz))
    period_mm = min(longest, params.max_period_mm)  # shorter than `longest`: the grooves are tilted
    low_mm = max(shortest - _INTERVAL_SDS * sd_mm, min(params.min_period_mm, period_mm))
    high_mm = min(longest + _INTERVAL_SDS * sd_mm, params.max_period_mm)
    return Candidate(
        period_mm=period_mm,
        angle_deg=0.0,
        weight=weight,
        period_sd_mm=sd_mm,
        period_min_mm=low_mm,
        period_max_mm=high_mm,
    )


def spectral_lines(
    spectrum: SwingSpectrum, time_s: FloatArray, band_hz: tuple[float, float]
) -> list[SpectralLine]:
    """Return the lines of a window in a band of frequencies, the strongest first.

    The mean spacing of the instants (n,) of the scans sets the scale of frequency.
    """
    changes = spectrum.sd > 0
    readings, values, n = spectrum.readings[:, changes], spectrum.values[:, changes], len(time_s)
    bins = np.arange(len(values))
    # The bin at half the rate is real.
    kept = slice(LEAST_CYCLES, n // 2 if n % 2 == 0 else None)
    if not changes.any() or len(bins[kept]) < _LEAST_BINS:
        return []
    rate_hz, clock_sd = _mean_rate_hz(time_s)
    step_hz = rate_hz / n
    band_cycles = band_hz[0] / step_hz, band_hz[1] / step_hz
    found = _noisy_lines(readings, values[kept], bins[kept], band_cycles)
    found = found or _dominant_line(readings, values, band_cycles)
    absolute = (np.abs(values) ** 2).sum(axis=1)
    free = (np.abs(bins[:, np.newaxis] - [at for at, _ in found]) > LOBE).all(axis=1)
    lines = []
    for at, power in found:
        # Cramer-Rao bound of a line's frequency; a Hann window has 1.5 bins of noise.
        sd = np.hypot(_SD_OVER_BOUND * np.sqrt(6.0 / (1.5 * power)) / (2 * np.pi), at * clock_sd)
        swings = _phasors(readings, np.array([at]))[0]
        slower, faster = free & (bins < at), free & (bins > at) & (bins <= bins[kept][-1])
        level = max(
            float((bins[slower] ** 2 * absolute[slower]).max(initial=0.0)) / at**2,
            float(absolute[faster].max(initial=0.0)),
        )
        over_others = float((np.abs(swings) ** 2).sum()) / max(level, TINY)
        in_phase = _in_phase(swings, spectrum.sd[changes])
        lines.append(SpectralLine(at * step_hz, float(sd) * step_hz, power, over_others, in_phase))
    return sorted(lines, key=lambda line: -line.over_noise)


def _noisy_lines(
    readings: FloatArray,
    values: NDArray[np.complex128],
    cycles: NDArray[np.int64],
    band_cycles: tuple[float, float],
) -> list[tuple[float, float]]:
    """Cycles and power of the lines that stand out of noise of an even colour."""
    parabola = np.linalg.qr(np.vander(np.log(cycles), 3))[0]
    pooled = _pooled_power(values, parabola)
    in_band = (cycles >= band_cycles[0]) & (cycles <= band_cycles[1])
    found = []
    for peak in _significant_bins(np.cbrt(pooled), parabola, in_band):
        near = abs(cycles - cycles[peak])
        beside = (near > LOBE) & (near <= _AROUND)
        power = max(float(pooled[peak]) / float(pooled[beside].mean()) - 1.0, 0.1) * readings.shape[1]
        noise = (np.abs(values[beside]) ** 2).mean(axis=0)
        at = _refined(readings, float(cycles[peak]), floor=np.maximum(noise, noise.mean() * 1e-9))
        if at >= LEAST_CYCLES:
            found.append((at, power))
    return found


def _in_phase(swings: NDArray[np.complex128], size: FloatArray) -> float:
    """Part of the power of phasors (channels,) that lies along one direction or its opposite, from 0 to 1.

    Each channel counts by its own size (channels,), so that a loud one does not decide; one of size 0 is left
    out. 0, too, where channels are so few that phases agree by chance.
    """
    changes = size > 0
    if int(changes.sum()) < _LEAST_PHASES:
        return 0.0
    scaled = swings[changes] / size[changes]
    return float(np.abs((scaled**2).sum()) / max(float((np.abs(scaled) ** 2).sum()), TINY))


def _dominant_line(
    readings: FloatArray, values: NDArray[np.complex128], band_cycles: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return cycles and power of the strongest line if it stands out from all others."""
    n, variance = len(readings), readings.var(axis=0)
    power = (np.abs(values) ** 2 / variance).sum(axis=1)
    cycles = np.arange(len(power))
    is_possible = (cycles >= max(_LEAST_DOMINANT_CYCLES, band_cycles[0])) & (cycles < n // 2 - 1)
    is_possible &= cycles <= band_cycles[1]
    if not is_possible.any():
        return []
    peak = int(np.argmax(np.where(is_possible, power, 0.0)))
    others = (cycles >= LOBE) & (cycles < n // 2 - 1) & apart_from(cycles, peak)
    if not others.any() or power[peak] < _STANDS_OUT * float(power[others].max()):
        return []
    beside = others & (np.abs(cycles - peak) <= _AROUND)
    beside = beside if beside.any() else others
    # Texture is shared by the channels: they count as one.
    over = float(power[peak]) / float(power[beside].mean())
    return [(_refined(readings, float(peak), floor=variance), over)]


def _mean_rate_hz(time_s: FloatArray) -> tuple[float, float]:
    """Rate from the line through all instants, and its relative standard deviation by their jitter."""
    scans = np.arange(len(time_s)) - (len(time_s) - 1) / 2
    spacing_s = float((scans @ (time_s - time_s.mean())) / (scans @ scans))
    jitter_s = float((time_s - time_s.mean() - spacing_s * scans).std())
    return 1 / spacing_s, jitter_s / spacing_s / float(np.sqrt(scans @ scans))


def _phasors(readings: FloatArray, cycles: FloatArray) -> NDArray[np.complex128]:
    """Hann-windowed Fourier sums of each channel at frequencies between the bins: (frequencies, channels)."""
    n = len(readings)
    waves = np.exp(-2j * np.pi * np.outer(cycles, np.arange(n)) / n)
    return np.asarray(waves @ (np.hanning(n)[:, np.newaxis] * readings))


def _refined(readings: FloatArray, cycles: float, floor: FloatArray) -> float:
    """Cycles (in the window) of the largest power near a bin, each channel weighted by its noise."""
    scaled = readings / np.sqrt(floor)
    half = 1.0
    for _ in range(7):  # each pass narrows the interval fourfold
        tried = cycles + half * np.linspace(-1.0, 1.0, 9)
        power = (np.abs(_phasors(scaled, tried)) ** 2).sum(axis=1)
        cycles = float(tried[np.argmax(power)])
        half /= 4
    return cycles


def _pooled_power(spectra: NDArray[np.complex128], parabola: FloatArray) -> FloatArray:
    """Power of spectra (bins, channels) over their noise, mean of the channels (bins,): 1 without a line.

    The spectrum of each channel is divided by a floor: a parabola through the logarithm of power over the
    logarithm of frequency, which follows noise of any even colour.
    """
    power = np.abs(spectra) ** 2
    log_power = np.log(np.maximum(power, power.mean(axis=0) * 1e-12))
    pooled = (power / np.exp(parabola @ (parabola.T @ log_power))).mean(axis=1)
    return np.asarray(np.maximum(pooled, 1e-12))


def _significant_bins(y: FloatArray, parabola: FloatArray, in_band: NDArray[np.bool_]) -> list[int]:
    """Bins of the significant lines, in the order in which they were found.

    The cube root of pooled power is nearly normal (Wilson and Hilferty 1931). It is fitted by a parabola in
    the logarithm of frequency without the bins of lines found so far. A bin is a line where its externally
    studentised residual exceeds the t quantile of the permitted false alarms over the number of bins, against
    the whole spectrum and against the bins around it: a broad resonance passes the first test only.
    """
    bins = np.arange(len(y))
    chance = _FALSE_ALARMS / len(y)
    free = np.ones(len(y), dtype=np.bool_)  # bins of no line
    found: list[int] = []
    while (free & in_band).any():
        fitted = np.linalg.lstsq(parabola[free], y[free], rcond=None)[0]
        peak = int(np.argmax(np.where(free & in_band, y - parabola @ fitted, -np.inf)))
        is_own = abs(bins - peak) <= LOBE
        if _studentised(y, parabola, free & ~is_own, peak, chance) < 1.0:
            break
        found.append(peak)
        free &= ~is_own
    return [
        peak
        for peak in found
        if _studentised(y, parabola, free & (abs(bins - peak) <= _AROUND), peak, chance) >= 1.0
    ]


def _studentised(y: FloatArray, basis: FloatArray, rest: NDArray[np.bool_], at: int, chance: float) -> float:
    """Excess of a bin over a fit to others, in units of its standard deviation times the upper t quantile."""
    design = basis[rest]
    freedom = len(design) - design.shape[1]
    if freedom < 4:
        return 0.0
    fitted = np.linalg.lstsq(design, y[rest], rcond=None)[0]
    variance = float(((y[rest] - design @ fitted) ** 2).sum()) / freedom
    leverage = float(basis[at] @ np.linalg.solve(design.T @ design, basis[at]))
    sd = np.sqrt(max(variance, 1e-24) * (1 + leverage))
    return float((y[at] - basis[at] @ fitted) / sd / -special.stdtrit(freedom, chance))

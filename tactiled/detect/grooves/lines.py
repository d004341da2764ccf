"""Spectral lines of a window, from all channels together, without phases between them.

Where the places of the taxels are not known, or all channels feel the ripple at the same time, phases say
nothing of a wave vector. A narrow line in the spectrum still shows that the skin slides over something
periodic, and its frequency is that of the ripple.

1. Each channel loses a cubic trend and gets a Hann window. Lines are bins that stand out of noise of an even
   colour (`pooled_power`, `significant_bins`).
2. Uneven ridges on a rough surface widen the line, and their noise is shared and far from even: then no line
   is significant. Where the strongest bin of the summed spectrum has `_STANDS_OUT` times the power of any
   other, except its own lobe and its harmonics, that bin is the line. A slope has no such bin, and a
   resonance is wider than the lobe where the window holds enough of its periods.
3. Noise of a skin lies between white and a random walk: towards higher frequencies its power does not rise,
   and the power of its changes does not fall. A bin that is stronger than a line by that measure, in the unit
   of the readings, is no noise beside it but a signal that is not explained.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import TINY
from tactiled.detect.grooves.window import trend_basis

_TREND_ORDER = 3  # choice
# derived: periods in the window. A cubic trend leaves humps of fewer.
LEAST_CYCLES = 3.0
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
_TREND_CYCLES = 2  # derived: slower bins are of the trend
_LEAST_SD = 1e-12  # derived: of the readings: less is the rounding of the trend
# tuned: the level has 5 coefficients, and each line takes 5 bins. With 24 bins, resonances passed for lines
# on 4 of 8 slides (the same bench, seeds 0 to 3 at 20 and 100 Hz); 40 bins are 2.4 s at 35.6 Hz.
_LEAST_BINS = 40

_FLOOR_ORDER = 2  # choice
_LEVEL_ORDER = 4  # choice
LOBE = 2  # derived: bins to either side that a Hann window spreads a line over
_HARMONICS = (2, 3)  # choice
# prior: bins to either side whose level a line must exceed, and the order of the polynomial through them:
# enough for a t test with few degrees of freedom lost, and able to follow a resonance that is as wide as ten
# bins.
AROUND = 20
_AROUND_ORDER = 2  # choice
_MOST_LINES = 8  # prior: of two gratings with their harmonics


def pooled_power(spectra: NDArray[np.complex128], log_cycles: FloatArray) -> FloatArray:
    """Power (bins,) of spectra (bins, channels) over their own and their shared noise.

    The spectrum of each channel is divided by a floor: a parabola through the logarithm of power over the
    logarithm of frequency, which follows noise of any even colour. Noise that channels share is whitened by
    their coherence matrix C, shrunk towards the unit matrix by ``channels / (channels + bins)`` because few
    bins know it badly. T = z* C^-1 z / channels is then about 1 without a line.
    """
    m, c = spectra.shape
    power = np.abs(spectra) ** 2
    log_power = np.log(np.maximum(power, power.mean(axis=0) * 1e-12))
    basis = np.linalg.qr(np.polynomial.legendre.legvander(_scaled(log_cycles), _FLOOR_ORDER))[0]
    whitened = spectra / np.exp(basis @ (basis.T @ log_power) / 2)
    # Each bin counts once, however strong: a line is no noise that channels share.
    directions = whitened / np.maximum(np.linalg.norm(whitened, axis=1, keepdims=True), TINY)
    coherence = c * (directions.T @ directions.conj()) / m
    shrunk = c / (c + m)
    coherence = (1 - shrunk) * coherence + shrunk * np.eye(c)
    solved = np.linalg.solve(coherence, whitened.T).T
    pooled = (whitened.conj() * solved).real.sum(axis=1) / c
    return np.asarray(np.maximum(pooled, 1e-12))


def significant_bins(
    y: FloatArray, log_cycles: FloatArray, false_alarms: float, in_band: NDArray[np.bool_]
) -> list[int]:
    """Bins of the significant lines, in the order in which they were found.

    The cube root of T is nearly normal (Wilson and Hilferty 1931). It is fitted by a polynomial in the
    logarithm of frequency without the bins of lines found so far. A bin is a line where its externally
    studentised residual exceeds the t quantile of the permitted false alarms over the number of bins, against
    the whole spectrum and against the bins around it: a broad resonance passes the first test only.
    """
    basis = np.asarray(np.polynomial.legendre.legvander(_scaled(log_cycles), _LEVEL_ORDER), np.float64)
    bins = np.arange(len(y))
    chance = false_alarms / len(y)
    free = np.ones(len(y), dtype=np.bool_)  # bins of no line
    found: list[int] = []
    while len(found) < _MOST_LINES and (free & in_band).any():
        fitted = np.linalg.lstsq(basis[free], y[free], rcond=None)[0]
        peak = int(np.argmax(np.where(free & in_band, y - basis @ fitted, -np.inf)))
        is_own = abs(bins - peak) <= LOBE
        if _studentised(y, basis, free & ~is_own, peak, chance) < 1.0:
            break
        found.append(peak)
        free &= ~is_own
    near = basis[:, : _AROUND_ORDER + 1]
    return [
        peak
        for peak in found
        if _studentised(y, near, free & (abs(bins - peak) <= AROUND), peak, chance) >= 1.0
    ]


def _studentised(y: FloatArray, basis: FloatArray, rest: NDArray[np.bool_], at: int, chance: float) -> float:
    """Residual of a bin from a fit to others, over its standard deviation and the t quantile."""
    design = basis[rest]
    freedom = len(design) - design.shape[1]
    if freedom < 4:
        return 0.0
    fitted, _, rank, _ = np.linalg.lstsq(design, y[rest], rcond=None)
    if rank < design.shape[1]:
        return 0.0
    variance = float(((y[rest] - design @ fitted) ** 2).sum()) / freedom
    leverage = float(basis[at] @ np.linalg.solve(design.T @ design, basis[at]))
    sd = np.sqrt(max(variance, 1e-24) * (1 + leverage))
    return float((basis[at] @ fitted - y[at]) / sd / special.stdtrit(freedom, chance))


def noise_power(spectra: NDArray[np.complex128], beside: NDArray[np.bool_]) -> FloatArray:
    """Power (channels,) of the noise in the bins beside a line."""
    power = (np.abs(spectra[beside]) ** 2).mean(axis=0)
    return np.asarray(np.maximum(power, power.mean() * 1e-9))


def _scaled(x: FloatArray) -> FloatArray:
    """Map to -1..1."""
    return np.asarray(2 * (x - x[0]) / (x[-1] - x[0]) - 1)


@dataclass(frozen=True, eq=False)
class SwingSpectrum:
    """Readings of a window less a cubic trend, and their spectrum under a Hann window."""

    readings: FloatArray  # (n, channels)
    # (channels,): standard deviation of the readings; 0 where they change by no more than rounding
    sd: FloatArray
    values: NDArray[np.complex128]  # (bins, channels): bin b has b periods in the window


def swing_spectrum(readings: FloatArray) -> SwingSpectrum:
    """Spectrum of finite readings (n, channels), in any unit."""
    trend = trend_basis(len(readings), _TREND_ORDER)
    centred = readings - readings.mean(axis=0)
    centred = np.asarray(centred - trend @ (trend.T @ centred))
    sd, size = centred.std(axis=0), np.abs(readings).max(axis=0)
    values = np.fft.rfft(np.hanning(len(readings))[:, np.newaxis] * centred, axis=0)
    return SwingSpectrum(centred, np.where(sd > _LEAST_SD * size, sd, 0.0), values)


class SpectralLine(NamedTuple):
    """Line of the pooled spectrum."""

    frequency_hz: float
    frequency_sd_hz: float
    power: float  # power over the noise beside it, summed over the channels
    # Its power over what noise between white and a random walk would have at its frequency, if the strongest
    # bin that belongs to no line were that noise
    over_others: float
    # Part of its power with which all channels swing at once, in phase or opposite, from 0 to 1, each channel
    # by its own size; 0 where channels are too few to tell
    in_phase: float


def spectral_lines(
    spectrum: SwingSpectrum, time_s: FloatArray, false_alarms: float, band_hz: tuple[float, float]
) -> list[SpectralLine]:
    """Return the lines of a window, the strongest first.

    Parameters
    ----------
    time_s : (n,) float64
        Instants of the scans; their mean spacing sets the scale of frequency.
    false_alarms : float
        Probability of a line in a window of noise.
    band_hz : tuple of float
        Lowest and highest frequency of a line.

    Examples
    --------
    Sixteen channels that share a ripple of 3.3 Hz, two fifths of the noise of each, for 8 s at 35.6 Hz:

    >>> import numpy as np
    >>> rng, time_s = np.random.default_rng(0), np.arange(285) / 35.6
    >>> ripple = np.cos(2 * np.pi * 3.3 * time_s[:, np.newaxis] + rng.uniform(0, 6, 16))
    >>> readings = 500 + 8 * ripple + 20 * rng.standard_normal((285, 16))
    >>> line = spectral_lines(swing_spectrum(readings), time_s, 1e-4, (0.0, 17.0))[0]
    >>> print(f"{line.frequency_hz:.2f} +- {line.frequency_sd_hz:.2f} Hz")
    3.30 +- 0.01 Hz
    """
    changes = spectrum.sd > 0
    readings, values, n = spectrum.readings[:, changes], spectrum.values[:, changes], len(time_s)
    bins = np.arange(len(values))
    kept = slice(
        int(np.ceil(LEAST_CYCLES)), n // 2 if n % 2 == 0 else None
    )  # the bin at half the rate is real
    if not changes.any() or len(bins[kept]) < _LEAST_BINS:
        return []
    rate_hz, clock_sd = _mean_rate_hz(time_s)
    step_hz = rate_hz / n
    found = _noisy_lines(readings, values[kept], bins[kept], false_alarms, np.array(band_hz) / step_hz)
    found = found or _dominant_line(readings, (band_hz[0] / step_hz, band_hz[1] / step_hz))
    absolute, free = (np.abs(values) ** 2).sum(axis=1), np.ones(len(bins), dtype=np.bool_)
    for at, _ in found:
        free &= np.abs(bins - at) > LOBE
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
    return sorted(lines, key=lambda line: -line.power)


def _noisy_lines(
    readings: FloatArray,
    values: NDArray[np.complex128],
    cycles: NDArray[np.int64],
    false_alarms: float,
    band_cycles: FloatArray,
) -> list[tuple[float, float]]:
    """Cycles and power of the lines that stand out of noise of an even colour."""
    pooled = pooled_power(values, np.log(cycles))
    in_band = (cycles >= band_cycles[0]) & (cycles <= band_cycles[1])
    found = []
    for peak in significant_bins(np.cbrt(pooled), np.log(cycles), false_alarms, in_band):
        near = abs(cycles - cycles[peak])
        beside = (near > LOBE) & (near <= AROUND)
        power = max(float(pooled[peak]) / float(pooled[beside].mean()) - 1.0, 0.1) * readings.shape[1]
        at = _refined(readings, float(cycles[peak]), floor=noise_power(values, beside))
        if at >= LEAST_CYCLES:
            found.append((at, power))
    return found


class StrongestSwing(NamedTuple):
    """The bins of the spectrum that stand out most from noise midway between white and a random walk."""

    is_slow: bool  # True where the strongest of all has too few periods to stand out as a line
    cycles: int  # periods in the window of the strongest in the band
    in_phase: float  # of that one; see `SpectralLine`


def strongest_swing(
    spectrum: SwingSpectrum, band_cycles: tuple[float, float], without: int | None = None
) -> StrongestSwing:
    """Find the strongest swings, those of the largest power times frequency.

    Parameters
    ----------
    without : int, optional
        Periods in the window of a swing that is left out, with its harmonics.
    """
    cycles = np.arange(len(spectrum.values))
    swing = cycles * (np.abs(spectrum.values) ** 2).sum(axis=1)
    if without is not None:
        swing[np.abs(cycles - without) <= LOBE] = 0.0
        for harmonic in _HARMONICS:
            swing[np.abs(cycles - harmonic * without) <= harmonic + 1] = 0.0
    in_band = (cycles >= max(LEAST_CYCLES, band_cycles[0])) & (cycles <= band_cycles[1])
    strongest = int(np.argmax(np.where(in_band, swing, 0.0)))
    is_slow = int(np.argmax(swing)) < _LEAST_DOMINANT_CYCLES
    return StrongestSwing(is_slow, strongest, _in_phase(spectrum.values[strongest], spectrum.sd))


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


def _dominant_line(readings: FloatArray, band_cycles: tuple[float, float]) -> list[tuple[float, float]]:
    """Return cycles and power of the strongest line if it stands out from all others."""
    n = len(readings)
    scaled = readings / readings.std(axis=0)
    power = (np.abs(np.fft.rfft(np.hanning(n)[:, np.newaxis] * scaled, axis=0)) ** 2).sum(axis=1)
    cycles = np.arange(len(power))
    is_possible = (cycles >= max(_LEAST_DOMINANT_CYCLES, band_cycles[0])) & (cycles < n // 2 - 1)
    is_possible &= cycles <= band_cycles[1]
    if not is_possible.any():
        return []
    peak = int(np.argmax(np.where(is_possible, power, 0.0)))
    others = (cycles >= _TREND_CYCLES) & (cycles < n // 2 - 1) & (np.abs(cycles - peak) > LOBE)
    for harmonic in _HARMONICS:
        others &= np.abs(cycles - harmonic * peak) > harmonic + 1
    if not others.any() or power[peak] < _STANDS_OUT * float(power[others].max()):
        return []
    beside = others & (np.abs(cycles - peak) <= AROUND)
    beside = beside if beside.any() else others
    # Texture is shared by the channels: they count as one.
    over = float(power[peak]) / float(power[beside].mean())
    return [(_refined(scaled, float(peak), floor=np.ones(scaled.shape[1])), over)]


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
    for _ in range(4):  # each pass narrows the interval fourfold
        tried = cycles + half * np.linspace(-1.0, 1.0, 9)
        power = (np.abs(_phasors(scaled, tried)) ** 2).sum(axis=1)
        cycles = float(tried[np.argmax(power)])
        half /= 4
    # The last points are close enough for a parabola.
    tried = cycles + 4 * half * np.array([-1.0, 0.0, 1.0])
    left, middle, right = (np.abs(_phasors(scaled, tried)) ** 2).sum(axis=1)
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return cycles + float(np.clip(shift, -1.0, 1.0)) * 4 * half

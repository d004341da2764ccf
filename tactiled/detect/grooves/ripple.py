"""The strongest line of a window: where it is, which trend it has, and which of its harmonics it is.

Lines are peaks of the spectrum over the distance travelled, pooled over the channels, that noise rarely has.

A slow polynomial and a ripple of few periods are hard to tell apart. The trend is therefore a straight line
where the ripple has few periods, and a curve only where it has more. Where a window allows both
interpretations (creep under a ripple, or a slow ripple with its harmonics), the one with the smaller
residual comes first.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import FALSE_ALARM
from tactiled.detect.grooves.window import LEAST_VARIANCE, DetrendedWindow, NormalEquations
from tactiled.detect.signal.median import median

# derived: bins per period of the window. The largest bin is then within 1/8 of a bin of the peak.
_PADDING = 4
# choice: bins to either side over which the noise density is taken as constant.
_NEIGHBOURS = 40
# derived: periods in the window. Anything slower is a straight trend.
_LEAST_PEAK_CYCLES = 0.5
# derived: periods in the window. Below this, a line and its image at the negative frequency are one hump
# under a Hann window.
_SLOW_CYCLES = 8
# derived: bins that belong to the line itself: the main lobe of a Hann window and a little more.
_NEAR = 3
# derived: periods from which on a cubic trend takes little of the ripple; with fewer, errors exceed the bound
# of a straight trend.
FEW_PERIODS = 2.5
# prior: power of a fundamental as a part of its harmonics' power; less may be what the model does not
# describe.
_LEAST_SLOWER_PART = 0.03


@dataclass(frozen=True, eq=False)
class Ripple:
    """One interpretation of a line of a window."""

    window: DetrendedWindow  # with the trend of this interpretation
    phase_rate: float  # of the fundamental
    variance: FloatArray  # (channels,): of the noise, volts^2
    # True for the peak of the spectrum, False for a slower fundamental of which it may be a harmonic
    is_peak: bool = True

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations of the fundamental alone."""
        return self.window.equations(self.phase_rate)

    @property
    def periods(self) -> float:
        """Periods of the ripple in the window."""
        return self.phase_rate / np.pi

    def aic(self, variance: FloatArray) -> float:
        """Information criterion of Akaike (1974): residual sum of squares plus two for each unknown."""
        window, n_harmonics = self.window, _sampled_harmonics(self.window, self.phase_rate)
        rest = window.power - window.equations(self.phase_rate, n_harmonics).explained
        n_unknowns = len(rest) * (window.trend.shape[1] + 2 * n_harmonics)
        return float((rest / variance).sum() + 2 * n_unknowns)


def strongest_line(window: DetrendedWindow) -> list[Ripple]:
    """Interpretations of a window's strongest line as slow ripple, fast ripple or both, the better first.

    A line that may be the harmonic of a slower one appears twice: as that harmonic, then as a fundamental.
    """
    power, needed, variance = _spectrum(window)
    # Waves (bins, n) at the first bins; half a bin stands for bin 0.
    n_slow = min(_SLOW_CYCLES * _PADDING, len(power))
    bin_rad = np.pi / _PADDING * (window.n - 1) / window.n * window.travel.mean(axis=0)
    waves = np.cumprod(np.broadcast_to(np.exp(1j * bin_rad), (n_slow - 1, window.n)), axis=0)
    waves = np.concatenate([np.exp(0.5j * bin_rad)[np.newaxis], waves])
    found = []
    for trended, least_periods in ((window, 0.0), (window.curved, FEW_PERIODS)):
        power = np.concatenate([_least_squares_power(trended, waves, variance), power[n_slow:]])
        found.append(_strongest(trended, _peaks(power, needed), variance, least_periods))
    slow, fast = found
    if not slow or slow[0].periods >= FEW_PERIODS:
        return fast
    if not fast:
        return slow
    return sorted((*slow, *fast), key=lambda ripple: ripple.aic(variance))


def _strongest(
    window: DetrendedWindow, cycles: FloatArray, variance: FloatArray, least_periods: float
) -> list[Ripple]:
    """Interpretations of the first of some lines that has enough periods."""
    for line in np.pi * cycles * (window.n - 1) / window.n:
        line = _centred(window, float(line), variance)
        phase_rate = _fundamental(window, line, least_periods)
        if phase_rate >= np.pi * least_periods:
            phase_rates = [phase_rate] if phase_rate == line else [phase_rate, line]
            return [Ripple(window, each, variance, each == line) for each in phase_rates]
    return []


def _spectrum(window: DetrendedWindow) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Spectrum over the distance travelled, under a Hann window.

    Returns
    -------
    power, needed : (bins,) float64
        Mean over channels of power over noise, 1 for noise, and the threshold for lines.
    variance : (channels,) float64
        Of each channel's noise, assumed white, volts^2.
    """
    n = window.n
    if len(window.travel) == 1 and np.ptp(np.diff(window.travel[0])) < 1e-6:
        volts = window.volts
    else:  # interpolation is accurate enough to find the line; the fit uses the original samples
        even, travels = np.linspace(-1.0, 1.0, n), np.broadcast_to(window.travel, window.volts.shape)
        volts = np.array(
            [np.interp(even, travel, row) for travel, row in zip(travels, window.volts, strict=True)]
        )
    hann = 1.0 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    power = np.abs(np.fft.rfft(volts * hann, _PADDING * n, axis=1)) ** 2 / (hann**2).sum()
    variance = np.maximum(median(power[:, _PADDING::_PADDING]) / np.log(2), LEAST_VARIANCE)
    pooled = (1 / variance) @ power / len(volts)
    return pooled, _needed(pooled, len(volts)), variance


def _peaks(power: FloatArray, needed: FloatArray) -> FloatArray:
    """Periods in the window of the lines of a spectrum, the strongest first."""
    inner = power[1:-1]
    is_peak = (inner > power[:-2]) & (inner >= power[2:]) & (inner > needed[1:-1])
    bins = np.flatnonzero(is_peak & (np.arange(1, len(power) - 1) / _PADDING >= _LEAST_PEAK_CYCLES)) + 1
    return np.asarray(bins[np.argsort(-power[bins], kind="stable")] / _PADDING)


def _fundamental(window: DetrendedWindow, phase_rate: float, least_periods: float) -> float:
    """Phase rate of a line, or of the slower fundamental of which the line is a harmonic."""
    n_harmonics = _sampled_harmonics(window, phase_rate)
    alone = window.equations(phase_rate, n_harmonics).explained
    for part in range(window.params.max_harmonics, 1, -1):
        slower = phase_rate / part
        if slower < np.pi * max(least_periods, _LEAST_PEAK_CYCLES) or window.is_removed(slower):
            continue
        # The same number of harmonics for both: what the line's own explain is no evidence of a slower one.
        equations = window.equations(slower, max(part, n_harmonics))
        variance = equations.variance
        more = float(((equations.explained - alone) / variance).sum())
        level = special.chdtri(2 * (part - 1) * len(window.volts), FALSE_ALARM)
        if more > max(level, _LEAST_SLOWER_PART * float((alone / variance).sum())):
            return slower
    return phase_rate


def _sampled_harmonics(window: DetrendedWindow, phase_rate: float) -> int:
    """Number of harmonics below half the scan rate."""
    return int(np.clip(np.pi / (phase_rate * window.largest_step), 1, window.params.max_harmonics))


def _centred(window: DetrendedWindow, phase_rate: float, variance: FloatArray) -> float:
    """Phase rate of the largest explained power near a bin; each of two steps is at most half a bin."""
    most = np.pi / (2 * _PADDING)
    for _ in range(2):
        nearer = window.equations(phase_rate).own_phase_rate(variance)[0]
        phase_rate = min(max(nearer, phase_rate - most), phase_rate + most)
    return phase_rate


def _least_squares_power(
    window: DetrendedWindow, waves: NDArray[np.complex128], variance: FloatArray
) -> FloatArray:
    """Mean over channels of power over noise that waves explain, 1 for noise: (waves,).

    Least squares on sine and cosine with the slow part projected out.
    """
    basis = np.concatenate([waves.real, waves.imag])
    basis -= (basis @ window.trend) @ window.trend.T
    product = (basis @ window.volts.T).reshape(2, len(waves), -1).swapaxes(0, 1)
    basis = basis.reshape(2, *waves.shape)
    gram = np.einsum("itn,jtn->tij", basis, basis)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(2)
    explained = (product * np.linalg.solve(gram, product)).sum(axis=1)
    return np.asarray((explained / variance).mean(axis=1) / 2)


def _needed(pooled: FloatArray, n_channels: int) -> FloatArray:
    """Threshold that noise exceeds once in `1 / FALSE_ALARM` windows, from the scatter of nearby bins.

    The mean of the spectra of m independent channels is gamma distributed with shape m. Noise that channels
    share, such as a random texture under all taxels, has a smaller shape, down to 1; the scatter of the
    logarithms yields it.
    """
    bins = np.log(np.maximum(pooled[::_PADDING], 1e-12))
    if len(bins) > _NEIGHBOURS + 1:
        padded = np.pad(bins[1:], _NEIGHBOURS, mode="reflect")
        views = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
        views = np.concatenate([views[:1], views])
        beside = [views[:, : _NEIGHBOURS - _NEAR], views[:, _NEIGHBOURS + _NEAR + 1 :]]
        around = np.concatenate(beside, axis=1)
    else:
        around = np.broadcast_to(bins[1:], (len(bins), len(bins) - 1))
    level = median(around)
    scatter = 1.4826 * median(np.abs(around - level[:, np.newaxis]))
    shape = np.clip(1.0 / np.maximum(scatter, 1e-3) ** 2, 1.0, n_channels)
    mean = np.exp(level - special.digamma(shape)) * shape
    needed = mean * special.gammainccinv(shape, FALSE_ALARM / len(bins)) / shape
    return np.repeat(needed, _PADDING)[: len(pooled)]

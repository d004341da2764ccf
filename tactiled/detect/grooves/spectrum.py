"""Lines in the spectrum of a window: detection, the fundamental among harmonics, and the noise around them.

A slow polynomial and a ripple of few periods are hard to tell apart. The trend is therefore a straight line
where the ripple has few periods, and a curve only where it has more. Where a window allows both
interpretations (creep under a ripple, or a slow ripple with its harmonics), the one with the smaller
residual comes first.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import ALIASED, ChannelLayout, WaveMotion, WaveParams
from tactiled.detect.grooves.search import channel_phasors, explained_power, most_explained_power
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations, normal_equations

# Bins per period of the window. The largest bin is then within 1/8 of a bin of the peak.
_PADDING = 4
# Bins to either side over which the noise density is taken as constant.
_NEIGHBOURS = 40
# Periods in the window. Anything slower is a straight trend.
LEAST_CYCLES = 0.5
# Periods in the window. Below this, a line and its image at the negative frequency are one hump under a Hann
# window.
_SLOW_CYCLES = 8
# Frequencies beside a line, one period of the window apart, from which the noise there is read.
_FLOOR_PLACES = 4
# Periods of the window. Closer to a line or to the trend, removing that has removed the noise, too.
_CLEAR = 0.75
# Bins that belong to the line itself: the main lobe of a Hann window and a little more.
_NEAR = 3
# Probability that white noise passes as a line, for one window or for one more harmonic.
FALSE_LINE = 1e-6
# Noise of a 22-bit converter on 3 V, volts^2: a lower bound that keeps the weights of a noiseless signal
# finite.
LEAST_VARIANCE = (1e-6) ** 2 / 12
# Periods from which on a cubic trend takes little of the ripple; with fewer, errors exceed the bound of a
# straight trend.
FEW_PERIODS = 2.5
# Power of a fundamental as a part of its harmonics' power; less may be what the model does not describe.
_LEAST_FUNDAMENTAL = 0.03
# Probability that phase mismatch of a wave's own harmonic passes as another wave.
_FALSE_FOREIGN = 1e-6
# Part of a line's power. Less is not worth a search for another wave.
_LEAST_FOREIGN_PART = 0.05
# Part of a line's power, as the channels' own fits explain it. A wave that leaves more does not explain the
# line.
MOST_UNEXPLAINED_PART = 0.4


@dataclass(frozen=True, eq=False)
class LineSpectrum:
    """Pooled spectrum of a window.

    Attributes
    ----------
    cycles : (bins,) float64
        Periods in the window.
    power : (bins,) float64
        Mean over channels of power over noise; 1 for noise.
    needed : (bins,) float64
        Power above which a peak is a line.
    variance : (channels,) float64
        Of each channel's noise, assumed white, volts^2.
    """

    cycles: FloatArray
    power: FloatArray
    needed: FloatArray
    variance: FloatArray

    def peaks(self) -> list[int]:
        """Bins of the lines, the strongest first."""
        inner = self.power[1:-1]
        is_peak = (inner > self.power[:-2]) & (inner >= self.power[2:]) & (inner > self.needed[1:-1])
        bins = np.flatnonzero(is_peak & (self.cycles[1:-1] >= LEAST_CYCLES)) + 1
        return [int(b) for b in bins[np.argsort(-self.power[bins], kind="stable")]]


def line_spectra(window: DetrendedWindow, *others: DetrendedWindow) -> list[LineSpectrum]:
    """Spectra over the distance travelled, under a Hann window, with the threshold for lines.

    Parameters
    ----------
    *others : DetrendedWindow
        Windows of the same readings with other trends.

    Returns
    -------
    list of LineSpectrum
        One for each window.
    """
    n = window.n
    even = np.linspace(-1.0, 1.0, n)
    if len(window.travel) == 1 and np.ptp(np.diff(window.travel[0])) < 1e-6:
        volts = window.volts
    else:  # interpolation is accurate enough to find the line; the fit uses the original samples
        travels = np.broadcast_to(window.travel, window.volts.shape)
        volts = np.array(
            [np.interp(even, travel, row) for travel, row in zip(travels, window.volts, strict=True)]
        )
    hann = 1.0 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    power = np.abs(np.fft.rfft(volts * hann, _PADDING * n, axis=1)) ** 2 / (hann**2).sum()
    variance = np.maximum(_median(power[:, _PADDING::_PADDING]) / np.log(2), LEAST_VARIANCE)
    pooled = (1 / variance) @ power / len(volts)
    needed = _needed(pooled, len(volts))
    cycles = np.arange(len(pooled)) / _PADDING
    n_slow = min(_SLOW_CYCLES * _PADDING, len(pooled))
    waves = _slow_waves(window, n_slow)
    found = []
    for each in (window, *others):
        slow = _least_squares_power(each, waves, variance)
        found.append(LineSpectrum(cycles, np.concatenate([slow, pooled[n_slow:]]), needed, variance))
    return found


def floor_beside(window: DetrendedWindow, phase_rate: float, variance: FloatArray, line: float) -> float:
    """Ratio of the noise at a phase rate to its stated variance, estimated beside it.

    The noise of a real skin falls with frequency, at most like a random walk (1 / f^2). Estimates from higher
    frequencies are therefore raised by that law; estimates from lower frequencies count unchanged.

    Parameters
    ----------
    window : DetrendedWindow
        Without the line at `line` and its harmonics.
    variance : (channels,) float64
    line : float
        Phase rate of the line that was removed.
    """
    here, apart = phase_rate / np.pi, line / np.pi
    there = here + np.array([-2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
    clear = np.abs(there - np.maximum(np.round(there / apart), 1) * apart) >= min(_CLEAR, apart / 2)
    clear &= np.array([not window.is_removed(np.pi * place) for place in there])
    there = there[(there >= _CLEAR) & (there < window.n / 2 - 1) & clear][:_FLOOR_PLACES]
    if not len(there):
        return np.inf
    rises = np.maximum(there / here, 1.0) ** 2
    waves = np.exp(1j * np.outer(np.pi * there, window.travel.mean(axis=0)))
    powers = _least_squares_power(window, waves, variance)
    return float((powers * rises).mean())


def _slow_waves(window: DetrendedWindow, n_bins: int) -> NDArray[np.complex128]:
    """Complex waves at the first bins of the spectrum: (bins, n); half a bin stands for bin 0."""
    phase_rate = np.pi / _PADDING * (window.n - 1) / window.n
    first = np.exp(1j * phase_rate * window.travel.mean(axis=0))
    waves = np.cumprod(np.broadcast_to(first, (n_bins - 1, window.n)), axis=0)
    return np.concatenate([np.exp(0.5j * phase_rate * window.travel.mean(axis=0))[np.newaxis], waves])


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


def _median(values: FloatArray) -> FloatArray:
    """Median of each row; a sort takes a tenth of the time of ``np.median`` for many short rows."""
    ordered, half = np.sort(values, axis=-1), values.shape[-1] // 2
    return np.asarray((ordered[..., half] + ordered[..., -1 - half]) / 2)


def _needed(pooled: FloatArray, n_channels: int) -> FloatArray:
    """Threshold that noise exceeds once in `1 / FALSE_LINE` windows, from the scatter of nearby bins.

    The mean of the spectra of m independent channels is gamma distributed with shape m. Noise that channels
    share, such as a random texture under all taxels, has a smaller shape, down to 1; the scatter of the
    logarithms yields it.
    """
    bins = np.log(np.maximum(pooled[::_PADDING], 1e-12))
    width = 2 * _NEIGHBOURS + 1
    padded = np.pad(bins[1:], _NEIGHBOURS, mode="reflect") if len(bins) > _NEIGHBOURS + 1 else None
    if padded is None:
        around = np.broadcast_to(bins[1:], (len(bins), len(bins) - 1))
    else:
        views = np.lib.stride_tricks.sliding_window_view(padded, width)
        views = np.concatenate([views[:1], views])
        beside = [views[:, : _NEIGHBOURS - _NEAR], views[:, _NEIGHBOURS + _NEAR + 1 :]]
        around = np.concatenate(beside, axis=1)
    level = _median(around)
    scatter = 1.4826 * _median(np.abs(around - level[:, np.newaxis]))
    shape = np.clip(1.0 / np.maximum(scatter, 1e-3) ** 2, 1.0, n_channels)
    mean = np.exp(level - special.digamma(shape)) * shape
    needed = mean * special.gammainccinv(shape, FALSE_LINE / len(bins)) / shape
    return np.repeat(needed, _PADDING)[: len(pooled)]


@dataclass(frozen=True, eq=False)
class RippleHypothesis:
    """One interpretation of the strongest line of a window.

    Attributes
    ----------
    window : DetrendedWindow
        With the trend of this interpretation.
    phase_rate : float
        Of the fundamental.
    variance : (channels,) float64
        Of the noise, volts^2.
    is_line : bool
        True for the line itself, False for a slower fundamental that the line may be a harmonic of.
    """

    window: DetrendedWindow
    phase_rate: float
    variance: FloatArray
    is_line: bool

    @property
    def periods(self) -> float:
        """Periods of the ripple in the window."""
        return self.phase_rate / np.pi

    def aic(self, variance: FloatArray, params: WaveParams) -> float:
        """Information criterion of Akaike (1974): residual sum of squares plus two for each unknown."""
        n_harmonics = _sampled_harmonics(self.window, self.phase_rate, params)
        rest = (self.window.volts**2).sum(axis=1) - normal_equations(
            self.window, self.phase_rate, n_harmonics
        ).explained()
        n_unknowns = len(rest) * (self.window.trend.shape[1] + 2 * n_harmonics)
        return float((rest / variance).sum() + 2 * n_unknowns)


def strongest_line(window: DetrendedWindow, params: WaveParams) -> list[RippleHypothesis]:
    """Interpretations of a window's strongest line as slow ripple, fast ripple or both, the better first.

    A line that may be the harmonic of a slower one appears twice: as that harmonic, then as a fundamental.
    """
    curved = window.with_trend_order(params.trend_order)
    straight_lines, curved_lines = line_spectra(window, curved)
    slow = _hypotheses(window, straight_lines, params, 0.0)
    fast = _hypotheses(curved, curved_lines, params, FEW_PERIODS)
    if not slow or slow[0].periods >= FEW_PERIODS:
        return fast
    if not fast:
        return slow
    return sorted((*slow, *fast), key=lambda ripple: ripple.aic(fast[0].variance, params))


def _hypotheses(
    window: DetrendedWindow, spectrum: LineSpectrum, params: WaveParams, least_periods: float
) -> list[RippleHypothesis]:
    """Interpretations of the strongest line that has enough periods."""
    for peak in spectrum.peaks():
        line = np.pi * float(spectrum.cycles[peak]) * (window.n - 1) / window.n
        line = _centred(window, line, spectrum.variance)
        phase_rate = _fundamental(window, line, params, least_periods)
        if phase_rate >= np.pi * least_periods:
            phase_rates = [phase_rate] if phase_rate == line else [phase_rate, line]
            return [RippleHypothesis(window, each, spectrum.variance, each == line) for each in phase_rates]
    return []


def _fundamental(
    window: DetrendedWindow, phase_rate: float, params: WaveParams, least_periods: float
) -> float:
    """Phase rate of a line, or of the slower fundamental of which the line is a harmonic."""
    n_harmonics = _sampled_harmonics(window, phase_rate, params)
    alone = normal_equations(window, phase_rate, n_harmonics).explained()
    left = window.without_lines(phase_rate, range(1, n_harmonics + 1))
    for part in range(params.max_harmonics, 1, -1):
        if phase_rate / part < np.pi * max(least_periods, LEAST_CYCLES) or window.is_removed(
            phase_rate / part
        ):
            continue
        # The same number of harmonics for both: what the line's own explain is no evidence of a slower one.
        equations = normal_equations(window, phase_rate / part, max(part, n_harmonics))
        variance = noise_variance(window, equations)
        more = float(((equations.explained() - alone) / variance).sum())
        # Drift that no polynomial describes is strongest where a slower line would be.
        floor = max(1.0, floor_beside(left, phase_rate / part, variance, phase_rate))
        level = floor * special.chdtri(2 * (part - 1) * len(variance), FALSE_LINE)
        if more > max(level, _LEAST_FUNDAMENTAL * float((alone / variance).sum())):
            return phase_rate / part
    return phase_rate


def _sampled_harmonics(window: DetrendedWindow, phase_rate: float, params: WaveParams) -> int:
    """Number of harmonics below half the scan rate."""
    return int(np.clip(np.pi / (phase_rate * window.largest_step), 1, params.max_harmonics))


def _centred(window: DetrendedWindow, phase_rate: float, variance: FloatArray) -> float:
    """Phase rate of the largest explained power near a bin."""
    step = np.pi / 8
    for _ in range(3):
        powers = [
            float((normal_equations(window, phase_rate + d, 1).explained() / variance).sum())
            for d in (-step, 0, step)
        ]
        bend = powers[0] - 2 * powers[1] + powers[2]
        if bend < 0:
            phase_rate += float(np.clip(0.5 * (powers[0] - powers[2]) / bend, -1, 1)) * step
        step /= 4
    return phase_rate


def visible_harmonics(window: DetrendedWindow, phase_rate: float, params: WaveParams) -> int:
    """Number of the highest harmonic that exceeds the noise."""
    highest = min(params.max_harmonics, int(2 * np.pi * ALIASED / (phase_rate * window.largest_step)))
    highest = next((h - 1 for h in range(2, highest + 1) if window.is_removed(h * phase_rate)), highest)
    if highest < 2:
        return 1
    equations = normal_equations(window, phase_rate, highest)
    variance = noise_variance(window, equations)
    information = np.linalg.inv(equations.gram[:, : 2 * highest, : 2 * highest])
    parts = equations.phasors()
    level = special.chdtri(2 * len(parts), FALSE_LINE)
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        own = np.linalg.solve(information[:, pair, pair], parts[:, pair, np.newaxis])[..., 0]
        if float(((own * parts[:, pair]).sum(axis=1) / variance).sum()) > level:
            return h
    return 1


def noise_variance(window: DetrendedWindow, equations: NormalEquations) -> FloatArray:
    """Variance of the residual of each channel's own fit, volts^2: (channels,)."""
    rest = window.power - equations.explained()
    n_free = max(window.n - window.trend.shape[1] - 2 * equations.n_harmonics, 1)
    return np.asarray(np.maximum(rest / n_free, LEAST_VARIANCE))


def line_powers(equations: NormalEquations, variance: FloatArray) -> FloatArray:
    """Power over noise of each harmonic, without the overlap of neighbouring lines: (harmonics,)."""
    parts = equations.phasors() ** 2 * np.einsum("gff->gf", equations.gram)[:, : 2 * equations.n_harmonics]
    return np.asarray((parts.T / variance).sum(axis=1).reshape(-1, 2).sum(axis=1))


def foreign_lines(
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    waves: PlaneWaves,
    equations: NormalEquations,
    variance: FloatArray,
) -> list[int]:
    """Multiples of a wave's frequency that are not harmonics of this wave.

    The phases of a harmonic advance h times as fast across the array as those of the fundamental. The phases
    of noise, or of another grating whose ripple happens to be at a multiple, do not. Phase mismatch is taken
    as the cause of a misfit, unless another wave vector explains the line so much better that mismatch is
    unlikely (likelihood ratio of the phase variances, corrected for the number of vectors tried).

    Parameters
    ----------
    waves : PlaneWaves
        One wave.
    equations : NormalEquations
        With the lines in question.
    variance : (channels,) float64

    Returns
    -------
    list of int
        Numbers of the harmonics; 1 is the fundamental.
    """
    power = window.n / 2  # power of a line of amplitude 1
    n_channels = len(variance)
    level = special.chdtri(n_channels, FALSE_LINE)
    n_free = max(n_channels - layout.is_kind.shape[1] - 2, 1)
    foreign = []
    for h in range(1, equations.n_harmonics + 1):
        z = channel_phasors(window, equations, h)
        free = power * float((np.abs(z) ** 2 / variance).sum())
        untied = free - power * explained_power(z, layout, h * waves.k[0], variance)
        if untied < max(level, _LEAST_FOREIGN_PART * free):
            continue
        if untied < MOST_UNEXPLAINED_PART * free:
            other, n_tried = most_explained_power(
                z, h * equations.phase_rate, window, layout, motion, params, variance
            )
            ratio = untied / max(free - power * other, n_channels)
            if n_free * np.log(ratio) < 2 * np.log(n_tried / _FALSE_FOREIGN):
                continue
        foreign.append(h)
    return foreign

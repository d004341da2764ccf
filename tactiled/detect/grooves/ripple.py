"""Interpretations of the strongest line of a window: which trend it has, and which of its harmonics it is.

A slow polynomial and a ripple of few periods are hard to tell apart. The trend is therefore a straight line
where the ripple has few periods, and a curve only where it has more. Where a window allows both
interpretations (creep under a ripple, or a slow ripple with its harmonics), the one with the smaller
residual comes first.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import FALSE_ALARM
from tactiled.detect.grooves.spectrum import LEAST_CYCLES, LineSpectrum, floor_beside, line_spectra
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations

# derived: periods from which on a cubic trend takes little of the ripple; with fewer, errors exceed the bound
# of a straight trend.
FEW_PERIODS = 2.5
# prior: power of a fundamental as a part of its harmonics' power; less may be what the model does not
# describe.
_LEAST_FUNDAMENTAL = 0.03


@dataclass(frozen=True, eq=False)
class Ripple:
    """One interpretation of a line of a window."""

    window: DetrendedWindow  # with the trend of this interpretation
    phase_rate: float  # of the fundamental
    variance: FloatArray  # (channels,): of the noise, volts^2
    # True for the line itself, False for a slower fundamental that the line may be a harmonic of
    is_line: bool = True

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations of the fundamental alone."""
        return self.window.equations(self.phase_rate)

    @property
    def frequency_hz(self) -> float:
        """Mean frequency."""
        return self.window.frequency_hz(self.phase_rate)

    @property
    def periods(self) -> float:
        """Periods of the ripple in the window."""
        return self.phase_rate / np.pi

    @property
    def power(self) -> float:
        """Power of the line, volts^2 summed over channels and scans."""
        return float(self.equations.explained.sum())

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
    straight_lines, curved_lines = line_spectra(window, window.curved)
    slow = _strongest(window, straight_lines, 0.0)
    fast = _strongest(window.curved, curved_lines, FEW_PERIODS)
    if not slow or slow[0].periods >= FEW_PERIODS:
        return fast
    if not fast:
        return slow
    return sorted((*slow, *fast), key=lambda ripple: ripple.aic(fast[0].variance))


def _strongest(window: DetrendedWindow, spectrum: LineSpectrum, least_periods: float) -> list[Ripple]:
    """Interpretations of the strongest line that has enough periods."""
    for peak in spectrum.peaks():
        line = np.pi * float(spectrum.cycles[peak]) * (window.n - 1) / window.n
        line = _centred(window, line, spectrum.variance)
        phase_rate = _fundamental(window, line, least_periods)
        if phase_rate >= np.pi * least_periods:
            phase_rates = [phase_rate] if phase_rate == line else [phase_rate, line]
            return [Ripple(window, each, spectrum.variance, each == line) for each in phase_rates]
    return []


def _fundamental(window: DetrendedWindow, phase_rate: float, least_periods: float) -> float:
    """Phase rate of a line, or of the slower fundamental of which the line is a harmonic."""
    n_harmonics = _sampled_harmonics(window, phase_rate)
    alone = window.equations(phase_rate, n_harmonics).explained
    left = window.without_lines(phase_rate, range(1, n_harmonics + 1))
    for part in range(window.params.max_harmonics, 1, -1):
        slower = phase_rate / part
        if slower < np.pi * max(least_periods, LEAST_CYCLES) or window.is_removed(slower):
            continue
        # The same number of harmonics for both: what the line's own explain is no evidence of a slower one.
        equations = window.equations(slower, max(part, n_harmonics))
        variance = equations.variance
        more = float(((equations.explained - alone) / variance).sum())
        # Drift that no polynomial describes is strongest where a slower line would be.
        floor = max(1.0, floor_beside(left, slower, variance, phase_rate))
        level = floor * special.chdtri(2 * (part - 1) * len(variance), FALSE_ALARM)
        if more > max(level, _LEAST_FUNDAMENTAL * float((alone / variance).sum())):
            return slower
    return phase_rate


def _sampled_harmonics(window: DetrendedWindow, phase_rate: float) -> int:
    """Number of harmonics below half the scan rate."""
    return int(np.clip(np.pi / (phase_rate * window.largest_step), 1, window.params.max_harmonics))


def _centred(window: DetrendedWindow, phase_rate: float, variance: FloatArray) -> float:
    """Phase rate of the largest explained power near a bin."""
    step = np.pi / 8
    for _ in range(3):
        powers = [
            float((window.equations(phase_rate + d).explained / variance).sum()) for d in (-step, 0, step)
        ]
        bend = powers[0] - 2 * powers[1] + powers[2]
        if bend < 0:
            phase_rate += float(np.clip(0.5 * (powers[0] - powers[2]) / bend, -1, 1)) * step
        step /= 4
    return phase_rate

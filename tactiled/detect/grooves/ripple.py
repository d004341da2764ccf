"""Which line of a window is the ripple, and how much of what is slow is drift.

A slow polynomial and a ripple of few periods are much the same thing. So the trend is a straight line where
the ripple has few periods, and a curve only where it has more. Where a window can be read in both ways (creep
under a ripple, or a slow ripple with its harmonics), the reading that leaves less goes first.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Window, tabulate
from tactiled.detect.grooves.harmonics import noise_variance
from tactiled.detect.grooves.lines import LEAST_CYCLES, Lines, find_lines, floor_beside
from tactiled.detect.grooves.model import WaveParams

# Periods from which on a cubic takes little of the ripple: below, errors grow beyond the bound of the line.
_FEW = 2.5
_FALSE_LINE = 1e-6  # noise passes for one more line so often
# A fundamental has at least this part of its harmonics' power; less may be what the model does not describe.
_LEAST_FUNDAMENTAL = 0.03


@dataclass(frozen=True, eq=False)
class Ripple:
    """One reading of a window.

    Attributes
    ----------
    window : Window
        With the trend that goes with it.
    turn : float
        Phase of the fundamental for 1 of way, radians.
    variance : (channels,) float64
        Of the noise, volts^2.
    is_line : bool
        Whether it is the line itself, not a slower one that the line may be a harmonic of.
    """

    window: Window
    turn: float
    variance: FloatArray
    is_line: bool

    @property
    def periods(self) -> float:
        return self.turn / np.pi

    def left(self, variance: FloatArray, params: WaveParams) -> float:
        """What it leaves unexplained, with two for each unknown (Akaike 1974)."""
        n_harmonics = _sampled_harmonics(self.window, self.turn, params)
        rest = (self.window.volts**2).sum(axis=1) - tabulate(self.window, self.turn, n_harmonics).explained()
        n_unknowns = len(rest) * (self.window.trend.shape[1] + 2 * n_harmonics)
        return float((rest / variance).sum() + 2 * n_unknowns)


def strongest(window: Window, params: WaveParams) -> list[Ripple]:
    """The strongest line of a window, read as a slow ripple, a faster one or both, the better first.

    A line that may be the harmonic of a slower one is read as that first, and then as it is.
    """
    curved = window.curved(params.trend_order)
    straight_lines, curved_lines = find_lines(window, curved)
    slow = _strongest(window, straight_lines, params, 0.0)
    fast = _strongest(curved, curved_lines, params, _FEW)
    if not slow or slow[0].periods >= _FEW:
        return fast
    if not fast:
        return slow
    return sorted((*slow, *fast), key=lambda ripple: ripple.left(fast[0].variance, params))


def _strongest(window: Window, lines: Lines, params: WaveParams, least_periods: float) -> list[Ripple]:
    """Readings of the strongest line of so many periods or more."""
    for peak in lines.peaks():
        line = np.pi * float(lines.cycles[peak]) * (window.n - 1) / window.n
        line = _centred(window, line, lines.variance)
        turn = _fundamental(window, line, params, least_periods)
        if turn >= np.pi * least_periods:
            turns = [turn] if turn == line else [turn, line]
            return [Ripple(window, each, lines.variance, each == line) for each in turns]
    return []


def _fundamental(window: Window, turn: float, params: WaveParams, least_periods: float) -> float:
    """The line's own turn, or that of the line that it is a harmonic of."""
    n_harmonics = _sampled_harmonics(window, turn, params)
    alone = tabulate(window, turn, n_harmonics).explained()
    left = window.without(turn, range(1, n_harmonics + 1))
    for part in range(params.max_harmonics, 1, -1):
        if turn / part < np.pi * max(least_periods, LEAST_CYCLES) or window.is_gone(turn / part):
            continue
        # As many harmonics of either: what the line's own explain is no sign of a slower one.
        tables = tabulate(window, turn / part, max(part, n_harmonics))
        variance = noise_variance(window, tables)
        more = float(((tables.explained() - alone) / variance).sum())
        # Drift that is no polynomial is strongest where a slower line would be.
        floor = max(1.0, floor_beside(left, turn / part, variance, turn))
        level = floor * special.chdtri(2 * (part - 1) * len(variance), _FALSE_LINE)
        if more > max(level, _LEAST_FUNDAMENTAL * float((alone / variance).sum())):
            return turn / part
    return turn


def _sampled_harmonics(window: Window, turn: float, params: WaveParams) -> int:
    """How many harmonics are below half the scan rate."""
    return int(np.clip(np.pi / (turn * window.largest_step), 1, params.max_harmonics))


def _centred(window: Window, turn: float, variance: FloatArray) -> float:
    """Turn of the largest explained power near a bin."""
    step = np.pi / 8
    for _ in range(3):
        powers = [
            float((tabulate(window, turn + d, 1).explained() / variance).sum()) for d in (-step, 0, step)
        ]
        bend = powers[0] - 2 * powers[1] + powers[2]
        if bend < 0:
            turn += float(np.clip(0.5 * (powers[0] - powers[2]) / bend, -1, 1)) * step
        step /= 4
    return turn

"""The best wave near a start, with all its harmonics, and what noise and strays are then left."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Tables, Window, tabulate
from tactiled.detect.wave_linear import Waves
from tactiled.detect.wave_lines import LEAST_VARIANCE
from tactiled.detect.wave_model import Layout, WaveMotion, WaveParams
from tactiled.detect.wave_solve import Solver

_FALSE_LINE = 1e-6  # noise passes for one more line so often
_HIGHEST = 0.45  # of the scan rate: a harmonic above may fall on another
_REFINEMENTS = 4  # noise and strays are known from the one before
_CONVERGED = 1e-5  # radians, and radians a millimetre
_LEAST_TIED = 0.4  # a wave explains all but this part of what its channels do by themselves


@dataclass(frozen=True, eq=False)
class Refined:
    """The best wave of a line.

    Attributes
    ----------
    waves : Waves
        One.
    tables : Tables
        At its frequency, with its harmonics.
    variance : (channels,) float64
        Of each channel's noise, volts^2.
    stray : (kinds, harmonics) float64
        Variance of phases within a kind, so wide that all harmonics tell no more than one, radians^2.
    is_wave : bool
        Whether phases of one wave suit the channels at all.
    n_scans : int
    """

    waves: Waves
    tables: Tables
    variance: FloatArray
    stray: FloatArray
    is_wave: bool
    n_scans: int

    @property
    def stray_alone(self) -> FloatArray:
        """Variance of the fundamental's phases, for fits of it alone: (kinds, 1), radians^2."""
        return self.stray[:, :1] / self.tables.n_harmonics

    @property
    def snr_db(self) -> float:
        """Power of the ripple over that of the noise, mean of the channels."""
        snr = float((self.tables.explained() / self.variance).mean()) / self.n_scans
        return 10 * float(np.log10(max(snr, 1e-10)))


def _harmonics(window: Window, turn: float, params: WaveParams) -> int:
    """The highest harmonic that is seen."""
    highest = min(params.max_harmonics, int(2 * np.pi * _HIGHEST / (turn * window.largest_step)))
    if highest < 2:
        return 1
    tables = tabulate(window, turn, highest)
    variance = noise_variance(window, tables)
    information = np.linalg.inv(tables.gram[:, : 2 * highest, : 2 * highest])
    parts = tables.phasors()
    level = stats.chi2.isf(_FALSE_LINE, 2 * len(parts))
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        own = np.linalg.solve(information[:, pair, pair], parts[:, pair, np.newaxis])[..., 0]
        if float(((own * parts[:, pair]).sum(axis=1) / variance).sum()) > level:
            return h
    return 1


def refine(window: Window, layout: Layout, motion: WaveMotion, params: WaveParams, start: Waves) -> Refined:
    """The maximum next to a start, with the harmonics that are seen."""
    best = start
    n_harmonics = _harmonics(window, float(best.turn[0]), params)
    stray = np.zeros((len(np.unique(layout.kind)), n_harmonics))
    for _ in range(_REFINEMENTS):
        tables = tabulate(window, float(best.turn[0]), n_harmonics)
        variance = noise_variance(window, tables)
        solver = Solver(window, layout, motion, variance, stray)
        before, best = best, solver.solve(tables, best.k, best.turn, steps=2)
        strayed, stray = stray, solver.stray_of(tables, best)
        moved = max(float(np.abs(best.turn - before.turn)[0]), float(np.abs(best.k - before.k).max()))
        if moved < _CONVERGED and np.allclose(stray, strayed, rtol=0.05):
            break
    free = float((tables.explained() / variance).sum())
    tied = float(Solver(window, layout, motion, variance).solve(tables, best.k, best.turn, 2).gain[0])
    is_wave = free - tied < max(_LEAST_TIED * free, stats.chi2.isf(_FALSE_LINE, len(variance) * n_harmonics))
    return Refined(best, tables, variance, stray, is_wave, window.n)


def noise_variance(window: Window, tables: Tables) -> FloatArray:
    """Of what the tables' own phasors leave of each channel."""
    rest = (window.volts**2).sum(axis=1) - tables.explained()
    n_free = max(window.n - window.trend.shape[1] - 2 * tables.n_harmonics, 1)
    return np.asarray(np.maximum(rest / n_free, LEAST_VARIANCE))

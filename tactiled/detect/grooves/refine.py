"""The best wave near a start, with all its harmonics, and what noise and strays are then left."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables, Window, tabulate
from tactiled.detect.grooves.harmonics import foreign_lines, line_powers, n_seen, noise_variance
from tactiled.detect.grooves.linear import Waves
from tactiled.detect.grooves.model import Layout, WaveMotion, WaveParams
from tactiled.detect.grooves.solve import Solver

_FALSE_LINE = 1e-6  # noise passes for one more line so often
_REFINEMENTS = 4  # noise and strays are known from the one before
_CONVERGED = 1e-5  # radians, and radians a millimetre
_FARTHEST = np.pi  # of turn from the start: a period of the window is beyond what tables describe
_MOST_STRAY = 0.5  # radians^2: real skins' phases stray by 0.3 radians; anything does by 1.8
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


def refine(window: Window, layout: Layout, motion: WaveMotion, params: WaveParams, start: Waves) -> Refined:
    """The maximum next to a start, with the harmonics that are seen and are the wave's own."""
    n_harmonics = n_seen(window, float(start.turn[0]), params)
    while True:
        best = _climbed(window, layout, motion, start, n_harmonics)
        foreign = foreign_lines(window, layout, motion, params, best.waves, best.tables, best.variance)
        if not foreign or n_harmonics == 1:
            return best
        if np.argmax(line_powers(best.tables, best.variance)) > 0:
            return replace(best, is_wave=False)
        n_harmonics = max(foreign[0] - 1, 1)


def _climbed(window: Window, layout: Layout, motion: WaveMotion, start: Waves, n_harmonics: int) -> Refined:
    best, phase = start, None
    stray = np.zeros((len(np.unique(layout.kind)), n_harmonics))
    for _ in range(_REFINEMENTS):
        tables = tabulate(window, float(best.turn[0]), n_harmonics)
        variance = noise_variance(window, tables)
        solver = Solver(window, layout, motion, variance, stray)
        before, best = best, solver.solve(tables, best.k, best.turn, 2, phase)
        phase = best.phase
        strayed, stray = stray, solver.stray_of(tables, best)
        moved = max(float(np.abs(best.turn - before.turn)[0]), float(np.abs(best.k - before.k).max()))
        if moved < _CONVERGED and np.allclose(stray, strayed, rtol=0.05):
            break
    free = float((tables.explained() / variance).sum())
    noise = float(special.chdtri(len(variance) * n_harmonics, _FALSE_LINE))
    plain = Solver(window, layout, motion, variance)
    # Where the wave is right here it is so at its maximum without strays, too.
    is_wave = any(
        free - float(plain.solve(tables, best.k, best.turn, steps, best.phase).gain[0])
        < max(_LEAST_TIED * free, noise)
        for steps in (0, 2)
    )
    is_wave &= abs(float(best.turn[0] - start.turn[0])) < _FARTHEST
    is_wave &= float(stray[:, 0].mean()) / n_harmonics < _MOST_STRAY
    return Refined(best, tables, variance, stray, is_wave, window.n)

"""Refine the best wave of a line; state how noise and phase mismatch widen its covariance.

The Fisher information assumes white noise that is independent between channels. Of coloured noise only the
part near a line's frequency matters (Grenander, Szego 1958). The residual of the fit at frequencies beside
the line is therefore shifted onto the line, some places to either side, and the displacement of the answer is
computed for each. That accounts for a raised noise floor and for the side bands of an uneven speed, also
where all channels share them.

Where phases deviate within kinds, the channels of one taxel may deviate together. Each taxel's contribution
to the answer is then one sample of the scatter between taxels (cluster-robust variance: Liang, Zeger 1986).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion, WaveParams
from tactiled.detect.grooves.solve import WaveSolver
from tactiled.detect.grooves.spectrum import (
    FALSE_LINE,
    MOST_UNEXPLAINED_PART,
    foreign_lines,
    line_powers,
    noise_variance,
    visible_harmonics,
)
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations, normal_equations

# Iterations at most; noise and mismatch of each are those of the one before.
_REFINEMENTS = 4
# Radians, and radians per millimetre.
_CONVERGED_RAD = 1e-5
# Change of the phase rate from the start. Normal equations do not describe more than a period of the window.
_LARGEST_PHASE_RATE_MOVE = np.pi
# Variance, radians^2. Phases of real skins deviate by 0.3 radians; random phases by 1.8.
_MOST_MISMATCH = 0.5
# Frequencies beside the line: fewer are a poor estimate, more are far from it.
_PLACES = 8
# Periods of the window, less rounding. Closer to the line the fit has absorbed the noise.
_NEAREST = 1.0 - 1e-9
# Periods of the window. Below, the trend has absorbed the noise.
_SLOWEST = 0.75
# Probability that white noise passes as more than white. The covariance is then too wide by the factor found.
_FALSE_INFLATION = 0.01
# Tail probability at two standard deviations, at which intervals of few degrees of freedom are matched.
_TAIL = 0.025
# Degrees of freedom that wave vector and phase take. The scatter of a few taxels is too small by that.
_SPENT_TAXELS = 3


@dataclass(frozen=True, eq=False)
class RefinedWave:
    """The best wave of a line.

    Attributes
    ----------
    waves : PlaneWaves
        One wave.
    equations : NormalEquations
        At its frequency, with its harmonics.
    variance : (channels,) float64
        Of each channel's noise, volts^2.
    mismatch : (kinds, harmonics) float64
        Variance of phases within a kind, radians^2, widened so that all harmonics count as one observation.
    is_wave : bool
        True where the phases of one wave suit the channels.
    """

    waves: PlaneWaves
    equations: NormalEquations
    variance: FloatArray
    mismatch: FloatArray
    is_wave: bool
    n_scans: int

    @property
    def fundamental_mismatch(self) -> FloatArray:
        """Variance of the fundamental's phases, for fits of the fundamental only: (kinds, 1), radians^2."""
        return self.mismatch[:, :1] / self.equations.n_harmonics

    @property
    def snr_db(self) -> float:
        """Power of the ripple over that of the noise, mean of the channels."""
        snr = float((self.equations.explained() / self.variance).mean()) / self.n_scans
        return 10 * float(np.log10(max(snr, 1e-10)))


def refine(
    window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, params: WaveParams, start: PlaneWaves
) -> RefinedWave:
    """Climb from a start to the nearest maximum, with the visible harmonics that belong to the wave."""
    n_harmonics = visible_harmonics(window, float(start.phase_rate[0]), params)
    while True:
        best = _climb(window, layout, motion, start, n_harmonics)
        foreign = foreign_lines(window, layout, motion, params, best.waves, best.equations, best.variance)
        if not foreign or n_harmonics == 1:
            return best
        if np.argmax(line_powers(best.equations, best.variance)) > 0:
            return replace(best, is_wave=False)
        n_harmonics = max(foreign[0] - 1, 1)


def _climb(
    window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, start: PlaneWaves, n_harmonics: int
) -> RefinedWave:
    """Alternate between wave, noise and mismatch until they agree."""
    mismatch = np.zeros((layout.is_kind.shape[1], n_harmonics))
    k, phase_rate, phase = start.k, start.phase_rate, None
    for _ in range(_REFINEMENTS):
        best = refine_once(window, layout, motion, k, phase_rate, mismatch, phase)
        moved = max(
            float(np.abs(best.waves.phase_rate - phase_rate)[0]), float(np.abs(best.waves.k - k).max())
        )
        is_converged = moved < _CONVERGED_RAD and np.allclose(best.mismatch, mismatch, rtol=0.05)
        k, phase_rate, phase, mismatch = best.waves.k, best.waves.phase_rate, best.waves.phase, best.mismatch
        if is_converged:
            break
    return replace(best, is_wave=suits_channels(best, window, layout, motion, float(start.phase_rate[0])))


def refine_once(
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    k: FloatArray,
    phase_rate: FloatArray,
    mismatch: FloatArray,
    phase: FloatArray | None = None,
) -> RefinedWave:
    """Climb from a wave vector (1, 2) and phase rate (1,) with a known mismatch; then estimate that anew.

    `is_wave` is not tested.
    """
    equations = normal_equations(window, float(phase_rate[0]), mismatch.shape[1])
    variance = noise_variance(window, equations)
    solver = WaveSolver(window, layout, motion, variance, mismatch)
    waves = solver.solve(equations, k, phase_rate, 2, phase)
    return RefinedWave(waves, equations, variance, solver.mismatch_variance(equations, waves), True, window.n)


def suits_channels(
    best: RefinedWave, window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, phase_rate: float
) -> bool:
    """True where the phases of a wave that was found from a start at `phase_rate` suit the channels."""
    waves, equations = best.waves, best.equations
    if abs(float(waves.phase_rate[0]) - phase_rate) >= _LARGEST_PHASE_RATE_MOVE:
        return False
    if float(best.mismatch[:, 0].mean()) / equations.n_harmonics >= _MOST_MISMATCH:
        return False
    free = float((equations.explained() / best.variance).sum())
    noise = float(special.chdtri(len(best.variance) * equations.n_harmonics, FALSE_LINE))
    plain = WaveSolver(window, layout, motion, best.variance)
    # Where this wave is right, it also passes at the maximum without mismatch.
    most = max(MOST_UNEXPLAINED_PART * free, noise)
    if free - float(plain.gain(equations, waves)[0]) < most:
        return True
    moved = plain.solve(equations, waves.k, waves.phase_rate, 2, waves.phase)
    return free - float(moved.gain[0]) < most


def variance_inflation(
    window: DetrendedWindow, layout: ChannelLayout, solver: WaveSolver, best: RefinedWave, slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Factors, at least 1, for the variances of ``slope @ (kx, ky, phase_rate)``.

    Parameters
    ----------
    solver : WaveSolver
        With noise and mismatch of `best`.
    slope : (answers, 3) float64

    Returns
    -------
    by_noise, by_mismatch : (answers,) float64
    """
    stated = np.maximum(np.einsum("ai,ij,aj->a", slope, best.waves.covariance[0], slope), 1e-200)
    by_noise, by_mismatch = np.ones(len(slope)), np.ones(len(slope))
    noise = _noise_beside(window, best)
    if len(noise):
        m = 2 * best.equations.n_harmonics
        white = np.linalg.solve(best.equations.gram[:, :m, :m], noise[..., :m, np.newaxis])[..., 0]
        floor = float(((white * noise[..., :m]).sum(axis=-1) / best.variance).mean()) / m
        by_noise = np.maximum(by_noise, _more_than_white(np.array(floor), m * noise[..., 0].size))
        moved = ((solver.displacements(best.equations, best.waves, noise) @ slope.T) ** 2).mean(axis=0)
        by_noise = np.maximum(by_noise, _more_than_white(moved / stated, len(noise)))
    n_taxels = len(layout.places_mm)
    if best.mismatch.any() and n_taxels > _SPENT_TAXELS:
        is_taxel = layout.taxel == np.arange(n_taxels)[:, np.newaxis]
        parts = is_taxel[..., np.newaxis] * solver.residual_products(best.equations, best.waves)
        moved = ((solver.displacements(best.equations, best.waves, parts) @ slope.T) ** 2).sum(axis=0)
        left = n_taxels - _SPENT_TAXELS
        effect, dof = design_effect(solver.standardised_mismatch(best.equations, best.waves), layout)
        by_mismatch = np.maximum(
            moved * n_taxels / left / stated * _small_sample_factor(left), effect * _small_sample_factor(dof)
        )
    return by_noise, by_mismatch


def _small_sample_factor(dof: float) -> float:
    """Widening that gives a variance from few degrees of freedom the usual coverage at two sigma."""
    return (special.stdtrit(dof, _TAIL) / special.ndtri(_TAIL)) ** 2


def design_effect(mismatches: FloatArray, layout: ChannelLayout) -> tuple[float, float]:
    """Design effect (Kish 1965) of channels that deviate together within taxels, and its degrees of freedom.

    The ratio of the variance of the taxels' sums to that of as many independent channels.

    Parameters
    ----------
    mismatches : (channels,) float64
        In standard deviations.
    """
    n_taxels, n_channels = len(layout.places_mm), len(mismatches)
    sums, sizes = np.bincount(layout.taxel, mismatches), np.bincount(layout.taxel)
    left = max(n_taxels - _SPENT_TAXELS, 1)
    left_channels = max(n_channels - layout.is_kind.shape[1] - 2, 1)
    effect = (sums**2 / sizes).sum() / left / max((mismatches**2).sum() / left_channels, 1e-300)
    effect = float(np.clip(effect, 1.0, n_channels / n_taxels))
    return effect, max(left_channels / effect, 1.0)


def _more_than_white(ratio: FloatArray, dof: int) -> FloatArray:
    """The ratio where white noise would rarely reach it, else 1."""
    return np.where(ratio > special.chdtri(dof, _FALSE_INFLATION) / dof, ratio, 1.0)


def _noise_beside(window: DetrendedWindow, best: RefinedWave) -> FloatArray:
    """Noise at frequencies beside the line as products of the equations: (samples, channels, functions)."""
    phase_rate, n_harmonics = float(best.waves.phase_rate[0]), best.equations.n_harmonics
    left = window.without_lines(phase_rate, range(1, n_harmonics + 1))
    cycles = phase_rate / np.pi
    away = np.arange(-2 * _PLACES, 2 * _PLACES + 1)
    there = cycles + away
    multiple = np.round(there / cycles) * cycles
    clear = np.abs(there - multiple) >= np.minimum(_NEAREST, cycles / 2)
    clear |= multiple > n_harmonics * cycles + 0.5
    fits = (np.abs(away) >= _NEAREST) & (there > _SLOWEST) & (there < 0.5 * window.n - 1) & clear
    away = away[fits][np.argsort(np.abs(away[fits]), kind="stable")][:_PLACES]
    travel = window.travel.mean(axis=0)
    rows = []
    for h in range(1, n_harmonics + 1):
        wave = np.exp(-1j * np.outer(travel, h * phase_rate + np.pi * away))  # (n, places)
        for weighted in (wave, wave * travel[:, np.newaxis]):
            shifted = left.volts @ weighted
            # A line of any phase: the cosine, and the sine a quarter of a period later.
            rows.append(np.concatenate([shifted, 1j * shifted], axis=1))
    plain, late = np.array(rows[0::2]), np.array(rows[1::2])
    parts = [part for z in plain for part in (z.real, -z.imag)]
    parts += [part for z in late for part in (z.real, -z.imag)]
    return np.stack(parts, axis=-1).swapaxes(0, 1)

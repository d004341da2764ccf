"""Sigmas that are true on noise that is not white, and on skins whose ripple is no perfect plane wave.

The Fisher information takes noise to be white, and channels' noise to be independent. Of coloured noise only
what is near a line's frequency matters (Grenander, Szego 1958). So what the fit leaves at frequencies beside
the line is shifted onto it, some places to either side, and the fit asked how far each would have moved the
answer. That sees a raised floor and the side bands of an uneven speed, also those that all channels share.

Where phases stray within kinds, those of one taxel may stray together. There each taxel's part in the
answer is one sample of how far taxels move it (a cluster-robust variance: Liang, Zeger 1986).
"""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Window
from tactiled.detect.grooves.model import Layout
from tactiled.detect.grooves.refine import Refined
from tactiled.detect.grooves.solve import Solver

_PLACES = 8  # beside the line: fewer say little, more are far from it
# Periods of the window, but for rounding: nearer, the fit has taken the noise with the line.
_NEAREST = 1.0 - 1e-9
_SLOWEST = 0.75  # periods: below, the trend has taken it
# White noise passes for more than white so often; the sigma is then too wide by what it seemed to be.
_FALSE_COLOUR = 0.01
_TAIL = 0.025
_SPENT_TAXELS = 3  # by wave vector and phase: what is left of a few taxels' parts is too small by that


def inflation(
    window: Window, layout: Layout, solver: Solver, best: Refined, slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Factors for the variances of ``slope @ (kx, ky, turn)``, none below 1: by noise, and by strays.

    Parameters
    ----------
    solver : Solver
        With the noise and strays of `best`.
    slope : (answers, 3) float64
    """
    stated = np.maximum(np.einsum("ai,ij,aj->a", slope, best.waves.covariance[0], slope), 1e-200)
    factor, strayed = np.ones(len(slope)), np.ones(len(slope))
    noise = _beside(window, best)
    if len(noise):
        m = 2 * best.tables.n_harmonics
        white = np.linalg.solve(best.tables.gram[:, :m, :m], noise[..., :m, np.newaxis])[..., 0]
        floor = float(((white * noise[..., :m]).sum(axis=-1) / best.variance).mean()) / m
        factor = np.maximum(factor, _more_than_white(np.array(floor), m * noise[..., 0].size))
        moved = ((solver.moves(best.tables, best.waves, noise) @ slope.T) ** 2).mean(axis=0)
        factor = np.maximum(factor, _more_than_white(moved / stated, len(noise)))
    n_taxels = len(layout.places_mm)
    if best.stray.any() and n_taxels > _SPENT_TAXELS:
        is_taxel = layout.taxel == np.arange(n_taxels)[:, np.newaxis]
        parts = is_taxel[..., np.newaxis] * solver.surprise(best.tables, best.waves)
        moved = ((solver.moves(best.tables, best.waves, parts) @ slope.T) ** 2).sum(axis=0)
        left = n_taxels - _SPENT_TAXELS
        effect, dof = design_effect(solver.strays(best.tables, best.waves), layout)
        strayed = np.maximum(moved * n_taxels / left / stated * _unsure(left), effect * _unsure(dof))
    return factor, strayed


def _unsure(dof: float) -> float:
    """A variance out of so few is itself unsure: as wide as makes two sigmas hold as they do elsewhere."""
    return float(special.stdtrit(dof, _TAIL) / special.ndtri(_TAIL)) ** 2


def design_effect(strays: FloatArray, layout: Layout) -> tuple[float, float]:
    """By how many channels are too many where those of one taxel stray together; degrees of freedom left.

    Variance of the taxels' sums over that of as many strangers (Kish 1965).

    Parameters
    ----------
    strays : (channels,) float64
        In sigmas.
    """
    n_taxels, n_channels = len(layout.places_mm), len(strays)
    sums, sizes = np.bincount(layout.taxel, strays), np.bincount(layout.taxel)
    left = max(n_taxels - _SPENT_TAXELS, 1)
    left_channels = max(n_channels - len(np.unique(layout.kind)) - 2, 1)
    effect = (sums**2 / sizes).sum() / left / max((strays**2).sum() / left_channels, 1e-300)
    effect = float(np.clip(effect, 1.0, n_channels / n_taxels))
    return effect, max(left_channels / effect, 1.0)


def _more_than_white(ratio: FloatArray, dof: int) -> FloatArray:
    """The ratio where white noise would hardly reach it, else 1."""
    return np.where(ratio > special.chdtri(dof, _FALSE_COLOUR) / dof, ratio, 1.0)


def _beside(window: Window, best: Refined) -> FloatArray:
    """Noise of the places beside the line as products of the tables: (samples, channels, functions)."""
    turn, n_harmonics = float(best.waves.turn[0]), best.tables.n_harmonics
    left = window.without(turn, range(1, n_harmonics + 1))
    cycles = turn / np.pi
    away = np.arange(-2 * _PLACES, 2 * _PLACES + 1)
    there = cycles + away
    multiple = np.round(there / cycles) * cycles
    clear = np.abs(there - multiple) >= np.minimum(_NEAREST, cycles / 2)
    clear |= multiple > n_harmonics * cycles + 0.5
    fits = (np.abs(away) >= _NEAREST) & (there > _SLOWEST) & (there < 0.5 * window.n - 1) & clear
    away = away[fits][np.argsort(np.abs(away[fits]), kind="stable")][:_PLACES]
    way = window.way.mean(axis=0)
    rows = []
    for h in range(1, n_harmonics + 1):
        wave = np.exp(-1j * np.outer(way, h * turn + np.pi * away))  # (n, places)
        for weighted in (wave, wave * way[:, np.newaxis]):
            shifted = left.volts @ weighted
            # A line of any phase: as it comes, and a quarter of a turn later.
            rows.append(np.concatenate([shifted, 1j * shifted], axis=1))
    plain, late = np.array(rows[0::2]), np.array(rows[1::2])
    parts = [part for z in plain for part in (z.real, -z.imag)]
    parts += [part for z in late for part in (z.real, -z.imag)]
    return np.stack(parts, axis=-1).swapaxes(0, 1)

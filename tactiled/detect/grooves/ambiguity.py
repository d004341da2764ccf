"""Test whether one reading of the phases is the true one: the best against all others that they allow."""

from dataclasses import replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import (
    MAX_CANDIDATES,
    ChannelLayout,
    WaveFit,
    WaveMotion,
    WaveParams,
    period_and_angle,
)
from tactiled.detect.grooves.phasors import Phasors
from tactiled.detect.grooves.refine import RefinedWave, design_effect, refine
from tactiled.detect.grooves.search import channel_phasors, search_wave_vectors
from tactiled.detect.grooves.solve import WaveSolver
from tactiled.detect.grooves.window import DetrendedWindow, normal_equations
from tactiled.events.types import Candidate

# Likelihoods of mismatch models are tempered (raised to the power 1 / 2), since mismatch is not quite what
# the models assume.
TEMPERATURE = 2.0
# Probability that phases contradict a true motion.
_FALSE_CONFLICT = 1e-6
# Spread of the channels' positions. With less there are no delays to measure.
_LEAST_SPREAD_MM2 = 1e-6


def assess_ambiguity(
    fit: WaveFit,
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
) -> WaveFit:
    """Add the probability that another reading is true; "ambiguous" where it is too large.

    Parameters
    ----------
    fit : WaveFit
    best : RefinedWave
        The first of `found`, refined.
    found : PlaneWaves
        All readings that the phases allow.
    window : DetrendedWindow
    layout : ChannelLayout
    motion : WaveMotion
    params : WaveParams
    """
    # Solve all of them again with the noise and mismatch known by now.
    solver = WaveSolver(window, layout, motion, best.variance, best.fundamental_mismatch)
    equations = normal_equations(window, float(best.waves.phase_rate[0]), 1)
    found = solver.solve(equations, found.k, found.phase_rate, steps=2)
    effect = (
        design_effect(solver.standardised_mismatch(equations, found[0]), layout)[0]
        if best.mismatch.any()
        else 1.0
    )
    odds = np.exp((found.gain - found.gain.max()) / 2 / max(effect, fit.noise_inflation))
    weights = odds / odds.sum()
    if best.mismatch.any():
        k, likelihood = rank_with_phasors(best, found, window, layout, fit.noise_inflation)
        fit = _widened(fit, best.waves.k[0], k[0], motion)
        odds = np.exp((likelihood - likelihood.max()) / TEMPERATURE)
        # The first model of mismatch is better for small mismatch, the second for that of taxel loads.
        weights = max(weights, odds / odds.sum(), key=lambda each: float(each[0]))
    error = float(1 - weights[0])
    if error <= params.error_probability and not _contradicts_motion(
        best, found, window, layout, motion, params
    ):
        return replace(fit, error_probability=error)
    return WaveFit(
        "ambiguous",
        fit.frequency_hz,
        fit.snr_db,
        error_probability=error,
        candidates=_candidates(found, weights),
    )


def rank_with_phasors(
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    noise_inflation: float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Wave vectors and log-likelihoods where taxel loads may cause the mismatch (`Phasors.nearby`)."""
    variance = 2 * best.variance * noise_inflation / window.n
    return Phasors(channel_phasors(window, best.equations, 1), variance, layout).nearby(found.k)


def _widened(fit: WaveFit, k: FloatArray, other: FloatArray, motion: WaveMotion) -> WaveFit:
    """Add the difference between the answers of two mismatch models to the covariance."""
    here, there = period_and_angle(k), period_and_angle(other)
    turned = (np.radians(there[1] - here[1]) + np.pi / 2) % np.pi - np.pi / 2
    along = float(k @ motion.heading), float(other @ motion.heading)
    faster = fit.speed_mm_s * (along[0] / along[1] - 1) if not motion.has_speed and along[1] else 0.0
    off = np.array([there[0] - here[0], turned, faster])
    return replace(fit, covariance=fit.covariance + np.outer(off, off))


def _contradicts_motion(
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
) -> bool:
    """True where a wave of another motion suits the phases far better than the given motion."""
    free = motion.without_speed
    if not motion.has_speed or not best.mismatch.any() or not has_baseline(layout, free):
        return False
    equations = normal_equations(window, float(best.waves.phase_rate[0]), 1)
    others = search_wave_vectors(window, equations, layout, free, params, best.variance, 0.0)
    if not len(others.k):
        return False
    shared = len(layout.x_mm) / len(layout.places_mm)
    least = shared * special.chdtri(1, _FALSE_CONFLICT)
    # Allowing for mismatch improves both fits: a free motion gains more without mismatch than with it.
    likeliest = found[int(found.gain.argmax())]
    plain = WaveSolver(window, layout, motion, best.variance).solve(
        equations, likeliest.k, likeliest.phase_rate, 2
    )
    if others.gain[0] - plain.gain[0] <= least:
        return False
    other = refine(window, layout, free, params, others[0])
    mismatch = other.fundamental_mismatch
    tied = WaveSolver(window, layout, motion, other.variance, mismatch).solve(
        equations, found.k, found.phase_rate, steps=2
    )
    loose = WaveSolver(window, layout, free, other.variance, mismatch).solve(
        equations, other.waves.k, other.waves.phase_rate, 2
    )
    return bool(loose.gain[0] - tied.gain.max() > least)


def has_baseline(layout: ChannelLayout, motion: WaveMotion) -> bool:
    """True where channels of one kind are far enough apart in the directions that matter."""
    place = np.stack([layout.x_mm, layout.y_mm], axis=1)
    spread = np.zeros((2, 2))
    for kind in np.unique(layout.kind):
        mine = place[layout.kind == kind]
        spread += (mine - mine.mean(axis=0)).T @ (mine - mine.mean(axis=0))
    normal = np.array([-motion.heading[1], motion.heading[0]])
    least = normal @ spread @ normal if motion.has_speed else np.linalg.eigvalsh(spread)[0]
    return bool(least > _LEAST_SPREAD_MM2)


def _candidates(found: PlaneWaves, weights: FloatArray) -> tuple[Candidate, ...]:
    """The likeliest readings, with their weights."""
    shown = [i for i in np.argsort(-weights, kind="stable")[:MAX_CANDIDATES] if weights[i] > 1e-4]
    return tuple(
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(weights[i]))
        for i in shown
        for period_mm, angle_deg in [period_and_angle(found.k[i])]
    )

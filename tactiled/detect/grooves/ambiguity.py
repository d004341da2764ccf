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
    distinct,
    period_and_angle,
)
from tactiled.detect.grooves.phasors import Phasors
from tactiled.detect.grooves.refine import RefinedWave, refine
from tactiled.detect.grooves.search import channel_phasors, search_wave_vectors
from tactiled.detect.grooves.solve import WaveSolver
from tactiled.detect.grooves.strays import StrayPosterior, weigh_waves
from tactiled.detect.grooves.window import DetrendedWindow, normal_equations
from tactiled.events.types import Candidate

# Likelihoods of the model of taxel loads are tempered (raised to the power 1 / 2), since loads are few, and
# fitted instead of integrated out.
_TEMPERATURE = 2.0
# Probability that phases contradict a true motion.
_FALSE_CONFLICT = 1e-6
# Spread of the channels' positions. With less there are no delays to measure.
_LEAST_SPREAD_MM2 = 1e-6


def assess_ambiguity(
    fit: WaveFit,
    noise_inflation: float,
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
) -> WaveFit:
    """Add the probability that another reading is true; a refusal where it is too large.

    Parameters
    ----------
    noise_inflation : float
        Ratio of the noise at the line to that of `best`.
    best : RefinedWave
        The first of `found`, refined.
    found : PlaneWaves
        All readings that the phases allow.
    """
    posterior = weigh_readings(best, found, window, layout, motion, params, noise_inflation)
    likeliest = int(posterior.weights.argmax())
    if best.mismatch.any():
        fit = _widened(fit, best.waves.k[0], posterior.k, motion)
    # `best` is the first; where another one is likelier by now, the two are hard to tell.
    error = float(1 - posterior.weights[0])
    is_known = likeliest == 0 and error <= params.error_probability
    if is_known and not contradicts_motion(best, found, window, layout, motion, params):
        return replace(fit, error_probability=error, stray_rad=posterior.stray_rad)
    is_uneven = posterior.error_if_alike <= params.error_probability
    return WaveFit(
        "uneven-channels" if is_uneven else "ambiguous",
        fit.frequency_hz,
        fit.snr_db,
        error_probability=error,
        candidates=_candidates(found, posterior.weights),
        stray_rad=posterior.stray_rad,
    )


def weigh_readings(
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    noise_inflation: float = 1.0,
) -> StrayPosterior:
    """Probabilities of all readings `found`, given the noise of the best one.

    Where strays that are independent (`strays`) leave it open which reading is true, the alternative is tried
    that they follow the loads of the taxels (`Phasors`). Both models are averaged by their likelihoods.
    """
    variance = best.variance * noise_inflation
    line = best.equations
    z = channel_phasors(window, line, 1)
    posterior = weigh_waves(
        z,
        2 * variance / window.n,
        layout,
        found.k,
        motion,
        float(best.waves.phase_rate[0]) / window.half_travel,
        line.phase_rate_sd(variance) / window.half_travel,
    )
    if 1 - posterior.weights.max() <= params.error_probability:
        return posterior
    by_channel, by_load = Phasors(z, 2 * variance / window.n, layout).by_mismatch(found.k)
    part = special.expit(float(by_load.max() - by_channel.max()))
    weights = part * special.softmax(by_load / _TEMPERATURE) + (1 - part) * posterior.weights
    return replace(posterior, weights=weights)


def _widened(fit: WaveFit, k: FloatArray, other: FloatArray, motion: WaveMotion) -> WaveFit:
    """Add the difference to the answer of another model of strays to the covariance."""
    here, there = period_and_angle(k), period_and_angle(other)
    turned = (np.radians(there[1] - here[1]) + np.pi / 2) % np.pi - np.pi / 2
    along = float(k @ motion.heading), float(other @ motion.heading)
    faster = fit.speed_mm_s * (along[0] / along[1] - 1) if not motion.has_speed and along[1] else 0.0
    off = np.array([there[0] - here[0], turned, faster])
    return replace(fit, covariance=fit.covariance + np.outer(off, off))


def contradicts_motion(
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
    for kind in distinct(layout.kind):
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

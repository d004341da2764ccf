"""Test whether one reading of the phases is the true one: the best against all others that they allow."""

from dataclasses import replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import (
    FALSE_ALARM,
    MAX_CANDIDATES,
    ChannelLayout,
    WaveMotion,
    distinct,
    period_and_angle,
)
from tactiled.detect.grooves.phasors import Phasors
from tactiled.detect.grooves.refine import RefinedWave, refine
from tactiled.detect.grooves.ripple import Ripple
from tactiled.detect.grooves.search import search_wave_vectors
from tactiled.detect.grooves.solve import PlaneWaves, WaveSolver
from tactiled.detect.grooves.strays import StrayPosterior, weigh_waves
from tactiled.events.types import Candidate

# prior: likelihoods of the model of taxel loads are tempered (raised to the power 1 / 2), since loads are
# few, and fitted instead of integrated out.
_TEMPERATURE = 2.0
# derived: spread of the channels' positions. With less there are no delays to measure.
_LEAST_SPREAD_MM2 = 1e-6


def weigh_readings(best: RefinedWave, found: PlaneWaves, noise_inflation: float = 1.0) -> StrayPosterior:
    """Probabilities of all readings `found`, of which `best` is the first one refined.

    Where strays that are independent (`strays`) leave it open which reading is true, the alternative is tried
    that they follow the loads of the taxels (`Phasors`). Both models are averaged by their likelihoods.

    Parameters
    ----------
    noise_inflation : float
        Ratio of the noise at the line to that of `best`.
    """
    window, variance = best.window, best.variance * noise_inflation
    z, layout = best.equations.phasors(), window.layout
    posterior = weigh_waves(
        z,
        2 * variance / window.n,
        layout,
        found.k,
        window.motion,
        best.phase_rate / window.half_travel,
        best.equations.phase_rate_sd(variance) / window.half_travel,
    )
    if 1 - posterior.weights.max() <= window.params.error_probability:
        return posterior
    by_channel, by_load = Phasors(z, 2 * variance / window.n, layout).by_mismatch(found.k)
    part = special.expit(float(by_load.max() - by_channel.max()))
    weights = part * special.softmax(by_load / _TEMPERATURE) + (1 - part) * posterior.weights
    return replace(posterior, weights=weights)


def contradicts_motion(best: RefinedWave, found: PlaneWaves) -> bool:
    """True where a wave of another motion suits the phases far better than the given motion."""
    window, layout = best.window, best.window.layout
    free = window.without_speed
    if not window.motion.has_speed or not best.mismatch.any() or not has_baseline(layout, free.motion):
        return False
    ripple = Ripple(free, best.phase_rate, best.variance)
    equations, others = ripple.equations, search_wave_vectors(ripple, 0.0)
    if not len(others.k):
        return False
    shared = len(layout.x_mm) / len(layout.places_mm)
    least = shared * special.chdtri(1, FALSE_ALARM)
    # Allowing for mismatch improves both fits: a free motion gains more without mismatch than with it.
    likeliest = found[int(found.gain.argmax())]
    plain = WaveSolver(window, best.variance).solve(equations, likeliest.k, likeliest.phase_rate, 2)
    if others.gain[0] - plain.gain[0] <= least:
        return False
    other = refine(free, others[0])
    mismatch = other.fundamental_mismatch
    tied = WaveSolver(window, other.variance, mismatch).solve(equations, found.k, found.phase_rate, 2)
    loose = WaveSolver(free, other.variance, mismatch).solve(
        equations, other.waves.k, other.waves.phase_rate, 2
    )
    return bool(loose.gain[0] - tied.gain.max() > least)


def has_baseline(layout: ChannelLayout, motion: WaveMotion) -> bool:
    """True where channels of one kind are far enough apart in the directions that matter."""
    spread = np.zeros((2, 2))
    for kind in distinct(layout.kind):
        mine = layout.xy_mm[layout.kind == kind]
        spread += (mine - mine.mean(axis=0)).T @ (mine - mine.mean(axis=0))
    across = motion.across
    least = across @ spread @ across if motion.has_speed else np.linalg.eigvalsh(spread)[0]
    return bool(least > _LEAST_SPREAD_MM2)


def likely_gratings(found: PlaneWaves, weights: FloatArray) -> tuple[Candidate, ...]:
    """The likeliest readings, with their weights."""
    shown = [i for i in np.argsort(-weights, kind="stable")[:MAX_CANDIDATES] if weights[i] > 1e-4]
    return tuple(
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(weights[i]))
        for i in shown
        for period_mm, angle_deg in [period_and_angle(found.k[i])]
    )

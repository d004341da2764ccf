"""Whether one reading of the phases is the true one: the best against all others that they allow."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Window, tabulate
from tactiled.detect.grooves.linear import Waves
from tactiled.detect.grooves.model import Layout, WaveFit, WaveMotion, WaveParams
from tactiled.detect.grooves.noise import design_effect
from tactiled.detect.grooves.pair import Pair
from tactiled.detect.grooves.phasors import Phasors
from tactiled.detect.grooves.refine import Refined, refine
from tactiled.detect.grooves.search import phasors_at, search
from tactiled.detect.grooves.solve import Solver
from tactiled.events.types import Candidate

_MOST_CANDIDATES = 8
_MOST_PAIRS = 4  # that suit about as well: with more, naming them says nothing
TEMPER = (
    2.0  # likelihoods of strays that are not quite what they are taken for are no better than their roots
)
_LEAST_WEIGHT = 0.02  # of a pair to be named
_FALSE_CONFLICT = 1e-6  # phases belie a motion that is true so often
_LEAST_SPREAD_MM2 = 1e-6  # of places: less, and there are no delays to go by


def weighed(
    fit: WaveFit,
    best: Refined,
    found: Waves,
    window: Window,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
) -> WaveFit:
    """The fit with the probability that another reading is true; "ambiguous" where that is too large."""
    # All of them anew, with what is known by now of noise and strays; `best` is the refined first.
    solver = Solver(window, layout, motion, best.variance, best.stray_alone)
    tables = tabulate(window, float(best.waves.turn[0]), 1)
    found = solver.solve(tables, found.k, found.turn, steps=2)
    effect = design_effect(solver.strays(tables, found[0]), layout)[0] if best.stray.any() else 1.0
    odds = np.exp((found.gain - found.gain.max()) / 2 / max(effect, fit.colour))
    weights = odds / odds.sum()
    if best.stray.any():
        k, likelihood = by_load(best, found, window, layout, fit.colour)
        fit = _as_unsure(fit, best.waves.k[0], k[0], motion)
        odds = np.exp((likelihood - likelihood.max()) / TEMPER)
        # Small strays are told better by the first way to take them, those of taxels' loads by the second.
        weights = max(weights, odds / odds.sum(), key=lambda each: float(each[0]))
    error = float(1 - weights[0])
    if error <= params.error_probability and not _belies(best, found, window, layout, motion, params):
        return replace(fit, error_probability=error)
    return WaveFit(
        "ambiguous",
        fit.frequency_hz,
        fit.snr_db,
        error_probability=error,
        candidates=_candidates(found, weights),
    )


def by_load(
    best: Refined, found: Waves, window: Window, layout: Layout, colour: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Readings where strays are put down to taxels' loads (`Phasors.nearby`), and their likelihoods."""
    variance = 2 * best.variance * colour / window.n
    return Phasors(phasors_at(window, best.tables, 1), variance, layout).nearby(found.k)


def _as_unsure(fit: WaveFit, k: FloatArray, other: FloatArray, motion: WaveMotion) -> WaveFit:
    """As unsure as two ways to take strays differ: each wave vector is the answer of one."""
    here, there = reading(k), reading(other)
    turned = (np.radians(there[1] - here[1]) + np.pi / 2) % np.pi - np.pi / 2
    along = float(k @ motion.heading), float(other @ motion.heading)
    faster = fit.speed_mm_s * (along[0] / along[1] - 1) if not motion.has_speed and along[1] else 0.0
    off = np.array([there[0] - here[0], turned, faster])
    return replace(fit, covariance=fit.covariance + np.outer(off, off))


def _belies(
    best: Refined, found: Waves, window: Window, layout: Layout, motion: WaveMotion, params: WaveParams
) -> bool:
    """Whether a wave of another motion than the one said to be known suits the phases far better."""
    free = motion.without_speed
    if not motion.has_speed or not best.stray.any() or not has_lever(layout, free):
        return False
    tables = tabulate(window, float(best.waves.turn[0]), 1)
    others = search(window, tables, layout, free, params, best.variance, 0.0)
    if not len(others.k):
        return False
    shared = len(layout.x_mm) / len(layout.places_mm)
    least = shared * special.chdtri(1, _FALSE_CONFLICT)
    # Strays let either do better: what freedom is worth without them is more than with them.
    likeliest = found[int(found.gain.argmax())]
    plain = Solver(window, layout, motion, best.variance).solve(tables, likeliest.k, likeliest.turn, 2)
    if others.gain[0] - plain.gain[0] <= least:
        return False
    other = refine(window, layout, free, params, others[0])
    stray = other.stray_alone
    tied = Solver(window, layout, motion, other.variance, stray).solve(tables, found.k, found.turn, steps=2)
    loose = Solver(window, layout, free, other.variance, stray).solve(
        tables, other.waves.k, other.waves.turn, 2
    )
    return bool(loose.gain[0] - tied.gain.max() > least)


def has_lever(layout: Layout, motion: WaveMotion) -> bool:
    """Whether channels of one kind are far enough apart, in the directions that matter."""
    place = np.stack([layout.x_mm, layout.y_mm], axis=1)
    spread = np.zeros((2, 2))
    for kind in np.unique(layout.kind):
        mine = place[layout.kind == kind]
        spread += (mine - mine.mean(axis=0)).T @ (mine - mine.mean(axis=0))
    normal = np.array([-motion.heading[1], motion.heading[0]])
    least = normal @ spread @ normal if motion.has_speed else np.linalg.eigvalsh(spread)[0]
    return bool(least > _LEAST_SPREAD_MM2)


def _candidates(found: Waves, weights: FloatArray) -> tuple[Candidate, ...]:
    shown = [i for i in np.argsort(-weights, kind="stable")[:_MOST_CANDIDATES] if weights[i] > 1e-4]
    return tuple(
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(weights[i]))
        for i in shown
        for period_mm, angle_deg in [reading(found.k[i])]
    )


def pair_candidates(pairs: Sequence[Pair]) -> tuple[Candidate, ...]:
    """Members of the pairs that may be true, each with its share of the pair's weight; none of too many."""
    likely = [pair for pair in pairs if pair.weight > _LEAST_WEIGHT]
    if len(likely) > _MOST_PAIRS:
        return ()
    named = [
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(pair.weight * share))
        for pair in likely
        for k, share in zip(pair.k, pair.share, strict=True)
        if k.any()
        for period_mm, angle_deg in [reading(k)]
    ]
    return tuple(sorted(named, key=lambda candidate: -candidate.weight))


def reading(k: FloatArray) -> tuple[float, float]:
    """Period and angle (within -90..90) of a wave vector."""
    angle = np.arctan2(k[1], k[0])
    angle -= np.pi * np.round(angle / np.pi)
    return float(2 * np.pi / np.hypot(k[0], k[1])), float(np.degrees(angle))

"""All wave vectors that the phases of one frequency allow: the integer ambiguity, listed and weighed."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables, Window
from tactiled.detect.grooves.linear import Waves
from tactiled.detect.grooves.model import Layout, WaveMotion, WaveParams
from tactiled.detect.grooves.solve import Solver

_STEP_RAD = 0.5  # of phase at the rim of the array, from one point of the grid to the next
_MOST_STARTS = 24
# Starts that explain less than this part of what the best does, and less by so much, win by no refinement.
_LEAST_PART = 0.5
_LEAST_GAP = 100.0
_SLACK_SIGMAS = 3.0
_TINY = 1e-300  # what is nothing at all may be divided by
_SAME_RAD = 0.3  # at the rim: two starts that meet this closely have found one maximum


def search(
    window: Window,
    tables: Tables,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    variance: FloatArray,
    least: float,
) -> Waves:
    """Local maxima of the likelihood over the wave vector, the best first; maybe none.

    Parameters
    ----------
    tables : Tables
        At the line's frequency, fundamental only.
    least : float
        The best must explain more than this (`together`).
    """
    heading = motion.heading if motion.has_direction else np.array([1.0, 0.0])
    slack = tables.turn_sd(variance)
    along, across = _grid(window, tables.turn, slack, layout, motion, params)
    if not len(along) or not len(across):
        return _none()
    z = phasors_at(window, tables, 1)
    scores = _scores(z, layout, heading, along, across, variance)
    if motion.has_speed and len(along) > 1:
        # What is said of the motion counts too; without it ridges, as a column of taxels has, have no peak.
        sigmas = (along - tables.turn / window.half_way) / (np.ptp(along) / 2 / _SLACK_SIGMAS)
        scores = scores - (2 / window.n) * sigmas[:, np.newaxis] ** 2
    # A maximum just inside the limits may have its point of the grid outside.
    step = _step(layout)
    starts = np.argwhere(_is_peak(scores))
    starts = starts[_is_within(along[starts[:, 0]], across[starts[:, 1]], motion, params, step)]
    if not len(starts):
        return _none()
    high = scores[starts[:, 0], starts[:, 1]]
    near = high >= min(_LEAST_PART * high.max(), high.max() - _LEAST_GAP)
    starts = starts[near][np.argsort(-high[near], kind="stable")][:_MOST_STARTS]
    normal = np.array([-heading[1], heading[0]])
    k = along[starts[:, :1]] * heading + across[starts[:, 1:]] * normal
    solver = Solver(window, layout, motion, variance)
    found = solver.solve(tables, k, solver.likely_turn(k, tables.turn, _SLACK_SIGMAS))
    found = found[np.flatnonzero(_is_within(found.k @ heading, found.k @ normal, motion, params, step / 2))]
    if not len(found.k):
        return _none()
    found = _distinct(found[np.argsort(-found.gain, kind="stable")], layout)
    return found if score(z, layout, found.k[0], variance) > least else _none()


def _step(layout: Layout) -> float:
    """From one point of the grid to the next, radians per millimetre."""
    return _STEP_RAD / layout.rim_mm


def _is_within(
    along: FloatArray, across: FloatArray, motion: WaveMotion, params: WaveParams, margin: float
) -> NDArray[np.bool_]:
    """Whether wave vectors are within the operator's limits, but for a margin (radians per millimetre)."""
    size = np.hypot(along, across)
    within = size <= 2 * np.pi / params.min_period_mm + margin
    least = 2 * np.pi / params.max_period_mm
    within &= size >= max(least - margin, least / 2)  # what all channels feel at once is none
    if motion.has_direction:
        within &= (along > 0) & (np.abs(across) <= along * np.tan(np.radians(params.max_tilt_deg)) + margin)
    return np.asarray(within)


def together(window: Window, tables: Tables, layout: Layout, variance: FloatArray) -> float:
    """What a vibration that all channels feel at the same time would explain.

    It may look like a wave whose phases are nearly whole turns; but no wave suits it better than this.
    """
    return score(phasors_at(window, tables, 1), layout, np.zeros(2), variance)


def phasors_at(window: Window, tables: Tables, harmonic: int) -> FloatArray:
    """Amplitude and phase of each channel by itself, as if sampled at once: (channels,) complex128."""
    parts = tables.phasors()
    late = np.exp(-1j * harmonic * tables.turn * window.lag)
    return np.asarray((parts[:, 2 * harmonic - 2] - 1j * parts[:, 2 * harmonic - 1]) * late)


def score(z: FloatArray, layout: Layout, k: FloatArray, variance: FloatArray) -> float:
    """Power over noise that a wave vector explains of phasors, in amplitudes squared."""
    pull = np.abs(z) * z / variance
    late = np.exp(-1j * (layout.x_mm * k[0] + layout.y_mm * k[1]))
    seen, total = (pull * late) @ layout.is_kind, np.abs(pull) @ layout.is_kind
    return float((np.abs(seen) ** 2 / np.maximum(total, _TINY)).sum())


def best_score(
    z: FloatArray,
    turn: float,
    window: Window,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    variance: FloatArray,
) -> tuple[float, int]:
    """The same by the best wave vector there is, and how many were tried."""
    along, across = _grid(window, turn, 0.0, layout, motion, params)
    scores = _scores(z, layout, motion.heading, along, across, variance)
    return float(scores.max(initial=0.0)), max(scores.size, 1)


def _grid(
    window: Window, turn: float, turn_sd: float, layout: Layout, motion: WaveMotion, params: WaveParams
) -> tuple[FloatArray, FloatArray]:
    """Components of the wave vector along the motion and across it."""
    step = _step(layout)
    largest = 2 * np.pi / params.min_period_mm + step
    n_across = int(np.ceil(largest / step))
    across = np.arange(-n_across, n_across + 1) * step
    if not motion.has_speed:
        along = across[across > 0] if motion.has_direction else across
        return np.asarray(along), np.asarray(across)
    exact = turn / window.half_way
    by_speed = exact * motion.speed_sd_mm_s / motion.speed_mm_s
    by_direction = largest * np.radians(motion.direction_sd_deg)
    slack = float(np.linalg.norm([by_speed, by_direction, turn_sd / window.half_way]))
    reach = _SLACK_SIGMAS * slack if slack > step / _SLACK_SIGMAS else 0.0
    first, last = max(-reach, step - exact) / step, min(reach, largest - exact) / step
    along = exact + np.arange(np.ceil(first), np.floor(last) + 1) * step
    return np.asarray(along), np.asarray(across)


def _scores(
    z: FloatArray,
    layout: Layout,
    heading: FloatArray,
    along: FloatArray,
    across: FloatArray,
    variance: FloatArray,
) -> FloatArray:
    """What a wave would explain if amplitudes were those that channels show by themselves."""
    x, y = layout.places_mm @ heading, layout.places_mm @ [-heading[1], heading[0]]
    by_along, by_across = np.exp(-1j * np.outer(along, x)), np.exp(-1j * np.outer(y, across))
    pull = np.zeros((layout.is_kind.shape[1], len(x)), dtype=np.complex128)
    np.add.at(pull, (layout.is_kind.argmax(axis=1), layout.taxel), np.abs(z) * z / variance)
    scores = np.zeros((len(along), len(across)))
    for each in pull:
        seen = (by_along * each) @ by_across
        scores += (seen.real**2 + seen.imag**2) / max(float(np.abs(each).sum()), _TINY)
    return scores


def _is_peak(scores: FloatArray) -> NDArray[np.bool_]:
    """Points no lower than their neighbours along each axis."""
    peak = np.ones(scores.shape, dtype=np.bool_)
    for axis in (0, 1):
        if scores.shape[axis] > 1:
            rises = np.diff(scores, axis=axis) > 0
            first = [slice(None)] * 2
            first[axis] = slice(0, 1)
            edge = np.ones_like(rises[tuple(first)])
            peak &= np.concatenate([edge, rises], axis=axis) & ~np.concatenate([rises, ~edge], axis=axis)
    return peak


def _distinct(waves: Waves, layout: Layout) -> Waves:
    """Without those that another start found before."""
    kept: list[int] = []
    for i in range(len(waves.k)):
        gaps = np.abs(waves.k[kept] - waves.k[i]).max(axis=1) if kept else np.array([np.inf])
        if gaps.min() * layout.rim_mm > _SAME_RAD:
            kept.append(i)
    return waves[np.array(kept)]


def _none() -> Waves:
    empty = np.zeros(0)
    return Waves(np.zeros((0, 2)), empty, empty, np.zeros((0, 3, 3)), np.zeros((0, 0, 0)))

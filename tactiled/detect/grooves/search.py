"""List every wave vector that the phases of one line allow: the integer ambiguity."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import SAME_WAVE_RAD, TINY, ChannelLayout
from tactiled.detect.grooves.ripple import Ripple
from tactiled.detect.grooves.solve import LARGEST_STEP_RAD, PlaneWaves, WaveSolver
from tactiled.detect.grooves.window import DetrendedWindow

# choice: peaks of the grid that are refined, the highest first.
_MOST_STARTS = 24
# prior: a start that explains less than this part of what the best one does cannot win by refinement.
_LEAST_PART = 0.5
_SLACK_SIGMAS = 3.0  # choice


def search_wave_vectors(ripple: Ripple, least: float) -> PlaneWaves:
    """Local maxima of the likelihood over the wave vector, the best first, which explains more than `least`.

    May be empty.
    """
    window, equations = ripple.window, ripple.equations
    k = _starts(ripple)
    if len(k):
        solver = WaveSolver(window, ripple.variance)
        rate = solver.likely_phase_rate(k, equations.phase_rate, _SLACK_SIGMAS)
        found = solver.solve(equations, k, rate)
        heading, normal = _axes(window)
        margin = grid_step(window.layout) / 2
        found = found[np.flatnonzero(_is_within(found.k @ heading, found.k @ normal, window, margin))]
        found = _distinct(found[np.argsort(-found.gain, kind="stable")], window.layout)
        z = equations.phasors()
        if len(found.k) and explained_power(z, window.layout, found.k[0], ripple.variance) > least:
            return found
    none = np.zeros(0)
    return PlaneWaves(np.zeros((0, 2)), none, none, np.zeros((0, 3, 3)), np.zeros((0, 0, 0)))


def _axes(window: DetrendedWindow) -> tuple[FloatArray, FloatArray]:
    """Directions along the motion, where that is known, and across it."""
    motion = window.motion
    return (motion.heading, motion.across) if motion.has_direction else (np.eye(2)[0], np.eye(2)[1])


def _starts(ripple: Ripple) -> FloatArray:
    """Wave vectors (starts, 2) of the highest peaks of a grid, from each channel's own amplitude."""
    window, equations, motion = ripple.window, ripple.equations, ripple.window.motion
    heading, normal = _axes(window)
    along, across = _grid(window, equations.phase_rate, equations.own_phase_rate(ripple.variance)[1])
    if not len(along) or not len(across):
        return np.zeros((0, 2))
    scores = _scores(equations.phasors(), window.layout, heading, along, across, ripple.variance)
    if motion.has_speed and len(along) > 1:
        # The prior of a known motion counts too. Without it the ridges that one column of taxels makes have
        # no peak.
        sigmas = (along - equations.phase_rate / window.half_travel) / (np.ptp(along) / 2 / _SLACK_SIGMAS)
        scores = scores - (2 / window.n) * sigmas[:, np.newaxis] ** 2
    starts = np.argwhere(_is_peak(scores))
    # The grid point of a maximum just inside the limits may lie outside them.
    margin = grid_step(window.layout)
    starts = starts[_is_within(along[starts[:, 0]], across[starts[:, 1]], window, margin)]
    high = scores[starts[:, 0], starts[:, 1]]
    highest = high.max(initial=0.0)
    near = high >= _LEAST_PART * highest
    starts = starts[near][np.argsort(-high[near], kind="stable")][:_MOST_STARTS]
    return np.asarray(along[starts[:, :1]] * heading + across[starts[:, 1:]] * normal)


def grid_step(layout: ChannelLayout) -> float:
    """Distance between points of a search grid, radians per millimetre: a peak is a step of the fit away."""
    return LARGEST_STEP_RAD / layout.radius_mm


def _is_within(
    along: FloatArray, across: FloatArray, window: DetrendedWindow, margin: float
) -> NDArray[np.bool_]:
    """True for wave vectors inside the operator's limits, with a margin (radians per millimetre)."""
    motion, params = window.motion, window.params
    size = np.hypot(along, across)
    within = size <= 2 * np.pi / params.min_period_mm + margin
    least = 2 * np.pi / params.max_period_mm
    # a wave vector of zero is common to all channels and no grating
    within &= size >= max(least - margin, least / 2)
    if motion.has_direction:
        within &= (along > 0) & (np.abs(across) <= along * np.tan(np.radians(params.max_tilt_deg)) + margin)
    return np.asarray(within)


def common_mode_power(ripple: Ripple) -> float:
    """Power that a vibration common to all channels would explain.

    Such a vibration may resemble a wave whose phases are nearly whole turns, but no wave then explains more
    power than this.
    """
    return explained_power(ripple.equations.phasors(), ripple.window.layout, np.zeros(2), ripple.variance)


def explained_power(
    z: NDArray[np.complex128], layout: ChannelLayout, k: FloatArray, variance: FloatArray
) -> float:
    """Power over noise variance that one wave vector explains of phasors, in squared amplitudes."""
    pull = np.abs(z) * z / variance
    late = np.exp(-1j * (layout.x_mm * k[0] + layout.y_mm * k[1]))
    seen, total = (pull * late) @ layout.is_kind, np.abs(pull) @ layout.is_kind
    return float((np.abs(seen) ** 2 / np.maximum(total, TINY)).sum())


def _grid(window: DetrendedWindow, phase_rate: float, phase_rate_sd: float) -> tuple[FloatArray, FloatArray]:
    """Grid of wave-vector components along the motion and across it."""
    motion, step = window.motion, grid_step(window.layout)
    largest = 2 * np.pi / window.params.min_period_mm + step
    n_across = int(np.ceil(largest / step))
    across = np.arange(-n_across, n_across + 1) * step
    if not motion.has_speed:
        along = across[across > 0] if motion.has_direction else across
        return np.asarray(along), np.asarray(across)
    exact = phase_rate / window.half_travel
    by_speed = exact * motion.speed_sd_mm_s / motion.speed_mm_s
    by_direction = largest * np.radians(motion.direction_sd_deg)
    slack = float(np.linalg.norm([by_speed, by_direction, phase_rate_sd / window.half_travel]))
    reach = _SLACK_SIGMAS * slack
    first, last = max(-reach, step - exact) / step, min(reach, largest - exact) / step
    along = exact + np.arange(np.ceil(first), np.floor(last) + 1) * step
    return np.asarray(along), np.asarray(across)


def _scores(
    z: NDArray[np.complex128],
    layout: ChannelLayout,
    heading: FloatArray,
    along: FloatArray,
    across: FloatArray,
    variance: FloatArray,
) -> FloatArray:
    """Explained power at grid points (along, across), from each channel's own amplitude."""
    x, y = layout.places_mm @ heading, layout.places_mm @ [-heading[1], heading[0]]
    by_along, by_across = np.exp(-1j * np.outer(along, x)), np.exp(-1j * np.outer(y, across))
    pull = np.zeros((layout.is_kind.shape[1], len(x)), dtype=np.complex128)
    np.add.at(pull, (layout.is_kind.argmax(axis=1), layout.taxel), np.abs(z) * z / variance)
    scores = np.zeros((len(along), len(across)))
    for each in pull:
        seen = (by_along * each) @ by_across
        scores += (seen.real**2 + seen.imag**2) / max(float(np.abs(each).sum()), TINY)
    return scores


def _is_peak(scores: FloatArray) -> NDArray[np.bool_]:
    """True for grid points above the one before them and no lower than the one after, along each axis."""
    around = np.pad(scores, 1, constant_values=-np.inf)
    is_peak = (scores > around[:-2, 1:-1]) & (scores >= around[2:, 1:-1])
    return np.asarray(is_peak & (scores > around[1:-1, :-2]) & (scores >= around[1:-1, 2:]))


def _distinct(waves: PlaneWaves, layout: ChannelLayout) -> PlaneWaves:
    """Drop waves that equal an earlier one."""
    kept: list[int] = []
    for i in range(len(waves.k)):
        gaps = np.abs(waves.k[kept] - waves.k[i]).max(axis=1) if kept else np.array([np.inf])
        if gaps.min() * layout.radius_mm > SAME_WAVE_RAD:
            kept.append(i)
    return waves[np.array(kept, dtype=np.int64)]

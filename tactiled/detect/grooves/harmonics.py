"""Harmonics of a wave: those that are visible, and multiples of its frequency that belong to another wave."""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.equations import DetrendedWindow, NormalEquations
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import ALIASED, FALSE_ALARM
from tactiled.detect.grooves.search import explained_power, most_explained_power

# prior: part of a line's power. Less is not worth a search for another wave.
_LEAST_FOREIGN_PART = 0.05
# prior: part of a line's power, as the channels' own fits explain it. A wave that leaves more does not
# explain the line.
MOST_UNEXPLAINED_PART = 0.4


def visible_harmonics(window: DetrendedWindow, phase_rate: float) -> int:
    """Number of the highest harmonic that exceeds the noise."""
    sampled = int(2 * np.pi * ALIASED / (phase_rate * window.largest_step))
    highest = window.clear_harmonics(phase_rate, min(window.params.max_harmonics, sampled))
    if highest < 2:
        return 1
    equations = window.equations(phase_rate, highest)
    information = np.linalg.inv(equations.gram[:, : 2 * highest, : 2 * highest])
    level = special.chdtri(2 * len(equations.parts), FALSE_ALARM)
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        parts = equations.parts[:, pair]
        own = np.linalg.solve(information[:, pair, pair], parts[..., np.newaxis])[..., 0]
        if float(((own * parts).sum(axis=1) / equations.variance).sum()) > level:
            return h
    return 1


def line_powers(equations: NormalEquations, variance: FloatArray) -> FloatArray:
    """Power over noise of each harmonic, without the overlap of neighbouring lines: (harmonics,)."""
    parts = equations.parts**2 * np.einsum("gff->gf", equations.gram)[:, : 2 * equations.n_harmonics]
    return np.asarray((parts.T / variance).sum(axis=1).reshape(-1, 2).sum(axis=1))


def foreign_lines(waves: PlaneWaves, equations: NormalEquations, variance: FloatArray) -> list[int]:
    """Multiples of a wave's frequency that are not harmonics of this wave; 1 is the fundamental.

    The phases of a harmonic advance h times as fast across the array as those of the fundamental. The phases
    of noise, or of another grating whose ripple happens to be at a multiple, do not. Phase mismatch is taken
    as the cause of a misfit, unless another wave vector explains the line so much better that mismatch is
    unlikely (likelihood ratio of the phase variances, corrected for the number of vectors tried).

    Parameters
    ----------
    waves : PlaneWaves
        One wave.
    equations : NormalEquations
        With the lines in question.
    variance : (channels,) float64
    """
    window = equations.window
    power = window.n / 2  # power of a line of amplitude 1
    n_channels = len(variance)
    level = special.chdtri(n_channels, FALSE_ALARM)
    n_free = max(n_channels - window.layout.is_kind.shape[1] - 2, 1)
    foreign = []
    for h in range(1, equations.n_harmonics + 1):
        z = equations.phasors(h)
        free = power * float((np.abs(z) ** 2 / variance).sum())
        untied = free - power * explained_power(z, window.layout, h * waves.k[0], variance)
        if untied < max(level, _LEAST_FOREIGN_PART * free):
            continue
        if untied < MOST_UNEXPLAINED_PART * free:
            other, n_tried = most_explained_power(window, z, h * equations.phase_rate, variance)
            ratio = untied / max(free - power * other, n_channels)
            if n_free * np.log(ratio) < 2 * np.log(n_tried / FALSE_ALARM):
                continue
        foreign.append(h)
    return foreign

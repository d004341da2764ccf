"""Pairs of waves of one frequency that explain what channels show: a grid, and the way up from its peaks.

Amplitudes are solved for by least squares, for each kind of channel; which pair is likeliest, and whether
there are two waves at all, is asked elsewhere (`wave_pair`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import WaveMotion, WaveParams
from tactiled.detect.grooves.phasors import MOST_ALIKE, Phasors

_STEP_RAD = 0.5  # of phase at the rim of the array, from one point of the grid to the next
_ROWS = 64  # of the grid of pairs: what is computed of so many fits into a processor's cache
# Three rows of taxels are nearly explained by any two waves: many pairs are looked at, fewer more closely.
_TOP = 300  # peaks over the grid
_KEPT = (100, 50, 50)  # of them after each refinement
_STEPS = 2  # of each refinement
_REACH = 2.5  # sigmas that direction and speed may be off
_DAMPING = 1e-3  # of the diagonal: waves that are nearly alike must not fly apart
_MOST_TURNED_DEG = 45.0  # where nothing is known of the direction


@dataclass(frozen=True, eq=False)
class Tried:
    """Pairs that are tried.

    Attributes
    ----------
    along : (pairs,) float64
        Component along the motion as it is said, of a wave without one across it; radians per millimetre.
    turned : (pairs,) float64
        Tangent of the angle by which the motion is off.
    across : (pairs, 2) float64
        Component of each across the motion as it is said.
    is_wave : (pairs, 2) bool
        False for what is in step everywhere.
    """

    along: FloatArray
    turned: FloatArray
    across: FloatArray
    is_wave: NDArray[np.bool_]

    def __getitem__(self, chosen: NDArray[np.int64]) -> "Tried":
        return Tried(self.along[chosen], self.turned[chosen], self.across[chosen], self.is_wave[chosen])

    def k(self, heading: FloatArray) -> FloatArray:
        """Wave vectors: (pairs, 2, 2)."""
        along = self.along[:, np.newaxis] - self.turned[:, np.newaxis] * self.across
        normal = np.array([-heading[1], heading[0]])
        k = along[..., np.newaxis] * heading + self.across[..., np.newaxis] * normal
        return np.asarray(k * self.is_wave[..., np.newaxis])


def search_pairs(
    phasors: Phasors, motion: WaveMotion, params: WaveParams, along: FloatArray, rim_mm: float
) -> Tried:
    """Pairs that explain phasors by least squares, and more than any next to them; maybe none.

    Parameters
    ----------
    along : (lines,) float64
        What both waves may have as component along the motion, radians per millimetre, or nearly.
    rim_mm : float
        Of the array.
    """
    tried = _starts(phasors, motion, params, along, _STEP_RAD / rim_mm)
    return _refined(phasors, motion, tried, rim_mm) if len(tried.along) else tried


def _starts(
    phasors: Phasors, motion: WaveMotion, params: WaveParams, along: FloatArray, step: float
) -> Tried:
    """Peaks of what pairs on a grid explain by least squares; the second may be in step everywhere, too."""
    normal = np.array([-motion.heading[1], motion.heading[0]])
    n_across = int(np.ceil(2 * np.pi / params.min_period_mm / step))
    across = np.arange(-n_across, n_across + 1) * step
    parts = [np.zeros((0, 4))]
    for forward in along:
        grid = np.concatenate([forward * motion.heading + across[:, np.newaxis] * normal, np.zeros((1, 2))])
        first, second, explained = _peaks(phasors, grid)
        is_wave = second < len(across)
        there = np.concatenate([across, [0.0]])
        parts.append(
            np.stack([np.full(len(first), forward), there[first], there[second], is_wave], axis=1)[
                np.argsort(-explained, kind="stable")[:_TOP]
            ]
        )
    rows = np.concatenate(parts)
    is_wave = np.stack([np.ones(len(rows), dtype=np.bool_), rows[:, 3] > 0], axis=1)
    return Tried(rows[:, 0], np.zeros(len(rows)), rows[:, 1:3], is_wave)


def _peaks(phasors: Phasors, grid: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Which pairs of a grid's waves explain more than their neighbours, and how much.

    Points of the grid are evenly apart along a line, but for the last, which has no neighbour.
    """
    groups = []
    for place, z in phasors.groups:
        wave = np.exp(1j * (grid @ place.T))  # (points, channels)
        seen = wave.conj() @ z  # (points, kinds)
        # What two waves have in common depends on how many steps they are apart.
        by_steps, with_last = (wave.conj()[[0, -1]] @ wave.T) / len(place)
        groups.append((len(place), by_steps, with_last.conj(), seen, (np.abs(seen) ** 2).sum(axis=1)))
    found = []
    # Some rows at a time, with a neighbour on either side.
    for begin in range(0, len(grid), _ROWS):
        first = max(begin - 1, 0)
        some, later = slice(first, begin + _ROWS + 1), slice(first, None)
        explained = np.zeros((len(grid[some]), len(grid[later])))
        alike = np.zeros_like(explained)
        for n, by_steps, with_last, seen, own in groups:
            steps = np.concatenate([np.zeros(len(explained) - 1), by_steps[: explained.shape[1]]])
            overlap = sliding_window_view(steps, explained.shape[1])[::-1].copy()  # 0 below the diagonal
            overlap[:, -1] = with_last[some]
            common = overlap.real**2 + overlap.imag**2
            crossed = (overlap * (seen[some].conj() @ seen[later].T)).real
            both = own[some, np.newaxis] + own[later]
            explained += (both - 2 * crossed) / np.maximum(1 - common, 1 - MOST_ALIKE) / n
            alike = np.maximum(alike, common)
        explained[alike > MOST_ALIKE] = 0.0
        explained = np.triu(explained, 1)
        highest = np.empty_like(explained)
        highest[:, :-1] = ndimage.maximum_filter(explained[:, :-1], size=3)
        highest[:, -1] = ndimage.maximum_filter(explained[:, -1], size=3)
        row, column = np.nonzero((explained == highest) & (explained > 0))
        mine = (row >= begin - first) & (row < begin - first + _ROWS)
        found.append((row[mine] + first, column[mine] + first, explained[row, column][mine]))
    rows, columns, heights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return rows, columns, heights


def _refined(phasors: Phasors, motion: WaveMotion, tried: Tried, rim_mm: float) -> Tried:
    """What explains most near pairs, and the few of them that explain most.

    Gauss-Newton with amplitudes solved for at each step (Kaufman 1975).
    """
    turned_most = np.tan(np.radians(min(_REACH * motion.direction_sd_deg, _MOST_TURNED_DEG)))
    slack = _REACH * motion.speed_sd_mm_s / motion.speed_mm_s if motion.has_speed else 1.0
    reach = slack * np.abs(tried.along)
    along_least, along_most = tried.along - reach, tried.along + reach
    for most in _KEPT:
        for _ in range(_STEPS):
            move, _ = _move(phasors, motion.heading, tried, slack > 0, turned_most > 0)
            size = np.abs(move[:, [0, 2, 3]]).max(axis=1) * rim_mm
            move *= (_STEP_RAD / np.maximum(size, _STEP_RAD))[:, np.newaxis]
            tried = Tried(
                np.clip(tried.along + move[:, 0], along_least, along_most),
                np.clip(tried.turned + move[:, 1], -turned_most, turned_most),
                tried.across + move[:, 2:],
                tried.is_wave,
            )
        _, explained = _move(phasors, motion.heading, tried, False, False)
        kept = np.argsort(-explained, kind="stable")[:most]
        tried, along_least, along_most = tried[kept], along_least[kept], along_most[kept]
    return tried


def _move(
    phasors: Phasors, heading: FloatArray, tried: Tried, is_along_free: bool, is_turned_free: bool
) -> tuple[FloatArray, FloatArray]:
    """Where to go from pairs, (pairs, 4): along, turned, across of each; what they explain: (pairs,).

    A wave's phase grows from place to place by its components along and across. So of places only sums are
    asked: over products of two waves, or of wave and phasors, times coordinates or their products.
    """
    k, n_pairs = tried.k(heading), len(tried.along)
    normal = np.zeros((2, 2, 2, 2, n_pairs))  # wave and coordinate, twice
    gradient = np.zeros((2, 2, n_pairs))
    explained = np.zeros(n_pairs)
    for place, z in phasors.groups:
        along, across = place @ heading, place @ [-heading[1], heading[0]]
        times = np.stack([np.ones(len(place)), along, across])
        wave = np.exp(1j * (place @ k.transpose(1, 2, 0)))  # (2, places, pairs)
        squares = (times[:, np.newaxis] * times).reshape(9, -1)
        crossed = (squares @ (wave[0].conj() * wave[1])).reshape(3, 3, n_pairs)
        each = np.broadcast_to(squares.sum(axis=1).reshape(3, 3, 1), crossed.shape)
        # Sums of times * times * conj(wave) * wave: (3, 3, 2, 2, pairs).
        sums = np.stack([np.stack([each, crossed], axis=2), np.stack([crossed.conj(), each], axis=2)], axis=2)
        seen = (times[:, np.newaxis] * z.T).reshape(-1, len(place)) @ wave.conj()
        seen = seen.reshape(2, 3, -1, n_pairs)  # (waves, times, kinds, pairs)
        own, shared = (1 + 1e-6) * len(place), crossed[0, 0]
        inverse = np.array([[own + 0 * shared, -shared], [-shared.conj(), own + 0 * shared]])
        inverse /= own**2 - np.abs(shared) ** 2
        amplitude = np.einsum("mnj,nkj->mkj", inverse, seen[:, 0])
        explained += np.einsum("mkj,mkj->j", seen[:, 0].conj(), amplitude).real
        left = seen[:, 1:].swapaxes(0, 1) - np.einsum("umnj,nkj->umkj", sums[1:, 0], amplitude)
        gradient += np.einsum("mkj,umkj->muj", amplitude.conj(), left).imag
        taken = np.einsum("loj,vonj->vlnj", inverse, sums[1:, 0])
        rest = sums[1:, 1:] - np.einsum("umlj,vlnj->uvmnj", sums[1:, 0], taken)
        power = np.einsum("mkj,nkj->mnj", amplitude.conj(), amplitude)
        normal += np.einsum("mnj,uvmnj->munvj", power, rest).real
    by = np.zeros((4, 2, 2, n_pairs))  # wave and coordinate by what is looked for
    by[0, :, 0] = float(is_along_free)
    by[1, :, 0] = -tried.across.T * is_turned_free
    for wave_number in range(2):
        by[2 + wave_number, wave_number] = -tried.turned, np.ones(n_pairs)
    by *= tried.is_wave.T[:, np.newaxis]
    gradient = np.einsum("amuj,muj->ja", by, gradient)
    normal = np.einsum("amuj,bmuj->jab", by, np.einsum("bnvj,munvj->bmuj", by, normal))
    scale = np.einsum("jaa->ja", normal)
    normal[:, range(4), range(4)] += (
        _DAMPING * scale + np.maximum(scale.max(axis=1, keepdims=True), 1e-300) * 1e-9
    )
    return np.asarray(np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0]), explained

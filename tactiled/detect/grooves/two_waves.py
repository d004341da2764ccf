"""Test for two waves of one frequency: crossed grooves, a knurl, or a vibration at the ripple's frequency.

Each channel has its own amplitude, so the sum of two waves may pass as one wave between them whose channels
differ in gain and a little in phase. But then gains and phases are not arbitrary: a second wave with the same
motion explains them. Both hypotheses allow gain and phase mismatch (`phasors`), and their likelihoods decide,
with the penalty of Schwarz (1978) for the unknowns of the second wave.

Two waves of one frequency and one motion have the same component along the motion and differ across it.
Where the direction is uncertain, so is the direction of that difference; where the speed is unknown, so is
the common component.

Pairs are searched on a grid and refined from its peaks, with amplitudes by least squares for each kind of
channel. Where the likely pairs agree on one dominant wave, that of the fit, the weaker one is removed from
the window and the change is added to the covariance (`fit`). Otherwise the pairs are reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import (
    SAME_WAVE_RAD,
    ChannelLayout,
    WaveMotion,
    WaveParams,
    period_and_angle,
)
from tactiled.detect.grooves.phasors import MOST_ALIKE, Phasors
from tactiled.detect.grooves.refine import RefinedWave
from tactiled.detect.grooves.search import GRID_STEP_RAD, channel_phasors
from tactiled.detect.grooves.solve import LARGEST_STEP_RAD
from tactiled.detect.grooves.window import DetrendedWindow
from tactiled.detect.worker import pause
from tactiled.events.types import Candidate

# Rows of the grid of pairs computed at a time, so that the intermediate results fit into a processor's cache.
_GRID_ROWS = 64
# Peaks of the grid. Any two waves nearly explain three rows of taxels, so many pairs are tried.
_MOST_STARTS = 300
# Pairs kept after each refinement.
_MOST_KEPT = (100, 50, 50)
# Gauss-Newton steps of each refinement.
_REFINEMENT_STEPS = 2
# Standard deviations by which direction and speed may deviate.
_REACH = 2.5
# Part of the diagonal. Waves that are nearly alike must not diverge.
_DAMPING = 1e-3
# Bound where the direction is unknown.
_LARGEST_HEADING_ERROR_DEG = 45.0
# Readings of a line whose components along the motion are tried as common to two waves.
_MOST_READINGS = 3
# Part of the weight of all pairs, whose likelihoods are no more accurate than this.
_MOST_DISAGREEING_WEIGHT = 0.1
# Share of the power of two waves. With more it is not certain which one is the stronger.
_MOST_WEAKER_SHARE = 0.1
# Pairs that are about equally likely. With more, a list of them is of no use.
_MOST_PAIRS = 4
# Weight of a pair that is reported.
_LEAST_WEIGHT = 0.02


@dataclass(frozen=True, eq=False)
class WavePair:
    """Two waves of one frequency.

    Attributes
    ----------
    k : (2, 2) float64
        Wave vectors, the stronger first; zeros for a vibration common to all channels.
    share : (2,) float64
        Of the power of both.
    second : (channels,) complex128
        Phasors of the weaker.
    weight : float
        Probability that this pair is present, rather than another or one wave.
    """

    k: FloatArray
    share: FloatArray
    second: NDArray[np.complex128]
    weight: float


def find_pairs(
    z: FloatArray,
    variance: FloatArray,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    k: FloatArray,
    along: FloatArray,
) -> list[WavePair]:
    """Pairs of waves that explain what one does not, the likeliest first; empty where one wave suffices.

    Parameters
    ----------
    z : (channels,) complex128
        Phasors of the line.
    variance : (channels,) float64
        Of noise in the real and in the imaginary part of each.
    layout : ChannelLayout
    motion : WaveMotion
    params : WaveParams
    k : (2,) float64
        Wave vector of the one wave.
    along : (lines,) float64
        Approximate common component along the motion, radians per millimetre.
    """
    phasors = Phasors(z, variance, layout)
    # Unknowns of the second wave, and those that one wave leaves open.
    n_more = 2 * phasors.is_kind.shape[1] + 1 + int(motion.direction_sd_deg > 0)
    if len(z) < 2 * n_more + 1 or phasors.is_single_wave(k):
        return []
    alone = float(phasors.likelihood(k[np.newaxis, np.newaxis])[0]) + n_more / 2 * np.log(2 * len(z))
    if alone > -np.log(phasors.variance).sum():  # a perfect fit would not be likelier
        return []
    tried = search_pairs(phasors, motion, params, along, layout.radius_mm)
    if not len(tried.along):
        return []
    pairs = tried.k(motion.heading)
    prior = np.zeros(len(pairs))
    if motion.direction_sd_deg > 0:
        prior -= (np.degrees(np.arctan(tried.heading_error)) / motion.direction_sd_deg) ** 2 / 2
    likelihood = phasors.likelihood(pairs) + prior
    if likelihood.max() <= alone:
        return []
    odds_alone = np.exp(alone - likelihood.max())
    # Pairs are compared at the mismatch that the channels show with the likeliest pair.
    phasors.limit_mismatch_to(pairs[likelihood.argmax()])
    likelihood = phasors.likelihood(pairs) + prior
    order = np.argsort(-likelihood, kind="stable")
    likelihood = likelihood[order]
    fitted = phasors.fit(pairs[order])
    power = (np.abs(fitted) ** 2).mean(axis=1)
    stronger = np.argsort(-power, axis=1)
    pairs = np.take_along_axis(pairs[order], stronger[..., np.newaxis], axis=1)
    power = np.take_along_axis(power, stronger, axis=1)
    distinct: list[int] = []
    for i, pair in enumerate(pairs):
        if all(np.abs(pair - pairs[j]).max() * layout.radius_mm > SAME_WAVE_RAD for j in distinct):
            distinct.append(i)
    odds = np.exp(likelihood[distinct] - likelihood[0])
    odds /= odds.sum() + odds_alone
    return [
        WavePair(pairs[i], power[i] / power[i].sum(), fitted[i, :, stronger[i, 1]], float(weight))
        for i, weight in zip(distinct, odds, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class PairTrials:
    """Pairs under trial.

    Attributes
    ----------
    along : (pairs,) float64
        Component along the stated motion of a wave without one across it, radians per millimetre.
    heading_error : (pairs,) float64
        Tangent of the angle between true and stated motion.
    across : (pairs, 2) float64
        Component of each wave across the stated motion.
    is_wave : (pairs, 2) bool
        False for a vibration common to all channels.
    """

    along: FloatArray
    heading_error: FloatArray
    across: FloatArray
    is_wave: NDArray[np.bool_]

    def __getitem__(self, chosen: NDArray[np.int64]) -> "PairTrials":
        return PairTrials(
            self.along[chosen], self.heading_error[chosen], self.across[chosen], self.is_wave[chosen]
        )

    def k(self, heading: FloatArray) -> FloatArray:
        """Wave vectors: (pairs, 2, 2)."""
        along = self.along[:, np.newaxis] - self.heading_error[:, np.newaxis] * self.across
        normal = np.array([-heading[1], heading[0]])
        k = along[..., np.newaxis] * heading + self.across[..., np.newaxis] * normal
        return np.asarray(k * self.is_wave[..., np.newaxis])


def search_pairs(
    phasors: Phasors, motion: WaveMotion, params: WaveParams, along: FloatArray, radius_mm: float
) -> PairTrials:
    """Pairs that explain phasors by least squares, and more than their neighbours; may be empty.

    Parameters
    ----------
    phasors : Phasors
    motion : WaveMotion
    params : WaveParams
    along : (lines,) float64
        Approximate common component along the motion, radians per millimetre.
    radius_mm : float
        Of the array.
    """
    tried = _starts(phasors, motion, params, along, GRID_STEP_RAD / radius_mm)
    return _refined(phasors, motion, tried, radius_mm) if len(tried.along) else tried


def _starts(
    phasors: Phasors, motion: WaveMotion, params: WaveParams, along: FloatArray, step: float
) -> PairTrials:
    """Peaks of the least-squares power of pairs on a grid; the second may be a common vibration."""
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
                np.argsort(-explained, kind="stable")[:_MOST_STARTS]
            ]
        )
    rows = np.concatenate(parts)
    is_wave = np.stack([np.ones(len(rows), dtype=np.bool_), rows[:, 3] > 0], axis=1)
    return PairTrials(rows[:, 0], np.zeros(len(rows)), rows[:, 1:3], is_wave)


def _peaks(phasors: Phasors, grid: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Pairs of a grid's waves that explain more than their neighbours, and how much they explain.

    The points of the grid are evenly spaced on a line, except the last, which has no neighbour.
    """
    groups = []
    for place, z in phasors.groups:
        wave = np.exp(1j * (grid @ place.T))  # (points, channels)
        seen = wave.conj() @ z  # (points, kinds)
        # The overlap of two waves depends on the number of grid steps between them.
        by_steps, with_last = (wave.conj()[[0, -1]] @ wave.T) / len(place)
        groups.append((len(place), by_steps, with_last.conj(), seen, (np.abs(seen) ** 2).sum(axis=1)))
    found = []
    # A few rows at a time, with a neighbour on either side.
    for begin in range(0, len(grid), _GRID_ROWS):
        first = max(begin - 1, 0)
        some, later = slice(first, begin + _GRID_ROWS + 1), slice(first, None)
        explained = np.zeros((len(grid[some]), len(grid[later])))
        alike = np.zeros_like(explained)
        for n, by_steps, with_last, seen, own in groups:
            pause()
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
        highest[:, :-1] = _highest_near(_highest_near(explained[:, :-1]).T).T
        highest[:, -1] = _highest_near(explained[:, -1])
        row, column = np.nonzero((explained == highest) & (explained > 0))
        mine = (row >= begin - first) & (row < begin - first + _GRID_ROWS)
        found.append((row[mine] + first, column[mine] + first, explained[row, column][mine]))
    rows, columns, heights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return rows, columns, heights


def _highest_near(values: FloatArray) -> FloatArray:
    """Largest of each value and those before and behind it along the first axis."""
    highest = values.copy()
    np.maximum(highest[1:], values[:-1], out=highest[1:])
    np.maximum(highest[:-1], values[1:], out=highest[:-1])
    return highest


def _refined(phasors: Phasors, motion: WaveMotion, tried: PairTrials, radius_mm: float) -> PairTrials:
    """Refine pairs, and keep those that explain most.

    Gauss-Newton with the amplitudes solved for at each step (Kaufman 1975).
    """
    heading_error_most = np.tan(np.radians(min(_REACH * motion.direction_sd_deg, _LARGEST_HEADING_ERROR_DEG)))
    slack = _REACH * motion.speed_sd_mm_s / motion.speed_mm_s if motion.has_speed else 1.0
    reach = slack * np.abs(tried.along)
    along_least, along_most = tried.along - reach, tried.along + reach
    for most in _MOST_KEPT:
        for _ in range(_REFINEMENT_STEPS):
            pause()
            move, _ = _move(phasors, motion.heading, tried, slack > 0, heading_error_most > 0)
            size = np.abs(move[:, [0, 2, 3]]).max(axis=1) * radius_mm
            move *= (LARGEST_STEP_RAD / np.maximum(size, LARGEST_STEP_RAD))[:, np.newaxis]
            tried = PairTrials(
                np.clip(tried.along + move[:, 0], along_least, along_most),
                np.clip(tried.heading_error + move[:, 1], -heading_error_most, heading_error_most),
                tried.across + move[:, 2:],
                tried.is_wave,
            )
        _, explained = _move(phasors, motion.heading, tried, False, False)
        kept = np.argsort(-explained, kind="stable")[:most]
        tried, along_least, along_most = tried[kept], along_least[kept], along_most[kept]
    return tried


def _move(
    phasors: Phasors, heading: FloatArray, tried: PairTrials, is_along_free: bool, is_heading_free: bool
) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton step (pairs, 4) in along, heading error and across of each; explained power (pairs,).

    A wave's phase is linear in its components along and across, so only sums over positions are needed: of
    products of two waves, or of wave and phasors, times coordinates or products of coordinates.
    """
    k, n_pairs = tried.k(heading), len(tried.along)
    normal = np.zeros((2, 2, 2, 2, n_pairs))  # wave and coordinate, twice
    gradient = np.zeros((2, 2, n_pairs))
    explained = np.zeros(n_pairs)
    for place, z in phasors.groups:
        pause()
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
    by = np.zeros((4, 2, 2, n_pairs))  # derivative of (wave, coordinate) by each unknown
    by[0, :, 0] = float(is_along_free)
    by[1, :, 0] = -tried.across.T * is_heading_free
    for wave_number in range(2):
        by[2 + wave_number, wave_number] = -tried.heading_error, np.ones(n_pairs)
    by *= tried.is_wave.T[:, np.newaxis]
    gradient = np.einsum("amuj,muj->ja", by, gradient)
    normal = np.einsum("amuj,bmuj->jab", by, np.einsum("bnvj,munvj->bmuj", by, normal))
    scale = np.einsum("jaa->ja", normal)
    normal[:, range(4), range(4)] += (
        _DAMPING * scale + np.maximum(scale.max(axis=1, keepdims=True), 1e-300) * 1e-9
    )
    return np.asarray(np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0]), explained


def pairs_in_line(
    noise_inflation: float,
    best: RefinedWave,
    found: PlaneWaves,
    window: DetrendedWindow,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
) -> list[WavePair]:
    """Pairs of waves of one frequency that explain a line which one wave does not."""
    along = best.waves.phase_rate / window.half_travel
    if not motion.has_speed:
        along = np.concatenate([best.waves.k @ motion.heading, found.k[:_MOST_READINGS] @ motion.heading])
        steps: list[float] = np.round(along * np.ptp(layout.x_mm)).tolist()
        along = along[[steps.index(step) for step in sorted(set(steps))]]
    variance = 2 * best.variance * noise_inflation / window.n
    z = channel_phasors(window, best.equations, 1)
    return find_pairs(z, variance, layout, motion, params, best.waves.k[0], along)


def pairs_confirm_fit(pairs: list[WavePair], best: RefinedWave, layout: ChannelLayout) -> bool:
    """True where the likely pairs share one dominant wave, that of the fit."""
    others = 0.0
    for pair in pairs:
        off_rad = np.abs(pair.k[0] - best.waves.k[0]).max() * layout.radius_mm
        others += pair.weight * (pair.share[1] > _MOST_WEAKER_SHARE or off_rad > SAME_WAVE_RAD)
    return others <= _MOST_DISAGREEING_WEIGHT


def pair_candidates(pairs: Sequence[WavePair]) -> tuple[Candidate, ...]:
    """Members of the likely pairs, each with its share of the pair's weight; empty for too many pairs."""
    likely = [pair for pair in pairs if pair.weight > _LEAST_WEIGHT]
    if len(likely) > _MOST_PAIRS:
        return ()
    named = [
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(pair.weight * share))
        for pair in likely
        for k, share in zip(pair.k, pair.share, strict=True)
        if k.any()
        for period_mm, angle_deg in [period_and_angle(k)]
    ]
    return tuple(sorted(named, key=lambda candidate: -candidate.weight))

"""Test whether a line holds a second wave: crossed grooves, a knurl, or a vibration of the same frequency.

Two waves of one frequency leave no second line in the spectrum. Each channel has its own gain, so their sum
may pass as one wave whose channels differ in gain and a little in phase. But then gains and phases are not
arbitrary: a second wave explains them. Both hypotheses allow mismatch of gain and phase (`phasors`), and
their likelihoods decide, with the penalty of Schwarz (1978) for the unknowns of the second wave.

Two waves of one frequency and one motion have the same component along the motion. So pairs are searched on a
grid across it, and the best few are refined.
"""

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import SAME_WAVE_RAD, WaveMotion
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.grooves.phasors import NEIGHBOURS, Phasors
from tactiled.detect.grooves.search import GRID_STEP_RAD
from tactiled.detect.grooves.window import DetrendedWindow
from tactiled.detect.worker import pause

_BLOCK = 64  # choice: waves whose overlaps with all later ones fit into the cache
# choice: pairs that are refined, the ones that explain most.
_MOST_STARTS = 6
# choice: grid steps of the refinement, in phase at the edge of the array.
_STEPS_RAD = (0.12, 0.04)
# prior: squared overlap of two waves on the channels of one kind. Above it they cannot be resolved.
_MOST_ALIKE = 0.9
# choice: standard deviations by which the direction may deviate, and the largest deviation, where it is
# unknown.
_REACH = 2.5
_LARGEST_HEADING_ERROR_DEG = 45.0  # choice
# choice: directions tried to either side of the stated one. Each takes 2 ms with 36 channels.
_MOST_HEADINGS = 3
# tuned: power that two waves leave of what one leaves. Of gains and phases that differ at random a second
# wave takes a part, too: with strays of 0.1 to 0.3 rad two waves left 0.60 to 0.88, with two gratings mostly
# less than 0.3 (windows of `bench texture`, on which this was set).
_MOST_LEFT = 0.58
# prior: log-odds of two waves over one: a probability of 0.1, since an answer over two waves is often a wrong
# one.
_LEAST_LOG_ODDS = float(np.log(0.1 / 0.9))
# prior: the same where the phases suit one wave: a probability of 0.99. Gains that differ by chance pass for
# two waves, and two waves that turn no phases, because one is an alias of the other, are seen clearly.
_LEAST_IF_ALIKE = float(np.log(0.99 / 0.01))
# prior: share of the power of both waves. A weaker one hardly moves the answer, if the stronger one is the
# answer, and uneven pads look like it.
_LEAST_SHARE = 0.05


def has_second_wave(
    window: DetrendedWindow,
    z: NDArray[np.complex128],
    variance: FloatArray,
    k: FloatArray,
    are_alike: bool,
) -> bool:
    """True where a second wave of the same frequency explains what one wave (2,) does not.

    Phasors and variances are as for `Phasors`; `are_alike` says that the phases of a kind show no mismatch.
    """
    layout, motion, params = window.layout, window.motion, window.params
    phasors = Phasors(z, variance, layout)
    # Amplitudes of the kinds, the component across the motion, and where it is uncertain the direction.
    n_more = 2 * phasors.is_kind.shape[1] + 1 + int(motion.direction_sd_deg > 0)
    if len(z) < 2 * n_more + 1 or phasors.is_single_wave(k):
        return False
    alone = float(phasors.likelihood(k[np.newaxis, np.newaxis])[0]) + n_more / 2 * np.log(2 * len(z))
    if alone > -np.log(phasors.variance).sum():  # a perfect fit would not be likelier
        return False
    pairs = _likely_pairs(phasors, motion, params, k, GRID_STEP_RAD / layout.radius_mm)
    if min(_left(phasors, pair) for pair in pairs) > _MOST_LEFT * _left(phasors, k[np.newaxis]):
        return False
    for step_rad in _STEPS_RAD:
        for moved in (1, 0):
            pause()
            near = np.repeat(pairs[:, np.newaxis], len(NEIGHBOURS), axis=1)
            near[:, :, moved] += NEIGHBOURS * step_rad / layout.radius_mm
            each = phasors.likelihood(near.reshape(-1, 2, 2)).reshape(len(pairs), -1)
            chosen = np.arange(len(pairs)), each.argmax(axis=1)
            pairs = near[chosen]
    likelihood = phasors.likelihood(pairs)
    power = (np.abs(phasors.fit(pairs)) ** 2).sum(axis=1)
    stronger = pairs[np.arange(len(pairs)), power.argmax(axis=1)]
    matters = power.min(axis=1) > _LEAST_SHARE * power.sum(axis=1)
    matters |= np.abs(stronger - k).max(axis=1) * layout.radius_mm > SAME_WAVE_RAD
    least = _LEAST_IF_ALIKE if are_alike else _LEAST_LOG_ODDS
    return bool((likelihood[matters] - alone > least).any())


def _left(phasors: Phasors, waves: FloatArray) -> float:
    """Power that waves (waves, 2) leave by least squares."""
    return float((np.abs(phasors.z - phasors.fit(waves[np.newaxis])[0].sum(axis=-1)) ** 2).sum())


def _likely_pairs(
    phasors: Phasors, motion: WaveMotion, params: WaveParams, k: FloatArray, step: float
) -> FloatArray:
    """Pairs of waves (pairs, 2, 2) that explain most, by least squares.

    All pairs of a grid across each likely motion; the waves have the component of k along it. The second one
    may be common to all channels.
    """
    normal = motion.across
    n_across = int(np.ceil(2 * np.pi / params.min_period_mm / step))
    across = np.arange(-n_across, n_across + 1) * step
    off = across - k @ normal
    largest = np.tan(np.radians(min(_REACH * motion.direction_sd_deg, _LARGEST_HEADING_ERROR_DEG)))
    n_errors = min(int(np.ceil(largest * np.abs(off).max() / (2 * step))), _MOST_HEADINGS)
    pairs, explained = [], []
    for error in np.linspace(-largest, largest, 2 * n_errors + 1):
        pause()
        along = k @ motion.heading - error * off
        waves = along[:, np.newaxis] * motion.heading + across[:, np.newaxis] * normal
        each = _explained(phasors, waves)
        waves = np.concatenate([waves, np.zeros((1, 2))])
        best = np.argpartition(-each, _MOST_STARTS, axis=None)[:_MOST_STARTS]
        one, other = np.unravel_index(best, each.shape)
        pairs.append(np.stack([waves[one], waves[other]], axis=1))
        explained.append(each[one, other])
    chosen = np.argsort(-np.concatenate(explained), kind="stable")[:_MOST_STARTS]
    return np.asarray(np.concatenate(pairs)[chosen])


def _explained(phasors: Phasors, waves: FloatArray) -> FloatArray:
    """Power that each wave and each later one explain together, by least squares: (waves, waves + 1).

    The waves are evenly spaced, so that their overlaps depend on their distance alone. The last column is of
    the one that is common to all channels.
    """
    n = len(waves)
    explained = np.zeros((n, n + 1))
    for place, z in phasors.groups:
        own = np.exp(1j * (waves @ place.T)) / np.sqrt(len(place))
        seen = own.conj() @ z
        power = (np.abs(seen) ** 2).sum(axis=1)
        by_distance = own @ own[0].conj()
        factor = _resolved(by_distance)
        for first in range(0, n, _BLOCK):
            rows, later = slice(first, first + _BLOCK), slice(first, n)
            crossed = seen[rows].conj() @ seen[later].T
            crossed *= _by_distance(by_distance[: n - first], len(crossed))
            both = power[rows, np.newaxis] + power[later] - 2 * crossed.real
            explained[rows, later] += both * _by_distance(factor[: n - first], len(crossed))
        common = z.sum(axis=0) / np.sqrt(len(place))
        with_common = own.conj().sum(axis=1) / np.sqrt(len(place))
        both = power + (np.abs(common) ** 2).sum() - 2 * ((seen.conj() @ common) * with_common).real
        explained[:, n] += _resolved(with_common) * both
    return np.triu(explained, 1)


def _by_distance(values: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """Matrix (rows, columns) of values by the distance of column from row, negative ones conjugate."""
    whole = np.concatenate([values[n_rows - 1 : 0 : -1].conj(), values])
    return sliding_window_view(whole, len(values))[::-1]


def _resolved(overlap: NDArray[np.complex128]) -> FloatArray:
    """Factor of what two waves of an overlap explain by least squares; 0 where they cannot be resolved."""
    alike = overlap.real**2 + overlap.imag**2
    return np.where(alike < _MOST_ALIKE, 1 / np.maximum(1 - alike, 1 - _MOST_ALIKE), 0.0)

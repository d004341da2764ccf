"""Whether two waves share one frequency: crossed grooves, a knurl, or a vibration at the ripple's frequency.

Amplitudes are each channel's own, so the sum of two waves may pass for one between them whose channels differ
in gain, and phase a little. But then gains and phases are no accident: a second wave with the same motion
explains them. Both readings are given gains and phases that stray around one complex amplitude for each kind
of channel, by as much as suits the kind; their likelihoods say which it is (with the penalty of Schwarz 1978
for the second wave's unknowns). A taxel that is pressed more feels more in all its channels: such gains
belong to one wave.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from tactiled.array import FloatArray
from tactiled.detect.wave_model import Layout, WaveMotion, WaveParams

_STEP_RAD = 0.5  # of phase at the rim of the array, from one point of the grid to the next
# Three rows of taxels are nearly explained by any two waves: many pairs are looked at, fewer more closely.
_TOP = 300  # peaks over the grid
_KEPT = (100, 50, 50, 50)  # of them after each refinement, to a quarter of the step before
_SAME_RAD = 0.3  # at the rim: two refined pairs that are this close are one
_GAIN_STEPS = 3  # of gains and amplitudes in turn
_LEAST_GAIN = 0.02  # of a taxel over the largest
_FALSE_PAIR = 1e-2  # one wave, channels alike, is looked at for another so often
_MOST_ALIKE = 0.9  # overlap (squared) of two waves on a kind's channels: beyond, they are one
_LEAST_STRAY = 0.03  # of gain and of phase (radians): no skin's channels are more alike
# Variances of strays that are tried: (strays of gain * strays of phase, 1, 1).
_STRAYS = np.array([0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0]) ** 2
_GAIN, _PHASE = (each.reshape(-1, 1, 1) for each in np.meshgrid(_STRAYS, _STRAYS))


@dataclass(frozen=True, eq=False)
class Pair:
    """Two waves of one frequency.

    Attributes
    ----------
    k : (2, 2) float64
        Wave vectors, the stronger first; zeros for a vibration that all channels feel at once.
    share : (2,) float64
        Of the power of both.
    second : (channels,) complex128
        Phasors of the weaker.
    weight : float
        Probability that it is this pair, and not another or one wave.
    """

    k: FloatArray
    share: FloatArray
    second: NDArray[np.complex128]
    weight: float


class _Phasors:
    """Likelihoods of waves for the phasors of one line."""

    def __init__(self, z: FloatArray, variance: FloatArray, layout: Layout) -> None:
        self.z, self.variance = z, variance + (_LEAST_STRAY * np.abs(z)) ** 2
        self.place = np.stack([layout.x_mm, layout.y_mm], axis=1)
        self.gain = np.ones(len(z))
        self.is_kind = (layout.kind[:, np.newaxis] == np.unique(layout.kind)).astype(np.float64)

        together: dict[bytes, list[NDArray[np.bool_]]] = {}
        for mine in self.is_kind.T.astype(bool):
            together.setdefault(self.place[mine].tobytes(), []).append(mine)
        # Places, and the phasors there of all kinds whose channels are at just these.
        self.groups = [
            (self.place[kinds[0]], np.stack([z[mine] for mine in kinds], axis=1))
            for kinds in together.values()
        ]

    def explained(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Power that pairs explain by least squares: (pairs, firsts, seconds).

        Parameters
        ----------
        first, second : (pairs, firsts or seconds, 2) float64
            Each of the one goes with each of the other.
        """
        total = np.zeros((len(first), first.shape[1], second.shape[1]))
        for place, z in self.groups:
            one, other = np.exp(-1j * (first @ place.T)), np.exp(-1j * (second @ place.T))
            by_one, by_other = one @ z, other @ z  # (pairs, waves, kinds)
            overlap = one.conj() @ other.swapaxes(1, 2) / len(place)
            crossed = (overlap * (by_one @ by_other.conj().swapaxes(1, 2))).real
            own = (np.abs(by_one) ** 2).sum(axis=-1)[:, :, np.newaxis]
            own = own + (np.abs(by_other) ** 2).sum(axis=-1)[:, np.newaxis]
            total += (own - 2 * crossed) / np.maximum(1 - np.abs(overlap) ** 2, 1 - _MOST_ALIKE) / len(place)
        return total

    def fit(self, k: FloatArray) -> NDArray[np.complex128]:
        """What each wave adds to each channel, by least squares: (pairs, channels, waves).

        Parameters
        ----------
        k : (pairs, waves, 2) float64
        """
        wave = np.exp(1j * (k @ self.place.T)).swapaxes(1, 2)  # (pairs, channels, waves)
        wave = wave * self.gain[:, np.newaxis]
        by_kind = wave[:, :, np.newaxis] * self.is_kind[:, :, np.newaxis]  # (pairs, channels, kinds, waves)
        gram = np.einsum("pcga,pcgb->pgab", by_kind.conj(), by_kind)
        gram = gram + 1e-9 * np.eye(k.shape[1])
        seen = np.einsum("pcga,c->pga", by_kind.conj(), self.z)
        amplitude = np.linalg.solve(gram, seen[..., np.newaxis])[..., 0]
        return np.asarray(np.einsum("pcga,pga->pca", by_kind, amplitude))

    def likelihood(self, k: FloatArray) -> FloatArray:
        """Logarithm, at the likeliest strays of gain and of phase of each kind: (pairs,)."""
        each = self.fit(k)
        model = each.sum(axis=-1)
        left = self.z - model
        total = np.full(len(k), -np.inf)
        # A gain may be the channel's, for both waves, or each wave's own.
        for waves in (model[..., np.newaxis], each):
            # Strays of gain are along a phasor, strays of phase across it: 2 x 2 matrices of variance.
            size = np.abs(waves) ** 2
            square = waves**2
            along = (size + square.real).sum(axis=-1) / 2  # of the real part
            across = (size - square.real).sum(axis=-1) / 2
            mixed = square.imag.sum(axis=-1) / 2
            one = _GAIN * along + _PHASE * across + self.variance
            other = _GAIN * across + _PHASE * along + self.variance
            both = (_GAIN - _PHASE) * mixed
            volume = np.maximum(one * other - both**2, self.variance**2)  # rounding may take it below
            square = other * left.real**2 + one * left.imag**2 - 2 * both * left.real * left.imag
            # Kinds stray each by its own: a kind that feels little of the ripple strays by more of it.
            by_kind = (np.log(volume) + square / volume) @ self.is_kind  # (strays, pairs, kinds)
            total = np.maximum(total, -0.5 * by_kind.min(axis=0).sum(axis=-1))
        return total

    def alone(self, k: FloatArray) -> float:
        """Likelihood of one wave, whose gains taxels may have, too: one pressed more feels all more.

        Those are as many unknowns more, less one (Schwarz 1978).
        """
        one = k[np.newaxis, np.newaxis]
        likelihood = float(self.likelihood(one)[0])
        taxel = np.unique(self.place, axis=0, return_inverse=True)[1].reshape(-1)
        plain = self.gain
        for _ in range(_GAIN_STEPS):
            model = self.fit(one)[0, :, 0] / self.gain
            seen = np.bincount(taxel, (model.conj() * self.z).real)
            gains = seen / np.maximum(np.bincount(taxel, np.abs(model) ** 2), 1e-300)
            self.gain = np.maximum(gains / max(float(gains.max()), 1e-300), _LEAST_GAIN)[taxel]
        own = float(self.likelihood(one)[0] - taxel.max() / 2 * np.log(2 * len(self.z)))
        self.gain = plain
        return max(likelihood, own)

    def is_one(self, k: FloatArray) -> bool:
        """Whether one wave, alike in all channels of a kind, leaves no more than noise."""
        left = np.abs(self.z - self.fit(k[np.newaxis, np.newaxis])[0, :, 0]) ** 2
        dof = 2 * (len(self.z) - self.is_kind.shape[1] - 1)
        return bool((left / self.variance).sum() < stats.chi2.isf(_FALSE_PAIR, max(dof, 1)))


def find_pairs(
    z: FloatArray,
    variance: FloatArray,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    k: FloatArray,
    along: FloatArray,
) -> list[Pair]:
    """Pairs of waves that explain what one does not, the likeliest first; none where one does.

    Parameters
    ----------
    z : (channels,) complex128
        Phasors of the line.
    variance : (channels,) float64
        Of noise in either part of each.
    k : (2,) float64
        Of the one wave.
    along : (lines,) float64
        What both may have as component along the motion, radians per millimetre.
    """
    phasors = _Phasors(z, variance, layout)
    n_more = 2 * phasors.is_kind.shape[1] + 1  # unknowns of the second wave
    if 2 * len(z) < 2 * (2 * n_more + 1) or phasors.is_one(k):
        return []
    alone = phasors.alone(k)
    alone += n_more / 2 * np.log(2 * len(z))
    if alone > -np.log(phasors.variance).sum():  # nothing left at all would not be likelier
        return []
    heading = motion.heading
    normal = np.array([-heading[1], heading[0]])
    rim_mm = max(float(np.hypot(layout.x_mm, layout.y_mm).max()), 0.5)
    step = _STEP_RAD / rim_mm
    n_across = int(np.ceil(2 * np.pi / params.min_period_mm / step))
    across = np.arange(-n_across, n_across + 1) * step
    starts = [_starts(phasors, forward * heading + across[:, np.newaxis] * normal) for forward in along]
    pairs = np.concatenate(starts)
    if not len(pairs):
        return []
    pairs = _refined(phasors, pairs, step * normal)
    likelihood = phasors.likelihood(pairs)
    if likelihood.max() <= alone:
        return []
    order = np.argsort(-likelihood, kind="stable")
    likelihood = likelihood[order]
    fitted = phasors.fit(pairs[order])
    power = (np.abs(fitted) ** 2).mean(axis=1)
    stronger = np.argsort(-power, axis=1)
    pairs = np.take_along_axis(pairs[order], stronger[..., np.newaxis], axis=1)
    power = np.take_along_axis(power, stronger, axis=1)
    distinct: list[int] = []
    for i, pair in enumerate(pairs):
        if all(np.abs(pair - pairs[j]).max() * rim_mm > _SAME_RAD for j in distinct):
            distinct.append(i)
    odds = np.exp(likelihood[distinct] - likelihood[0])
    odds /= odds.sum() + np.exp(alone - likelihood[0])
    return [
        Pair(pairs[i], power[i] / power[i].sum(), fitted[i, :, stronger[i, 1]], float(weight))
        for i, weight in zip(distinct, odds, strict=True)
    ]


def _starts(phasors: _Phasors, grid: FloatArray) -> FloatArray:
    """Peaks of what pairs on a grid explain by least squares: (pairs, 2, 2).

    The second of a pair may be in step everywhere, too.
    """
    grid = np.concatenate([grid, np.zeros((1, 2))])
    explained = np.zeros((len(grid), len(grid)))
    alike = np.zeros_like(explained)
    for place, z in phasors.groups:
        wave = np.exp(1j * (grid @ place.T))  # (points, channels)
        seen = wave.conj() @ z  # (points, kinds)
        n = wave.shape[1]
        overlap = wave.conj() @ wave.T / n
        common = overlap.real**2 + overlap.imag**2
        own = (np.abs(seen) ** 2).sum(axis=1)
        crossed = (overlap * (seen.conj() @ seen.T)).real
        explained += (own[:, np.newaxis] + own - 2 * crossed) / np.maximum(1 - common, 1 - _MOST_ALIKE) / n
        alike = np.maximum(alike, common)
    explained[alike > _MOST_ALIKE] = 0.0
    explained[np.tril_indices(len(grid))] = 0.0
    highest = np.empty_like(explained)
    highest[:, :-1] = ndimage.maximum_filter(explained[:, :-1], size=3)
    highest[:, -1] = ndimage.maximum_filter(explained[:, -1], size=3)
    first, second = np.nonzero((explained == highest) & (explained > 0))
    top = np.argsort(-explained[first, second], kind="stable")[:_TOP]
    return np.stack([grid[first[top]], grid[second[top]]], axis=1)


def _refined(phasors: _Phasors, pairs: FloatArray, step: FloatArray) -> FloatArray:
    """What explains most next to pairs, the likeliest few of them; by least squares, which costs little.

    Parameters
    ----------
    step : (2,) float64
        From one point of the grid to the next.
    """
    moves = np.arange(-2, 3)[:, np.newaxis] / 4
    for most in _KEPT:
        free = (np.abs(pairs).sum(axis=2) > 0).astype(np.float64)[..., np.newaxis, np.newaxis]
        near = pairs[:, :, np.newaxis] + moves * step * free  # (pairs, 2, moves, 2)
        explained = phasors.explained(near[:, 0], near[:, 1]).reshape(len(pairs), -1)
        first, second = np.divmod(explained.argmax(axis=1), len(moves))
        each = np.arange(len(pairs))
        pairs = np.stack([near[each, 0, first], near[each, 1, second]], axis=1)
        pairs = pairs[np.argsort(-explained.max(axis=1), kind="stable")[:most]]
        step = step / 4
    return pairs

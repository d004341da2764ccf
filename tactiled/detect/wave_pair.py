"""Whether two waves share one frequency: crossed grooves, a knurl, or a vibration at the ripple's frequency.

Amplitudes are each channel's own, so the sum of two waves may pass for one between them whose channels differ
in gain, and phase a little. But then gains and phases are no accident: a second wave with the same motion
explains them. Both readings are given gains and phases that stray around one complex amplitude for each kind
of channel; their likelihoods say which it is (with the penalty of Schwarz 1978 for the second wave's
unknowns).
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.wave_model import Layout, WaveMotion, WaveParams

_STEP_RAD = 0.5  # of phase at the rim of the array, from one point of the grid to the next
_REFINEMENTS = 3  # each of them to a quarter of the step before
_MOST_STARTS = 4  # are refined
_COARSE = 8.0  # of the log-likelihood: so much is lost by the grid, at the most
_TOP = 60  # pairs of grid points that are looked at more closely
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
    power : (2,) float64
        Mean squares of their amplitudes.
    """

    k: FloatArray
    power: FloatArray


class _Phasors:
    """Likelihoods of waves for the phasors of one line."""

    def __init__(self, z: FloatArray, variance: FloatArray, layout: Layout) -> None:
        self.z, self.variance = z, variance + (_LEAST_STRAY * np.abs(z)) ** 2
        self.place = np.stack([layout.x_mm, layout.y_mm], axis=1)
        self.is_kind = (layout.kind[:, np.newaxis] == np.unique(layout.kind)).astype(np.float64)

    def kinds_by_place(self) -> list[list[int]]:
        """Kinds whose channels are at the same places, together."""
        together: dict[bytes, list[int]] = {}
        for kind, mine in enumerate(self.is_kind.T.astype(bool)):
            together.setdefault(self.place[mine].tobytes(), []).append(kind)
        return [*together.values()]

    def fit(self, k: FloatArray) -> FloatArray:
        """What each wave adds to each channel, by least squares: (pairs, channels, waves).

        Parameters
        ----------
        k : (pairs, waves, 2) float64
        """
        wave = np.exp(1j * (k @ self.place.T)).swapaxes(1, 2)  # (pairs, channels, waves)
        by_kind = wave[:, :, np.newaxis] * self.is_kind[:, :, np.newaxis]  # (pairs, channels, kinds, waves)
        gram = np.einsum("pcga,pcgb->pgab", by_kind.conj(), by_kind)
        gram = gram + 1e-9 * np.eye(k.shape[1])
        seen = np.einsum("pcga,c->pga", by_kind.conj(), self.z)
        amplitude = np.linalg.solve(gram, seen[..., np.newaxis])[..., 0]
        return np.asarray(np.einsum("pcga,pga->pca", by_kind, amplitude))

    def likelihood(self, k: FloatArray) -> FloatArray:
        """Logarithm, at the likeliest strays of gain and of phase: (pairs,)."""
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
            total = np.maximum(total, -0.5 * (np.log(volume) + square / volume).sum(axis=-1).min(axis=0))
        return total


def find_pair(
    z: FloatArray,
    variance: FloatArray,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    k: FloatArray,
    along: FloatArray,
) -> Pair | None:
    """Two waves that explain what one does not.

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
    alone = float(phasors.likelihood(k[np.newaxis, np.newaxis])[0])
    heading = motion.heading
    normal = np.array([-heading[1], heading[0]])
    step = _STEP_RAD / max(float(np.hypot(layout.x_mm, layout.y_mm).max()), 0.5)
    n_across = int(np.ceil(2 * np.pi / params.min_period_mm / step))
    across = np.arange(-n_across, n_across + 1) * step
    n_more = 2 * phasors.is_kind.shape[1] + 1  # unknowns of the second wave
    if 2 * len(z) < 2 * (2 * n_more + 1):
        return None
    best, most = None, alone + n_more / 2 * np.log(2 * len(z))
    for forward in along:
        grid = np.concatenate([forward * heading + across[:, np.newaxis] * normal, np.zeros((1, 2))])
        starts = _starts(phasors, grid)
        likelihood = phasors.likelihood(starts)
        for start in np.argsort(-likelihood, kind="stable")[:_MOST_STARTS]:
            if likelihood[start] > most - _COARSE:
                pair, refined = _refined(phasors, starts[start], normal, step)
                if refined > most:
                    best, most = pair, refined
    if best is None:
        return None
    power = (np.abs(phasors.fit(best[np.newaxis])[0]) ** 2).mean(axis=0)
    order = np.argsort(-power)
    return Pair(best[order], power[order])


def _starts(phasors: _Phasors, grid: FloatArray) -> FloatArray:
    """The pairs of a grid's points that explain most by least squares: (pairs, 2, 2)."""
    explained = np.zeros((len(grid), len(grid)))
    alike = np.zeros_like(explained)
    for kinds in phasors.kinds_by_place():
        mine = phasors.is_kind[:, kinds].astype(bool)
        wave = np.exp(1j * (grid @ phasors.place[mine[:, 0]].T))  # (points, channels)
        seen = np.stack([wave.conj() @ phasors.z[each] for each in mine.T], axis=1)  # (points, kinds)
        n = wave.shape[1]
        overlap = wave.conj() @ wave.T / n
        common = overlap.real**2 + overlap.imag**2
        own = (np.abs(seen) ** 2).sum(axis=1)
        crossed = (overlap * (seen.conj() @ seen.T)).real
        explained += (own[:, np.newaxis] + own - 2 * crossed) / np.maximum(1 - common, 1 - _MOST_ALIKE) / n
        alike = np.maximum(alike, common)
    explained[alike > _MOST_ALIKE] = 0.0
    explained[np.tril_indices(len(grid))] = 0.0
    top = np.argpartition(explained.ravel(), -_TOP)[-_TOP:]
    first, second = np.unravel_index(np.sort(top), explained.shape)
    return np.stack([grid[first], grid[second]], axis=1)


def _refined(
    phasors: _Phasors, pair: FloatArray, normal: FloatArray, step: float
) -> tuple[FloatArray, float]:
    """The likeliest pair next to one."""
    moves = np.stack(np.meshgrid(*[np.arange(-2, 3) / 4] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    most = -np.inf
    for _ in range(_REFINEMENTS):
        free = (np.abs(pair).sum(axis=1) > 0).astype(np.float64)
        near = pair + step * (moves * free)[..., np.newaxis] * normal
        likelihood = phasors.likelihood(near)
        pair, most = near[int(likelihood.argmax())], float(likelihood.max())
        step /= 4
    return pair, most

"""Likelihood of waves given the phasors of one line, with gain and phase mismatch between channels.

Gains and phases of channels scatter around one complex amplitude for each kind of channel, with variances
that suit the kind. Alternatively they scatter together: the response of a channel to a ripple depends on the
load of its taxel, which is common to all channels of the taxel.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout
from tactiled.detect.worker import pause

# choice: points of a square grid, two steps either way: (25, 2).
NEIGHBOURS = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
# choice: grid steps in phase at the edge of the array.
_NEARBY_RAD = (0.2, 0.08, 0.03)
# choice: steps of expectation and maximisation.
_FACTOR_STEPS = 6
# choice: probability that one wave on equal channels is tested for a second one.
_FALSE_SECOND_WAVE = 1e-2
# prior: mismatch as a part of the ripple, all kinds together: no skin's channels are more alike. Where a kind
# has a small response because its parts cancel, the mismatch does not cancel.
_LEAST_MISMATCH = 0.03
# choice: variances of mismatch that are tried.
_MISMATCHES = np.array([0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0]) ** 2


class Phasors:
    """Phasors (channels,) of one line, and the likelihood of waves given them.

    The variance (channels,) is that of noise in the real and in the imaginary part of each.
    """

    def __init__(self, z: NDArray[np.complex128], variance: FloatArray, layout: ChannelLayout) -> None:
        self.z = z
        self.variance = variance + _LEAST_MISMATCH**2 * float((np.abs(z) ** 2).mean())
        self.place = layout.xy_mm
        self.is_kind = layout.is_kind
        self._radius_mm = layout.radius_mm

        together: dict[bytes, list[NDArray[np.bool_]]] = {}
        for mine in self.is_kind.T.astype(bool):
            together.setdefault(self.place[mine].tobytes(), []).append(mine)
        # Positions, and the phasors of all kinds whose channels share these positions.
        self.groups = [
            (self.place[kinds[0]], np.stack([z[mine] for mine in kinds], axis=1))
            for kinds in together.values()
        ]
        self._together = list(together.values())

    def fit(self, k: FloatArray) -> NDArray[np.complex128]:
        """Least-squares contribution (pairs, channels, waves) of waves (pairs, waves, 2) to each channel."""
        wave = np.exp(1j * (k @ self.place.T)).swapaxes(1, 2)  # (pairs, channels, waves)
        by_kind = wave[:, :, np.newaxis] * self.is_kind[:, :, np.newaxis]  # (pairs, channels, kinds, waves)
        gram = np.einsum("pcga,pcgb->pgab", by_kind.conj(), by_kind)
        gram = gram + 1e-9 * np.eye(k.shape[1])
        seen = np.einsum("pcga,c->pga", by_kind.conj(), self.z)
        amplitude = np.linalg.solve(gram, seen[..., np.newaxis])[..., 0]
        return np.asarray(np.einsum("pcga,pga->pca", by_kind, amplitude))

    def likelihood(self, k: FloatArray) -> FloatArray:
        """Log-likelihood at the likeliest mismatch: (pairs,), for wave vectors (pairs, waves, 2)."""
        each = self.fit(k)
        size, beside = self._compare(each)
        return np.maximum(self._by_channel_gain(size, beside), self._by_taxel_factor(beside))

    def by_mismatch(self, k: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log-likelihoods near single waves (waves, 2) under mismatch of each channel, and of taxel loads."""
        found = []
        for by_load in (False, True):
            at, likelihood = k, np.zeros(len(k))
            for step_rad in _NEARBY_RAD:
                near = at[:, np.newaxis] + NEIGHBOURS * step_rad / self._radius_mm
                size, beside = self._compare(self.fit(near.reshape(-1, 1, 2)))
                each = self._by_taxel_factor(beside) if by_load else self._by_channel_gain(size, beside)
                each = each.reshape(len(k), -1)
                at = near[np.arange(len(k)), each.argmax(axis=1)]
                likelihood = each.max(axis=1)
            found.append(likelihood)
        return found[0], found[1]

    def _compare(self, each: NDArray[np.complex128]) -> tuple[FloatArray, NDArray[np.complex128]]:
        """Squares of a model (pairs, channels, waves), and its residual, turned by the model's phase.

        Gain mismatch is parallel to a phasor, phase mismatch perpendicular.
        """
        model = each.sum(axis=-1)
        left = self.z - model
        return np.abs(model) ** 2, left * np.exp(-1j * np.angle(model))

    def _by_channel_gain(self, size: FloatArray, left: NDArray[np.complex128]) -> FloatArray:
        """Log-likelihood where one gain of each channel applies to all waves: (pairs,)."""
        variance = _MISMATCHES[:, np.newaxis, np.newaxis] * size + self.variance
        log = np.log(variance)
        total = np.zeros(len(size))
        for part in (left.real, left.imag):
            pause()
            by_kind = (log + part**2 / variance) @ self.is_kind  # (mismatches, pairs, kinds)
            total -= 0.5 * by_kind.min(axis=0).sum(axis=-1)
        return total

    def _by_taxel_factor(self, left: NDArray[np.complex128]) -> FloatArray:
        """Log-likelihood where one factor per taxel, its load, affects all its channels: (pairs,).

        Factor analysis with one factor (Rubin, Thayer 1982): each kind follows the factor with its own
        complex loading and has its own residual variance. The extra unknown of each kind is penalised
        (Schwarz 1978).
        """
        total = np.full(len(left), -self.is_kind.shape[1] / 2 * np.log(2 * len(self.z)))
        for mine in self._together:
            pause()
            z = np.stack([left[:, kind] for kind in mine], axis=-1)  # (pairs, taxels, kinds)
            n_kinds = z.shape[-1]
            u = np.concatenate([z.real, z.imag], axis=-1)
            least = np.tile([self.variance[kind].mean() for kind in mine], 2)
            white = u / np.sqrt(least)
            value, vector = np.linalg.eigh(white.swapaxes(1, 2) @ white / z.shape[1])
            load = vector[..., -1] * np.sqrt(np.maximum(value[:, -1:] - 1, 0) * least)  # (pairs, parts)
            rest = np.broadcast_to(least, load.shape)
            for _ in range(_FACTOR_STEPS):
                pause()
                weighed = load / rest
                spread = 1 / (1 + (weighed * load).sum(axis=-1))
                factor = spread[:, np.newaxis] * (u @ weighed[..., np.newaxis])[..., 0]  # (pairs, taxels)
                size = (factor**2).sum(axis=-1) + z.shape[1] * spread
                both = (u * factor[..., np.newaxis]).sum(axis=1)
                load = both / size[:, np.newaxis]
                rest = ((u**2).sum(axis=1) - load * both) / z.shape[1]
                rest = np.tile((rest[:, :n_kinds] + rest[:, n_kinds:]) / 2, 2)
                rest = np.maximum(rest, least)
            weighed = load / rest
            more = 1 + (weighed * load).sum(axis=-1)
            seen = (u @ weighed[..., np.newaxis])[..., 0]
            square = (u**2 / rest[:, np.newaxis]).sum(axis=(1, 2)) - (seen**2).sum(axis=1) / more
            total -= 0.5 * (z.shape[1] * (np.log(rest).sum(axis=-1) + np.log(more)) + square)
        return total

    def is_single_wave(self, k: FloatArray) -> bool:
        """True where one wave with equal channels of each kind leaves no more than noise."""
        left = np.abs(self.z - self.fit(k[np.newaxis, np.newaxis])[0, :, 0]) ** 2
        dof = 2 * (len(self.z) - self.is_kind.shape[1] - 1)
        return bool((left / self.variance).sum() < special.chdtri(max(dof, 1), _FALSE_SECOND_WAVE))

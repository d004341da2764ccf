"""The model of a plane wave near a point: what each channel says of a small change.

From a window's tables; amplitudes are solved for, channel by channel, and taken out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Tables


@dataclass(frozen=True, eq=False)
class Waves:
    """Fits from several starts.

    Attributes
    ----------
    k : (starts, 2) float64
        Wave vectors, radians per millimetre.
    turn : (starts,) float64
        Phase of the fundamental for 1 of the window's way.
    gain : (starts,) float64
        Twice the log-likelihood ratio over no wave at all.
    covariance : (starts, 3, 3) float64
        Of wave vector and turn.
    phase : (starts, kinds, harmonics) float64
    """

    k: FloatArray
    turn: FloatArray
    gain: FloatArray
    covariance: FloatArray
    phase: FloatArray

    def __getitem__(self, chosen: int | NDArray[np.int64]) -> "Waves":
        index = np.atleast_1d(np.asarray(chosen, dtype=np.int64))
        return Waves(
            self.k[index], self.turn[index], self.gain[index], self.covariance[index], self.phase[index]
        )


@dataclass(frozen=True, eq=False)
class Linear:
    """Unknowns: kx, ky, the turn in units of its slack, then the phases of the channel's kind.

    Attributes
    ----------
    gain : (starts,) float64
        Twice the log-likelihood ratio over no wave at all.
    push : (starts, channels, unknowns) float64
        Gradient of the log-likelihood.
    information : (starts, channels, unknowns, unknowns) float64
    expected : (starts, channels, functions) float64
        The tables' products if there were no noise.
    """

    gain: FloatArray
    push: FloatArray
    information: FloatArray
    expected: FloatArray


@dataclass(frozen=True, eq=False)
class Geometry:
    """How each channel's phase depends on the unknowns.

    Attributes
    ----------
    place : (channels, 2) float64
    lag : (channels,) float64
    is_kind : (channels, kinds) float64
        1 where the channel is of the kind.
    weight : (channels,) float64
        One over the variance of its noise.
    tie : (2,) float64
        Turn for each unit of the wave vector, where the motion is known.
    """

    place: FloatArray
    lag: FloatArray
    is_kind: FloatArray
    weight: FloatArray
    tie: FloatArray


def linearise(geometry: Geometry, tables: Tables, waves: Waves, slack: FloatArray) -> Linear:
    """The model near waves; products of the tables may differ from wave to wave, along a first axis."""
    place, lag, is_kind, weight, tie = (
        geometry.place,
        geometry.lag,
        geometry.is_kind,
        geometry.weight,
        geometry.tie,
    )
    n_starts, n_harmonics = len(waves.k), tables.n_harmonics
    n_channels = len(is_kind)
    gram, product = tables.gram, tables.product
    times = np.arange(1, n_harmonics + 1)
    psi = waves.k @ place.T + waves.turn[:, np.newaxis] * lag
    own = np.einsum("sgh,cg->sch", waves.phase, is_kind)
    alpha = psi[..., np.newaxis] * times + own
    ahead = (waves.turn - tables.turn)[:, np.newaxis, np.newaxis]
    cos, sin = np.cos(alpha), np.sin(alpha)
    # Columns on the tables' functions (starts, channels, functions, harmonics).
    columns = np.zeros((n_starts, n_channels, 4 * n_harmonics, n_harmonics))
    slopes = np.zeros_like(columns)  # by the phase of the harmonic
    late = np.zeros_like(columns)  # by the turn, through the way alone
    for h in range(n_harmonics):
        here, there = 2 * h, 2 * (n_harmonics + h)
        shift = ahead[..., 0] * (h + 1)
        columns[:, :, here, h], columns[:, :, here + 1, h] = cos[..., h], -sin[..., h]
        columns[:, :, there, h] = -shift * sin[..., h]
        columns[:, :, there + 1, h] = -shift * cos[..., h]
        slopes[:, :, here, h], slopes[:, :, here + 1, h] = -sin[..., h], -cos[..., h]
        slopes[:, :, there, h] = -shift * cos[..., h]
        slopes[:, :, there + 1, h] = shift * sin[..., h]
        late[:, :, there, h] = -(h + 1) * sin[..., h]
        late[:, :, there + 1, h] = -(h + 1) * cos[..., h]
    gram_columns = gram @ columns
    inner = columns.swapaxes(-1, -2) @ gram_columns
    seen = (columns.swapaxes(-1, -2) @ product[..., np.newaxis])[..., 0]
    amplitude = np.maximum(np.linalg.solve(inner, seen[..., np.newaxis])[..., 0], 0.0)
    model = (columns @ amplitude[..., np.newaxis])[..., 0]
    rest = product - (gram @ model[..., np.newaxis])[..., 0]
    gain = (((product + rest) * model).sum(axis=-1) * weight).sum(axis=-1)
    by_phase = slopes * amplitude[:, :, np.newaxis]
    by_psi = (by_phase * times).sum(axis=-1, keepdims=True)
    by_turn = (late * amplitude[:, :, np.newaxis]).sum(axis=-1, keepdims=True)
    by_turn = by_turn + by_psi * lag[:, np.newaxis, np.newaxis]
    by_k = by_psi * place[:, np.newaxis] + by_turn * tie
    by_slack = by_turn * slack[:, np.newaxis, np.newaxis, np.newaxis]
    by = np.concatenate([by_k, by_slack, by_phase], axis=-1)
    gram_by = gram @ by
    coupling = columns.swapaxes(-1, -2) @ gram_by
    information = by.swapaxes(-1, -2) @ gram_by
    information -= coupling.swapaxes(-1, -2) @ np.linalg.solve(inner, coupling)
    information *= weight[:, np.newaxis, np.newaxis]
    push = (by.swapaxes(-1, -2) @ rest[..., np.newaxis])[..., 0] * weight[:, np.newaxis]
    return Linear(gain, push, information, product - rest)


def spread(information: FloatArray, push: FloatArray, is_kind: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information and gradient summed over channels, with each kind's phases in its own rows."""
    n_starts = len(information)
    n_phases = is_kind.shape[1] * (information.shape[-1] - 3)
    shared = information[..., :3, :3].sum(axis=1)
    crossed = np.einsum("scih,cg->sigh", information[..., :3, 3:], is_kind).reshape(n_starts, 3, n_phases)
    each = np.einsum("schj,cg->sghj", information[..., 3:, 3:], is_kind)
    n_harmonics = each.shape[-1]
    own = np.zeros((n_starts, n_phases, n_phases))
    for g in range(is_kind.shape[1]):
        rows = slice(g * n_harmonics, (g + 1) * n_harmonics)
        own[:, rows, rows] = each[:, g]
    normal = np.concatenate(
        [
            np.concatenate([shared, crossed], axis=2),
            np.concatenate([crossed.swapaxes(1, 2), own], axis=2),
        ],
        axis=1,
    )
    phases = np.einsum("sch,cg->sgh", push[..., 3:], is_kind).reshape(n_starts, n_phases)
    return normal, np.concatenate([push[..., :3].sum(axis=1), phases], axis=1)

"""The model of a plane wave near a point: what each channel says of a small change.

From a window's tables; amplitudes are solved for, channel by channel, and taken out. Starts and channels are
the last axes of what is computed for each of them, so that small matrices are worked on side by side.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables


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
    """What channels say of their own phases, harmonic by harmonic, and last of the turn through the way.

    Attributes
    ----------
    gain : (starts, channels) float64
        Twice the log-likelihood ratio over no wave at all.
    push : (harmonics + 1, starts, channels) float64
        Gradient of the log-likelihood.
    information : (harmonics + 1, harmonics + 1, starts, channels) float64
    """

    gain: FloatArray
    push: FloatArray
    information: FloatArray

    def strayed(self, stray: FloatArray) -> "Linear":
        """The same where phases may stray: those of a channel by a variance of its own, radians^2.

        Strays are Gaussian unknowns, integrated out (Woodbury, in the form that is right for none, too).

        Parameters
        ----------
        stray : (harmonics, channels) float64
        """
        n = len(stray)
        sd = np.sqrt(stray)[:, np.newaxis]
        both = np.zeros((2 * n + 2, 2 * n + 2, *self.gain.shape))
        both[n:-1, n:-1] = self.information
        both[n:-1, -1] = both[-1, n:-1] = self.push
        both[:n, n:] = sd[:, np.newaxis] * both[n:-2, n:]
        both[n:, :n] = both[:n, n:].swapaxes(0, 1)
        both[:n, :n] = both[:n, n:-2] * sd
        both[range(n), range(n)] += 1.0
        left = swept(both, n)
        return Linear(self.gain - left[-1, -1], left[n:-1, -1], left[n:-1, n:-1])


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

    def psi(self, k: FloatArray, turn: FloatArray) -> FloatArray:
        """Phase of waves at each channel: (starts, channels)."""
        return np.asarray(k @ self.place.T + turn[:, np.newaxis] * self.lag)


def swept(square: FloatArray, n: int) -> FloatArray:
    """Symmetric matrices with their first n unknowns solved for (the sweep operator: Goodnight 1979).

    Of [[A, B], [B', C]] it makes [[1/A, 1/A B], [-B' 1/A, C - B' 1/A B]]; A positive definite.

    Parameters
    ----------
    square : (unknowns, unknowns, ...) float64
    """
    square = square.copy()
    for i in range(n):
        pivot = 1.0 / square[i, i]
        row = square[i] * pivot
        column = square[:, i].copy()
        square -= column[:, np.newaxis] * row
        square[i] = row
        square[:, i] = -column * pivot
        square[i, i] = pivot
    return square


def _directions(geometry: Geometry, tables: Tables, waves: Waves) -> FloatArray:
    """Unit harmonics on the tables' functions; how they change by phase, and by the turn through the way.

    (3 harmonics, functions, starts, channels)
    """
    n_harmonics = tables.n_harmonics
    psi = geometry.psi(waves.k, waves.turn)
    own = waves.phase.transpose(2, 0, 1) @ geometry.is_kind.T
    ahead = waves.turn - tables.turn
    # (what, its harmonic, plain or times the way, harmonic, cosine or sine, starts, channels)
    on = np.zeros((3, n_harmonics, 2, n_harmonics, 2, *psi.shape))
    for h in range(n_harmonics):
        times = h + 1.0
        alpha = times * psi + own[h]
        here = np.array([np.cos(alpha), -np.sin(alpha)])
        quarter = np.array([here[1], -here[0]])
        shift = (times * ahead)[:, np.newaxis]
        on[0, h, 0, h], on[0, h, 1, h] = here, shift * quarter
        on[1, h, 0, h], on[1, h, 1, h] = quarter, -shift * here
        on[2, h, 1, h] = times * quarter
    return on.reshape(3 * n_harmonics, 4 * n_harmonics, *psi.shape)


def linearise(geometry: Geometry, tables: Tables, waves: Waves, product: FloatArray) -> Linear:
    """The model near waves.

    Parameters
    ----------
    product : (samples, channels, functions) float64
        What to go by instead of the tables' own; samples and waves are of one number, or one of either.
    """
    m = tables.n_harmonics
    on = _directions(geometry, tables, waves)
    square = np.einsum("ifsc,jfsc->ijsc", on, tables.times_gram(on))
    seen = np.einsum("ifsc,scf->isc", on, product)
    left = swept(square, m)
    amplitude = np.maximum(np.einsum("ijsc,jsc->isc", left[:m, :m], seen[:m]), 0.0)
    explained = np.einsum("ijsc,jsc->isc", square[:, :m], amplitude)
    gain = (amplitude * (2 * seen[:m] - explained[:m])).sum(axis=0) * geometry.weight
    by = (seen - explained)[m:].reshape(2, m, *amplitude.shape[1:]) * amplitude
    push = np.concatenate([by[0], by[1].sum(axis=0, keepdims=True)]) * geometry.weight
    rest = left[m:, m:].reshape(2, m, 2, m, *left.shape[2:])
    rest = rest * amplitude[:, np.newaxis, np.newaxis] * amplitude * geometry.weight
    information = np.empty((m + 1, m + 1, *amplitude.shape[1:]))
    information[:m, :m] = rest[0, :, 0]
    information[:m, m] = information[m, :m] = rest[0, :, 1].sum(axis=1)
    information[m, m] = rest[1, :, 1].sum(axis=(0, 1))
    return Linear(gain, push, information)


def expected(geometry: Geometry, tables: Tables, waves: Waves) -> FloatArray:
    """The tables' products if there were waves and no noise: (starts, channels, functions)."""
    m = tables.n_harmonics
    on = _directions(geometry, tables, waves)[:m]
    seen = tables.times_gram(on)
    inner = np.einsum("ifsc,jfsc->ijsc", on, seen)
    own = np.einsum("ifsc,cf->isc", on, tables.product)
    amplitude = np.maximum(np.einsum("ijsc,jsc->isc", swept(inner, m), own), 0.0)
    return np.asarray(np.einsum("ifsc,isc->scf", seen, amplitude))


def spread(geometry: Geometry, near: Linear, slack: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information (starts, unknowns, unknowns) and gradient (starts, unknowns) of all channels together.

    Unknowns: kx, ky, the turn in units of its slack, then kind by kind the phases of the harmonics.
    """
    n_harmonics, is_kind = len(near.push) - 1, geometry.is_kind
    n_starts, n_phases = near.push.shape[1], n_harmonics * is_kind.shape[1]
    times = np.arange(1.0, n_harmonics + 1)
    # From phases, and the turn through the way, to psi and the latter.
    both = np.zeros((2, n_harmonics + 1))
    both[0, :-1], both[1, -1] = times, 1.0
    half = np.einsum("ai,ijsc->ajsc", both, near.information)
    among = np.einsum("ajsc,bj->absc", half, both)
    pull = np.einsum("ai,isc->asc", both, near.push)
    # How psi, and the turn through the way, change by wave vector and slack: (3, 2, starts, channels).
    by = np.zeros((3, 2, n_starts, len(is_kind)))
    by[:2, 0] = (geometry.place + geometry.lag[:, np.newaxis] * geometry.tie).T[:, np.newaxis]
    by[:2, 1] = geometry.tie[:, np.newaxis, np.newaxis]
    by[2, 0] = slack[:, np.newaxis] * geometry.lag
    by[2, 1] = slack[:, np.newaxis]
    normal = np.zeros((n_starts, 3 + n_phases, 3 + n_phases))
    normal[:, :3, :3] = np.einsum("iasc,jasc->sij", by, np.einsum("jbsc,absc->jasc", by, among))
    crossed = np.einsum("iasc,ahsc->ihsc", by, half[:, :-1]) @ is_kind  # (3, harmonics, starts, kinds)
    crossed = crossed.transpose(2, 0, 3, 1).reshape(n_starts, 3, n_phases)
    normal[:, :3, 3:], normal[:, 3:, :3] = crossed, crossed.swapaxes(1, 2)
    own = (near.information[:-1, :-1] @ is_kind).transpose(2, 3, 0, 1)  # starts and kinds first
    for g in range(is_kind.shape[1]):
        rows = slice(3 + g * n_harmonics, 3 + (g + 1) * n_harmonics)
        normal[:, rows, rows] = own[:, g]
    phases = (near.push[:-1] @ is_kind).transpose(1, 2, 0).reshape(n_starts, n_phases)
    return normal, np.concatenate([np.einsum("iasc,asc->si", by, pull), phases], axis=1)

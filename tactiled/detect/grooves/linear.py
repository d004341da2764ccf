"""Linearise the plane-wave model near a wave: likelihood, gradient and information of each channel.

Computed from the normal equations of a window. The amplitudes are solved for in each channel and eliminated.
Starts and channels are the last axes of whatever is computed for each of them, so that small matrices are
handled together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations
from tactiled.detect.worker import pause


@dataclass(frozen=True, eq=False)
class PlaneWaves:
    """Fitted waves, one for each start."""

    k: FloatArray  # (starts, 2): wave vectors, radians per millimetre
    phase_rate: FloatArray  # (starts,): phase of the fundamental per unit of the window's scaled travel
    gain: FloatArray  # (starts,): twice the log-likelihood ratio over no wave
    covariance: FloatArray  # (starts, 3, 3): of wave vector and phase rate
    phase: FloatArray  # (starts, kinds, harmonics)

    def __getitem__(self, chosen: int | NDArray[np.int64]) -> "PlaneWaves":
        index = np.atleast_1d(np.asarray(chosen, dtype=np.int64))
        return PlaneWaves(
            self.k[index], self.phase_rate[index], self.gain[index], self.covariance[index], self.phase[index]
        )


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Likelihood near a wave as a function of each channel's phases.

    The unknowns are the phase of each harmonic and, last, the phase rate where it acts through the travel.
    """

    gain: FloatArray  # (starts, channels): twice the log-likelihood ratio over no wave
    gradient: FloatArray  # (harmonics + 1, starts, channels): of the log-likelihood
    information: FloatArray  # (harmonics + 1, harmonics + 1, starts, channels)

    def with_mismatch(self, mismatch: FloatArray) -> "Linearisation":
        """The linearisation where each channel's phases have a Gaussian mismatch, integrated out.

        Woodbury's identity, in a form that also holds for a variance of zero.

        Parameters
        ----------
        mismatch : (harmonics, channels) float64
            Variance, radians^2.
        """
        n = len(mismatch)
        sd = np.sqrt(mismatch)[:, np.newaxis]
        both = np.zeros((2 * n + 2, 2 * n + 2, *self.gain.shape))
        both[n:-1, n:-1] = self.information
        both[n:-1, -1] = both[-1, n:-1] = self.gradient
        both[:n, n:] = sd[:, np.newaxis] * both[n:-2, n:]
        both[n:, :n] = both[:n, n:].swapaxes(0, 1)
        both[:n, :n] = both[:n, n:-2] * sd
        both[range(n), range(n)] += 1.0
        left = sweep(both, n)
        return Linearisation(self.gain - left[-1, -1], left[n:-1, -1], left[n:-1, n:-1])


def sweep(square: FloatArray, n: int) -> FloatArray:
    """Eliminate the first n unknowns of symmetric matrices (sweep operator: Goodnight 1979).

    [[A, B], [B', C]] becomes [[1/A, 1/A B], [-B' 1/A, C - B' 1/A B]]; A must be positive definite.

    Parameters
    ----------
    square : (unknowns, unknowns, ...) float64
    """
    square = square.copy()
    for i in range(n):
        pause()
        pivot = 1.0 / square[i, i]
        row = square[i] * pivot
        column = square[:, i].copy()
        square -= column[:, np.newaxis] * row
        square[i] = row
        square[:, i] = -column * pivot
        square[i, i] = pivot
    return square


def _directions(equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
    """Unit harmonics in terms of the functions, and their derivatives by phase and by phase rate.

    Returns
    -------
    (3 harmonics, functions, starts, channels) float64
    """
    n_harmonics = equations.n_harmonics
    psi = equations.window.psi(waves.k, waves.phase_rate)
    own = waves.phase.transpose(2, 0, 1) @ equations.window.layout.is_kind.T
    ahead = waves.phase_rate - equations.phase_rate
    # Axes: value or derivative, its harmonic, plain or times travel, harmonic, cosine or sine, starts,
    # channels.
    on = np.zeros((3, n_harmonics, 2, n_harmonics, 2, *psi.shape))
    for h in range(n_harmonics):
        pause()
        times = h + 1.0
        alpha = times * psi + own[h]
        here = np.array([np.cos(alpha), -np.sin(alpha)])
        quarter = np.array([here[1], -here[0]])
        shift = (times * ahead)[:, np.newaxis]
        on[0, h, 0, h], on[0, h, 1, h] = here, shift * quarter
        on[1, h, 0, h], on[1, h, 1, h] = quarter, -shift * here
        on[2, h, 1, h] = times * quarter
    return on.reshape(3 * n_harmonics, 4 * n_harmonics, *psi.shape)


def linearise(
    equations: NormalEquations, weight: FloatArray, waves: PlaneWaves, product: FloatArray
) -> Linearisation:
    """Linearise the model near waves.

    Parameters
    ----------
    weight : (channels,) float64
        Inverse variance of the noise.
    product : (samples, channels, functions) float64
        Used instead of the product of `equations`. Samples and waves are equal in number, or one of either.
    """
    m = equations.n_harmonics
    on = _directions(equations, waves)
    square = np.einsum("ifsc,jfsc->ijsc", on, equations.times_gram(on))
    seen = np.einsum("ifsc,scf->isc", on, product)
    left = sweep(square, m)
    amplitude = np.maximum(np.einsum("ijsc,jsc->isc", left[:m, :m], seen[:m]), 0.0)
    explained = np.einsum("ijsc,jsc->isc", square[:, :m], amplitude)
    gain = (amplitude * (2 * seen[:m] - explained[:m])).sum(axis=0) * weight
    by = (seen - explained)[m:].reshape(2, m, *amplitude.shape[1:]) * amplitude
    gradient = np.concatenate([by[0], by[1].sum(axis=0, keepdims=True)]) * weight
    rest = left[m:, m:].reshape(2, m, 2, m, *left.shape[2:])
    rest = rest * amplitude[:, np.newaxis, np.newaxis] * amplitude * weight
    information = np.empty((m + 1, m + 1, *amplitude.shape[1:]))
    information[:m, :m] = rest[0, :, 0]
    information[:m, m] = information[m, :m] = rest[0, :, 1].sum(axis=1)
    information[m, m] = rest[1, :, 1].sum(axis=(0, 1))
    return Linearisation(gain, gradient, information)


def expected_products(equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
    """Products that waves without noise would have: (starts, channels, functions)."""
    m = equations.n_harmonics
    on = _directions(equations, waves)[:m]
    seen = equations.times_gram(on)
    inner = np.einsum("ifsc,jfsc->ijsc", on, seen)
    own = np.einsum("ifsc,cf->isc", on, equations.product)
    amplitude = np.maximum(np.einsum("ijsc,jsc->isc", sweep(inner, m), own), 0.0)
    return np.asarray(np.einsum("ifsc,isc->scf", seen, amplitude))


def total_information(
    window: DetrendedWindow, near: Linearisation, slack: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information (starts, unknowns, unknowns) and gradient (starts, unknowns) of all channels together.

    Unknowns: kx, ky, the phase rate in units of its slack, then the phases of the harmonics, kind by kind.
    """
    n_harmonics, is_kind, tie = len(near.gradient) - 1, window.layout.is_kind, window.tie
    n_starts, n_phases = near.gradient.shape[1], n_harmonics * is_kind.shape[1]
    times = np.arange(1.0, n_harmonics + 1)
    # From phases, and the phase rate through the travel, to psi and the latter.
    both = np.zeros((2, n_harmonics + 1))
    both[0, :-1], both[1, -1] = times, 1.0
    half = np.einsum("ai,ijsc->ajsc", both, near.information)
    among = np.einsum("ajsc,bj->absc", half, both)
    pull = np.einsum("ai,isc->asc", both, near.gradient)
    # Derivative of psi, and of the phase rate through the travel, by wave vector and slack: (3, 2, starts,
    # channels).
    by = np.zeros((3, 2, n_starts, len(is_kind)))
    by[:2, 0] = (window.layout.xy_mm + window.skew[:, np.newaxis] * tie).T[:, np.newaxis]
    by[:2, 1] = tie[:, np.newaxis, np.newaxis]
    by[2, 0] = slack[:, np.newaxis] * window.skew
    by[2, 1] = slack[:, np.newaxis]
    normal = np.zeros((n_starts, 3 + n_phases, 3 + n_phases))
    normal[:, :3, :3] = np.einsum("iasc,jasc->sij", by, np.einsum("jbsc,absc->jasc", by, among))
    crossed = np.einsum("iasc,ahsc->ihsc", by, half[:, :-1]) @ is_kind  # (3, harmonics, starts, kinds)
    crossed = crossed.transpose(2, 0, 3, 1).reshape(n_starts, 3, n_phases)
    normal[:, :3, 3:], normal[:, 3:, :3] = crossed, crossed.swapaxes(1, 2)
    own = (near.information[:-1, :-1] @ is_kind).transpose(2, 3, 0, 1)  # axes: starts and kinds first
    for g in range(is_kind.shape[1]):
        rows = slice(3 + g * n_harmonics, 3 + (g + 1) * n_harmonics)
        normal[:, rows, rows] = own[:, g]
    phases = (near.gradient[:-1] @ is_kind).transpose(1, 2, 0).reshape(n_starts, n_phases)
    return normal, np.concatenate([np.einsum("iasc,asc->si", by, pull), phases], axis=1)

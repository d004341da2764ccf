"""Maximum likelihood of a plane wave over its wave vector, from the normal equations of a window.

Gauss-Newton steps with the linear part, the amplitudes of each channel, solved exactly at each step (variable
projection: Golub, Pereyra 1973). Several starts are refined side by side. Starts and channels are the last
axes of whatever is computed for each of them, so that small matrices are handled together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import FALSE_DOUBT, TINY
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations
from tactiled.detect.worker import pause

# derived: convergence is quadratic from a start within a quarter of a radian.
_NEWTON_STEPS = 3
# choice: size of the last step. One more step would be a third of it or less on every window that was tried.
_CONVERGED_SIGMAS = 0.03
# derived: phase at the edge of the array. Beyond it the linear model of a phase does not hold.
LARGEST_STEP_RAD = 0.5
# derived: ridge that keeps the standard deviation of an undetermined quantity finite.
_NO_INFORMATION = 1e-12


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


def sweep(square: FloatArray, n: int) -> FloatArray:
    """Eliminate the first n unknowns of symmetric matrices (sweep operator: Goodnight 1979).

    [[A, B], [B', C]] becomes [[1/A, 1/A B], [-B' 1/A, C - B' 1/A B]]; A must be positive definite.
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

    (3 harmonics, functions, starts, channels).
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
    """Linearise the model near waves, with the inverse variances (channels,) of the noise.

    Parameters
    ----------
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


class WaveSolver:
    """Fits of one window, given the variance of each channel's noise, volts^2: (channels,)."""

    def __init__(self, window: DetrendedWindow, variance: FloatArray) -> None:
        self._window, self._motion, self._weight = window, window.motion, 1.0 / variance
        self._rim_mm = max(float(np.abs(window.layout.xy_mm).max()), 1e-3)

    def likely_phase_rate(self, k: FloatArray, line: float, sigmas: float) -> FloatArray:
        """Phase rate nearest to a line's among those that the motion allows: (starts,)."""
        if not self._motion.has_speed:
            return np.full(len(k), line)
        tied, reach = k @ self._window.tie, sigmas * self._slack(k)
        return np.asarray(np.clip(line, tied - reach, tied + reach))

    def _slack(self, k: FloatArray) -> FloatArray:
        """Standard deviation of the phase rate about the tie to the motion; 1 without a tie: (starts,)."""
        if not self._motion.has_speed:
            return np.ones(len(k))
        return self._window.half_travel * self._motion.along_sd(k)

    def solve(
        self,
        equations: NormalEquations,
        k: FloatArray,
        phase_rate: FloatArray,
        steps: int = _NEWTON_STEPS,
        phase: FloatArray | None = None,
    ) -> PlaneWaves:
        """Climb to the nearest maxima of the likelihood.

        The iteration ends early with a step that hardly moves (Newton's decrement: Boyd, Vandenberghe 2004,
        9.5.1); gain and covariance are then those of the point before it.

        Parameters
        ----------
        k, phase_rate : (starts, 2) and (starts,) float64
            A phase rate near that of `equations`: a change of frequency is followed to first order.
        phase : (starts, kinds, harmonics) float64, optional
            Known from a fit nearby.
        """
        k, phase_rate, unread = k.copy(), phase_rate.copy(), np.zeros(0)
        phase = self._first_phase(equations, k, phase_rate) if phase is None else phase
        for step in range(steps + 1):
            slack = self._slack(k)
            # Distance from the phase rate of a known motion, in units of the slack.
            off = (phase_rate - k @ self._window.tie) / np.where(slack > 0, slack, 1.0) * (slack > 0)
            here = PlaneWaves(k, phase_rate, gain=unread, covariance=unread, phase=phase)
            near = self._near(equations, here)
            normal, gradient = self._normal(near, slack)
            gradient[:, 2] -= off * self._motion.has_speed
            if step == steps:
                break
            move = _solved(normal, gradient[..., np.newaxis])[..., 0]
            is_last = (move * gradient).sum(axis=1).max() < _CONVERGED_SIGMAS**2
            size = np.abs(move[:, :2]).max(axis=1) * self._rim_mm
            move *= (LARGEST_STEP_RAD / np.maximum(size, LARGEST_STEP_RAD))[:, np.newaxis]
            k = k + move[:, :2]
            phase_rate = k @ self._window.tie + slack * (off + move[:, 2])
            phase = phase + move[:, 3:].reshape(phase.shape)
            if is_last:
                break
        gain = near.gain.sum(axis=1) - off**2 * self._motion.has_speed
        to_phase_rate = self._to_phase_rate(slack)
        covariance = _solved(normal, np.eye(normal.shape[1])[:, :3])[:, :3]
        return PlaneWaves(
            k, phase_rate, gain, to_phase_rate @ covariance @ to_phase_rate.transpose(0, 2, 1), phase
        )

    def _to_phase_rate(self, slack: FloatArray) -> FloatArray:
        """Matrix from (kx, ky, phase rate in units of slack) to (kx, ky, phase rate): (starts, 3, 3)."""
        to_phase_rate = np.zeros((len(slack), 3, 3))
        to_phase_rate[:, 0, 0] = to_phase_rate[:, 1, 1] = 1.0
        to_phase_rate[:, 2, :2] = self._window.tie
        to_phase_rate[:, 2, 2] = slack
        return to_phase_rate

    def displacements(self, equations: NormalEquations, waves: PlaneWaves, noise: FloatArray) -> FloatArray:
        """Change of a wave, (samples, 3) in wave vector and phase rate, that noise causes.

        The noise (samples, channels, functions) is added to the products of the equations.
        """
        slack = self._slack(waves.k)
        noisy = expected_products(equations, waves) + noise
        normal, gradient = self._normal(linearise(equations, self._weight, waves, noisy), slack)
        return np.asarray(
            _solved(normal, gradient[..., np.newaxis])[:, :3, 0] @ self._to_phase_rate(slack)[0].T
        )

    def has_strays(self, equations: NormalEquations, waves: PlaneWaves) -> bool:
        """True where phases of a kind differ by more than noise (chi-square test).

        Without the test every answer comes from the posterior of strays, and its intervals are too wide: 51
        of 51 answers in white noise lie within those of 95 %.
        """
        near = self._near(equations, waves)
        known = np.einsum("hhsc->hc", near.information[:-1, :-1])
        excess = near.gradient[:-1, 0] ** 2 / np.maximum(known, TINY)
        # Each kind uses one degree of freedom for each harmonic's phase; all kinds together two for the wave
        # vector.
        dof = int((known > 0).sum()) - equations.n_harmonics * self._window.layout.is_kind.shape[1] - 2
        return bool(excess.sum() > special.chdtri(max(dof, 1e-3), FALSE_DOUBT))

    def _first_phase(self, equations: NormalEquations, k: FloatArray, phase_rate: FloatArray) -> FloatArray:
        """Phases of the kinds that suit the channels' own phasors: (starts, kinds, harmonics)."""
        parts = equations.parts
        z = parts[:, 0::2] - 1j * parts[:, 1::2]  # a cos(h t + p) has the phasor a exp(i p)
        psi = self._window.psi(k, phase_rate)
        times = np.arange(1, equations.n_harmonics + 1)
        turned = np.abs(z) * z * np.exp(-1j * psi[..., np.newaxis] * times) * self._weight[:, np.newaxis]
        return np.asarray(np.angle(np.einsum("sch,cg->sgh", turned, self._window.layout.is_kind)))

    def _near(self, equations: NormalEquations, waves: PlaneWaves) -> Linearisation:
        return linearise(equations, self._weight, waves, equations.product[np.newaxis])

    def _normal(self, near: Linearisation, slack: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information and gradient, with the prior of a known motion: unit information on the slack."""
        normal, gradient = total_information(self._window, near, slack)
        normal[:, 2, 2] += float(self._motion.has_speed)
        return normal, gradient


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with information matrices; finite, and very large where there is no information."""
    diagonal = np.einsum("sii->si", normal)
    least = np.maximum(_NO_INFORMATION * diagonal.max(axis=1, keepdims=True), 1e-30)
    scale = (1.0 / np.sqrt(np.maximum(diagonal, least)))[..., np.newaxis]
    scaled = normal * scale * scale.swapaxes(1, 2) + _NO_INFORMATION * np.eye(normal.shape[1])
    return np.asarray(np.linalg.solve(scaled, right * scale) * scale)

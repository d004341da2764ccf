"""Maximum likelihood of a plane wave over its wave vector, from the normal equations of a window.

Gauss-Newton steps with the linear part solved exactly at each step (variable projection: Golub, Pereyra
1973). Several starts are refined side by side, along the first axis of every array.

No two taxels of a real skin are alike, and with a good signal this phase mismatch limits the accuracy, not
noise. Each channel's phases may therefore differ from those of its kind, with a variance that is estimated
from the fit. The mismatch is integrated out like any Gaussian unknown; frequencies do not depend on them.
"""

import operator

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.linear import (
    Linearisation,
    PlaneWaves,
    expected_products,
    linearise,
    total_information,
)
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations

# derived: convergence is quadratic from a start within a quarter of a radian.
_NEWTON_STEPS = 3
# choice: size of the last step. One more step would be a third of it or less on every window that was tried.
_CONVERGED_SIGMAS = 0.03
# derived: phase at the edge of the array. Beyond it the linear model of a phase does not hold.
LARGEST_STEP_RAD = 0.5
# choice: probability that noise alone passes as phase mismatch.
_FALSE_MISMATCH = 1e-3
# derived: variance of a uniformly distributed phase, radians^2.
_ANY_PHASE = np.pi**2 / 3
# derived: ridge that keeps the standard deviation of an undetermined quantity finite.
_NO_INFORMATION = 1e-12


class WaveSolver:
    """Fits of one window.

    Parameters
    ----------
    variance : (channels,) float64
        Of each channel's noise, volts^2.
    mismatch : (kinds, harmonics) float64, optional
        Variance of phases within a kind, radians^2; zeros where left out.
    """

    def __init__(
        self, window: DetrendedWindow, variance: FloatArray, mismatch: FloatArray | None = None
    ) -> None:
        is_kind = window.layout.is_kind
        self._window, self._motion, self._weight = window, window.motion, 1.0 / variance
        self._rim_mm = max(float(np.abs(window.layout.xy_mm).max()), 1e-3)
        self._mismatch = None if mismatch is None or not mismatch.any() else (is_kind @ mismatch).T

    def _tied_phase_rate(self, k: FloatArray) -> FloatArray:
        """Phase rate that a known motion gives wave vectors (starts, 2)."""
        return np.asarray(k @ self._window.tie)

    def likely_phase_rate(self, k: FloatArray, line: float, sigmas: float) -> FloatArray:
        """Phase rate nearest to a line's among those that the motion allows: (starts,)."""
        if not self._motion.has_speed:
            return np.full(len(k), line)
        tied, reach = self._tied_phase_rate(k), sigmas * self._slack(k)
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

        Parameters
        ----------
        k : (starts, 2) float64
        phase_rate : (starts,) float64
            Near that of `equations`: a change of frequency is followed to first order.
        steps : int
            At most. The iteration ends early with a step that hardly moves (Newton's decrement: Boyd,
            Vandenberghe 2004, 9.5.1); gain and covariance are then those of the point before it.
        phase : (starts, kinds, harmonics) float64, optional
            Known from a fit nearby.
        """
        k, phase_rate = k.copy(), phase_rate.copy()
        phase = self._first_phase(equations, k, phase_rate) if phase is None else phase
        for step in range(steps + 1):
            slack = self._slack(k)
            off = self._off(k, phase_rate, slack)
            near = self._near(equations, PlaneWaves(k, phase_rate, off, off, phase))
            normal, gradient = self._normal(near, slack)
            gradient[:, 2] -= off * self._motion.has_speed
            if step == steps:
                break
            move = _solved(normal, gradient[..., np.newaxis])[..., 0]
            is_last = (move * gradient).sum(axis=1).max() < _CONVERGED_SIGMAS**2
            size = np.abs(move[:, :2]).max(axis=1) * self._rim_mm
            move *= (LARGEST_STEP_RAD / np.maximum(size, LARGEST_STEP_RAD))[:, np.newaxis]
            k = k + move[:, :2]
            phase_rate = self._tied_phase_rate(k) + slack * (off + move[:, 2])
            phase = phase + move[:, 3:].reshape(phase.shape)
            if is_last:
                break
        gain = self._gain(near, off)
        to_phase_rate = self._to_phase_rate(slack)
        covariance = _solved(normal, np.eye(normal.shape[1])[:, :3])[:, :3]
        return PlaneWaves(
            k, phase_rate, gain, to_phase_rate @ covariance @ to_phase_rate.transpose(0, 2, 1), phase
        )

    def gain(self, equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
        """Gain (starts,) of waves as they are, with the phases of this solver's mismatch."""
        off = self._off(waves.k, waves.phase_rate, self._slack(waves.k))
        return self._gain(self._near(equations, waves), off)

    def _gain(self, near: Linearisation, off: FloatArray) -> FloatArray:
        return np.asarray(near.gain.sum(axis=1) - off**2 * self._motion.has_speed)

    def _off(self, k: FloatArray, phase_rate: FloatArray, slack: FloatArray) -> FloatArray:
        """Distance of phase rates from those of a known motion, in units of the slack: (starts,)."""
        tied = self._tied_phase_rate(k)
        return np.asarray((phase_rate - tied) / np.where(slack > 0, slack, 1.0) * (slack > 0))

    def _to_phase_rate(self, slack: FloatArray) -> FloatArray:
        """Matrix from (kx, ky, phase rate in units of slack) to (kx, ky, phase rate): (starts, 3, 3)."""
        to_phase_rate = np.zeros((len(slack), 3, 3))
        to_phase_rate[:, 0, 0] = to_phase_rate[:, 1, 1] = 1.0
        to_phase_rate[:, 2, :2] = self._window.tie
        to_phase_rate[:, 2, 2] = slack
        return to_phase_rate

    def displacements(self, equations: NormalEquations, waves: PlaneWaves, noise: FloatArray) -> FloatArray:
        """Change of a wave that noise causes: (samples, 3), in wave vector and phase rate.

        Parameters
        ----------
        noise : (samples, channels, functions) float64
            Added to the products of the equations.
        """
        slack = self._slack(waves.k)
        noisy = expected_products(equations, waves) + noise
        near = self._with_mismatch(linearise(equations, self._weight, waves, noisy))
        normal, gradient = self._normal(near, slack)
        return np.asarray(
            _solved(normal, gradient[..., np.newaxis])[:, :3, 0] @ self._to_phase_rate(slack)[0].T
        )

    def residual_products(self, equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
        """Part of the products that the wave does not explain: (channels, functions)."""
        return np.asarray(equations.product - expected_products(equations, waves)[0])

    def mismatch_variance(self, equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
        """Variance of phases within each kind that exceeds the noise: (kinds, harmonics), radians^2.

        The moment estimate of DerSimonian and Laird (1986), where a chi-square test finds any mismatch.
        """
        near = self._plain(equations, waves)
        is_kind = self._window.layout.is_kind
        known = np.einsum("hhsc->ch", near.information[:-1, :-1])
        excess = np.where(known > 0, near.gradient[:-1, 0].T ** 2 / np.where(known > 0, known, 1.0), 0.0)
        seen = (known > 0).astype(np.float64)
        # Each kind uses one degree of freedom for each harmonic's phase; all kinds together two for the wave
        # vector.
        spent = 1.0 + 2.0 / max(equations.n_harmonics * is_kind.shape[1], 1)
        dof = np.maximum(is_kind.T @ seen - spent, 0.0)
        q, total = is_kind.T @ excess, is_kind.T @ known
        if q.sum() <= special.chdtri(max(float(dof.sum()), 1e-3), _FALSE_MISMATCH):
            return np.zeros_like(q)
        share = dof / np.maximum(is_kind.T @ seen, 1.0)
        found = (q > dof) & (dof > 0)
        own = np.where(found, (q - dof) / np.where(found, np.maximum(total * share, 1e-200), 1.0), 0.0)
        # A kind has few channels: the pooled estimate of all kinds counts as one more channel.
        pooled = np.maximum((q - dof).sum(axis=0) / np.maximum((total * share).sum(axis=0), 1e-200), 0.0)
        # The mismatch of a channel is common to its harmonics, which then count as one observation.
        mismatch = np.minimum((dof * own + pooled) / (dof + 1.0), _ANY_PHASE)
        return np.asarray(equations.n_harmonics * mismatch)

    def standardised_mismatch(self, equations: NormalEquations, waves: PlaneWaves) -> FloatArray:
        """Deviation of each channel's fundamental from its kind, in standard deviations: (channels,)."""
        near = self._plain(equations, waves)
        known = near.information[0, 0, 0]
        allowed = 0.0 if self._mismatch is None else self._mismatch[0]
        return np.asarray(near.gradient[0, 0] / np.sqrt(np.maximum(known * (1 + known * allowed), 1e-300)))

    def _first_phase(self, equations: NormalEquations, k: FloatArray, phase_rate: FloatArray) -> FloatArray:
        """Phases of the kinds that suit the channels' own phasors: (starts, kinds, harmonics)."""
        parts = equations.parts
        z = parts[:, 0::2] - 1j * parts[:, 1::2]  # a cos(h t + p) has the phasor a exp(i p)
        psi = self._window.psi(k, phase_rate)
        times = np.arange(1, equations.n_harmonics + 1)
        turned = np.abs(z) * z * np.exp(-1j * psi[..., np.newaxis] * times) * self._weight[:, np.newaxis]
        return np.asarray(np.angle(np.einsum("sch,cg->sgh", turned, self._window.layout.is_kind)))

    def _near(self, equations: NormalEquations, waves: PlaneWaves) -> Linearisation:
        """Linearise near waves and integrate out the mismatch."""
        return self._with_mismatch(self._plain(equations, waves))

    def _with_mismatch(self, near: Linearisation) -> Linearisation:
        return near if self._mismatch is None else near.with_mismatch(self._mismatch)

    def _plain(self, equations: NormalEquations, waves: PlaneWaves) -> Linearisation:
        """Linearise near waves without mismatch; the solvers of a wave look at the same point repeatedly."""
        at = (waves.k, waves.phase_rate, waves.phase)
        for known_at, weight, near in equations.newest:
            if all(map(operator.is_, at, known_at)) and np.array_equal(weight, self._weight):
                known: Linearisation = near
                return known
        near = linearise(equations, self._weight, waves, equations.product[np.newaxis])
        equations.newest[:] = [(at, self._weight, near)]
        return near

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

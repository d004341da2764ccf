"""Maximum likelihood of a plane wave over its wave vector, from the tables of a window.

Gauss-Newton with the linear part solved exactly at each step (variable projection: Golub, Pereyra 1973).
Several starting points go side by side, along the first axis of every array.

On a real skin no two taxels are quite alike, and at a good signal this is what limits the phases, not noise.
So each channel's phases may stray from its kind's, with a variance of the kind that is found from the fit
(`stray`). Strays are integrated out like any Gaussian unknown; frequencies do not depend on them.
"""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables, Window
from tactiled.detect.grooves.linear import Geometry, Linear, Waves, expected, linearise, spread
from tactiled.detect.grooves.model import Layout, WaveMotion

_STEPS = 3  # quadratic from a start within a quarter of a radian
_CONVERGED = 0.03  # sigmas: after one more step, a third of that or less on any window that was tried
_LARGEST_STEP_RAD = 0.5  # at the rim of the array: beyond, the linear model of a phase is not one
_FALSE_STRAY = 1e-3  # noise passes for strays so often
_ANY_PHASE = np.pi**2 / 3  # variance of phases that are anything
_SECOND_ORDER = np.sqrt(3) / 2  # root mean square of half the square of what has unit variance
_RIDGE = 1e-12  # what no channel tells must have a finite sigma


class Solver:
    """Fits of one window.

    Parameters
    ----------
    window : Window
    layout : Layout
        Of the window's channels; places are relative to their mean.
    motion : WaveMotion
    variance : (channels,) float64
        Of each channel's noise, volts^2.
    stray : (kinds, harmonics) float64, optional
        Variance of phases within a kind, radians^2; zeros where left out.
    """

    def __init__(
        self,
        window: Window,
        layout: Layout,
        motion: WaveMotion,
        variance: FloatArray,
        stray: FloatArray | None = None,
    ) -> None:
        place = np.stack([layout.x_mm, layout.y_mm], axis=1)
        # Where the motion is known, turn = half_way (k . heading), but for what its sigmas allow.
        tie = window.half_way * motion.heading * float(motion.has_speed)
        self._geometry = Geometry(place, window.lag, layout.is_kind, 1.0 / variance, tie)
        self._rim_mm = max(float(np.abs(place).max()), 1e-3)
        self._stray = None if stray is None or not stray.any() else (layout.is_kind @ stray).T
        self._motion = motion

    def _turn_of(self, k: FloatArray) -> FloatArray:
        """Turn that a known motion makes of wave vectors (starts, 2)."""
        return np.asarray(k @ self._geometry.tie)

    def likely_turn(self, k: FloatArray, line: float, sigmas: float) -> FloatArray:
        """The turn next to a line's among those that the motion lets wave vectors have: (starts,)."""
        if not self._motion.has_speed:
            return np.full(len(k), line)
        tied, reach = self._turn_of(k), sigmas * self._slack(k)
        return np.asarray(np.clip(line, tied - reach, tied + reach))

    def _slack(self, k: FloatArray) -> FloatArray:
        """Sigma by which the turn may differ from the tie; 1 where there is none."""
        if not self._motion.has_speed:
            return np.ones(len(k))
        across = self._geometry.tie[0] * k[:, 1] - self._geometry.tie[1] * k[:, 0]
        along = self._turn_of(k)
        by_speed = along * (self._motion.speed_sd_mm_s / self._motion.speed_mm_s)
        # Of cos(tilt + error), first order and second: the first is nothing where normal and motion are one.
        sd = np.radians(self._motion.direction_sd_deg)
        return np.asarray(np.linalg.norm([by_speed, across * sd, along * _SECOND_ORDER * sd**2], axis=0))

    def solve(
        self,
        tables: Tables,
        k: FloatArray,
        turn: FloatArray,
        steps: int = _STEPS,
        phase: FloatArray | None = None,
    ) -> Waves:
        """Nearest maxima of the likelihood.

        Parameters
        ----------
        k : (starts, 2) float64
        turn : (starts,) float64
            Near that of `tables`: a change of frequency is followed to first order.
        steps : int
            At the most; the last is one that hardly moves (Newton's decrement: Boyd, Vandenberghe 2004,
            9.5.1), and then gain and covariance are those from where it began.
        phase : (starts, kinds, harmonics) float64, optional
            Where they are known from a fit nearby.
        """
        k, turn = k.copy(), turn.copy()
        phase = self._first_phase(tables, k, turn) if phase is None else phase
        product = tables.product[np.newaxis]
        for step in range(steps + 1):
            slack = self._slack(k)
            off = (turn - self._turn_of(k)) / np.where(slack > 0, slack, 1.0) * (slack > 0)
            near = self._near(tables, Waves(k, turn, off, off, phase), product)
            normal, gradient = self._normal(near, slack)
            gradient[:, 2] -= off * self._motion.has_speed
            if step == steps:
                break
            move = _solved(normal, gradient[..., np.newaxis])[..., 0]
            is_last = (move * gradient).sum(axis=1).max() < _CONVERGED**2
            size = np.abs(move[:, :2]).max(axis=1) * self._rim_mm
            move *= (_LARGEST_STEP_RAD / np.maximum(size, _LARGEST_STEP_RAD))[:, np.newaxis]
            k = k + move[:, :2]
            turn = self._turn_of(k) + slack * (off + move[:, 2])
            phase = phase + move[:, 3:].reshape(phase.shape)
            if is_last:
                break
        gain = near.gain.sum(axis=1) - off**2 * self._motion.has_speed
        to_turn = self._to_turn(slack)
        covariance = _solved(normal, np.eye(normal.shape[1])[:, :3])[:, :3]
        return Waves(k, turn, gain, to_turn @ covariance @ to_turn.transpose(0, 2, 1), phase)

    def _to_turn(self, slack: FloatArray) -> FloatArray:
        """What makes (kx, ky, turn) of (kx, ky, turn in units of its slack): (starts, 3, 3)."""
        to_turn = np.zeros((len(slack), 3, 3))
        to_turn[:, 0, 0] = to_turn[:, 1, 1] = 1.0
        to_turn[:, 2, :2] = self._geometry.tie
        to_turn[:, 2, 2] = slack
        return to_turn

    def moves(self, tables: Tables, waves: Waves, noise: FloatArray) -> FloatArray:
        """How far noise moves a wave: (samples, 3), in wave vector and turn.

        Parameters
        ----------
        waves : Waves
            One.
        noise : (samples, channels, functions) float64
            What it adds to the products of the tables.
        """
        slack = self._slack(waves.k)
        noisy = expected(self._geometry, tables, waves) + noise
        normal, gradient = self._normal(self._near(tables, waves, noisy), slack)
        return np.asarray(_solved(normal, gradient[..., np.newaxis])[:, :3, 0] @ self._to_turn(slack)[0].T)

    def surprise(self, tables: Tables, waves: Waves) -> FloatArray:
        """What the wave does not explain of the products: (channels, functions)."""
        return np.asarray(tables.product - expected(self._geometry, tables, waves)[0])

    def stray_of(self, tables: Tables, waves: Waves) -> FloatArray:
        """Variance of phases within each kind that noise does not account for: (kinds, harmonics).

        The moment estimate of DerSimonian and Laird (1986), where a chi-square test finds any at all.
        """
        near = linearise(self._geometry, tables, waves, tables.product[np.newaxis])
        known = np.einsum("hhsc->ch", near.information[:-1, :-1])
        excess = np.where(known > 0, near.push[:-1, 0].T ** 2 / np.where(known > 0, known, 1.0), 0.0)
        seen = (known > 0).astype(np.float64)
        # Each kind spends a phase of its own for each harmonic, and all of them two for the wave vector.
        spent = 1.0 + 2.0 / max(tables.n_harmonics * self._geometry.is_kind.shape[1], 1)
        dof = np.maximum(self._geometry.is_kind.T @ seen - spent, 0.0)
        q, total = self._geometry.is_kind.T @ excess, self._geometry.is_kind.T @ known
        if q.sum() <= special.chdtri(max(float(dof.sum()), 1e-3), _FALSE_STRAY):
            return np.zeros_like(q)
        share = dof / np.maximum(self._geometry.is_kind.T @ seen, 1.0)
        found = (q > dof) & (dof > 0)
        own = np.where(found, (q - dof) / np.where(found, np.maximum(total * share, 1e-200), 1.0), 0.0)
        # A kind has few channels: what all kinds show is worth one more of them.
        pooled = np.maximum((q - dof).sum(axis=0) / np.maximum((total * share).sum(axis=0), 1e-200), 0.0)
        # Harmonics of a channel stray together, and then all of them tell no more than one.
        stray = np.minimum((dof * own + pooled) / (dof + 1.0), _ANY_PHASE)
        return np.asarray(tables.n_harmonics * stray)

    def strays(self, tables: Tables, waves: Waves) -> FloatArray:
        """How far each channel's fundamental is from its kind's, in sigmas of what it may: (channels,)."""
        near = linearise(self._geometry, tables, waves, tables.product[np.newaxis])
        known = near.information[0, 0, 0]
        allowed = 0.0 if self._stray is None else self._stray[0]
        return np.asarray(near.push[0, 0] / np.sqrt(np.maximum(known * (1 + known * allowed), 1e-300)))

    def _first_phase(self, tables: Tables, k: FloatArray, turn: FloatArray) -> FloatArray:
        """Phases of the kinds that suit the channels' own phasors: (starts, kinds, harmonics)."""
        parts = tables.phasors()
        z = parts[:, 0::2] - 1j * parts[:, 1::2]  # a cos(h t + p) has the phasor a exp(i p)
        psi = self._geometry.psi(k, turn)
        times = np.arange(1, tables.n_harmonics + 1)
        turned = (
            np.abs(z) * z * np.exp(-1j * psi[..., np.newaxis] * times) * self._geometry.weight[:, np.newaxis]
        )
        return np.asarray(np.angle(np.einsum("sch,cg->sgh", turned, self._geometry.is_kind)))

    def _near(self, tables: Tables, waves: Waves, product: FloatArray) -> Linear:
        """What channels say near waves, but for strays."""
        near = linearise(self._geometry, tables, waves, product)
        return near if self._stray is None else near.strayed(self._stray)

    def _normal(self, near: Linear, slack: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information and gradient; a motion that is known has one unit of the slack's."""
        normal, gradient = spread(self._geometry, near, slack)
        normal[:, 2, 2] += float(self._motion.has_speed)
        return normal, gradient


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solution for information matrices; finite, and very large where there is no information."""
    diagonal = np.einsum("sii->si", normal)
    least = np.maximum(_RIDGE * diagonal.max(axis=1, keepdims=True), 1e-30)
    scale = (1.0 / np.sqrt(np.maximum(diagonal, least)))[..., np.newaxis]
    scaled = normal * scale * scale.swapaxes(1, 2) + _RIDGE * np.eye(normal.shape[1])
    return np.asarray(np.linalg.solve(scaled, right * scale) * scale)

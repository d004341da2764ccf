"""Maximum likelihood of a plane wave over its wave vector, from the tables of a window.

Gauss-Newton with the linear part solved exactly at each step (variable projection: Golub, Pereyra 1973).
Several starting points go side by side, along the first axis of every array.

On a real skin no two taxels are quite alike, and at a good signal this is what limits the phases, not noise.
So each channel's phases may stray from its kind's, with a variance of the kind that is found from the fit
(`stray`). Strays are integrated out like any Gaussian unknown; frequencies do not depend on them.
"""

from dataclasses import replace

import numpy as np
from scipy import stats

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Tables, Window
from tactiled.detect.wave_linear import Geometry, Waves, linearise, spread
from tactiled.detect.wave_model import Layout, WaveMotion

_STEPS = 3  # quadratic from a start within a quarter of a radian
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
        is_kind = (layout.kind[:, np.newaxis] == np.unique(layout.kind)).astype(np.float64)
        # Where the motion is known, turn = half_way (k . heading), but for what its sigmas allow.
        tie = window.half_way * motion.heading * float(motion.has_speed)
        self._geometry = Geometry(place, window.lag, is_kind, 1.0 / variance, tie)
        self._rim_mm = max(float(np.abs(place).max()), 1e-3)
        self._stray = None if stray is None else is_kind @ stray
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

    def solve(self, tables: Tables, k: FloatArray, turn: FloatArray, steps: int = _STEPS) -> Waves:
        """Nearest maxima of the likelihood.

        Parameters
        ----------
        k : (starts, 2) float64
        turn : (starts,) float64
            Near that of `tables`: a change of frequency is followed to first order.
        """
        k, turn = k.copy(), turn.copy()
        phase = self._first_phase(tables, k, turn)
        for step in range(steps + 1):
            slack = self._slack(k)
            off = (turn - self._turn_of(k)) / np.where(slack > 0, slack, 1.0) * (slack > 0)
            waves = Waves(k, turn, np.zeros(len(k)), np.zeros((len(k), 3, 3)), phase)
            normal, gradient, gain = self._linearised(tables, waves, slack)
            if self._motion.has_speed:
                normal[:, 2, 2] += 1.0
                gradient[:, 2] -= off
                gain = gain - off**2
            inverse = _inverse(normal)
            if step == steps:
                break
            move = (inverse @ gradient[..., np.newaxis])[..., 0]
            size = np.abs(move[:, :2]).max(axis=1) * self._rim_mm
            move *= (_LARGEST_STEP_RAD / np.maximum(size, _LARGEST_STEP_RAD))[:, np.newaxis]
            k = k + move[:, :2]
            turn = self._turn_of(k) + slack * (off + move[:, 2])
            phase = phase + move[:, 3:].reshape(phase.shape)
        to_turn = self._to_turn(slack)
        covariance = to_turn @ inverse[:, :3, :3] @ to_turn.transpose(0, 2, 1)
        return Waves(k, turn, gain, covariance, phase)

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
        expected = linearise(self._geometry, tables, waves, slack).expected
        noisy = replace(tables, product=expected + noise)
        repeated = waves[np.zeros(len(noise), dtype=np.int64)]
        normal, gradient, _ = self._linearised(noisy, repeated, np.repeat(slack, len(noise)))
        normal[:, 2, 2] += float(self._motion.has_speed)
        move = (_inverse(normal) @ gradient[..., np.newaxis])[:, :3]
        return np.asarray((self._to_turn(slack) @ move)[..., 0])

    def surprise(self, tables: Tables, waves: Waves) -> FloatArray:
        """What the wave does not explain of the products: (channels, functions)."""
        return np.asarray(
            tables.product - linearise(self._geometry, tables, waves, self._slack(waves.k)).expected[0]
        )

    def stray_of(self, tables: Tables, waves: Waves) -> FloatArray:
        """Variance of phases within each kind that noise does not account for: (kinds, harmonics).

        The moment estimate of DerSimonian and Laird (1986), where a chi-square test finds any at all.
        """
        near = linearise(self._geometry, tables, waves, self._slack(waves.k))
        push, information = near.push, near.information
        known = np.einsum("chh->ch", information[0, :, 3:, 3:])
        excess = np.where(known > 0, push[0, :, 3:] ** 2 / np.where(known > 0, known, 1.0), 0.0)
        seen = (known > 0).astype(np.float64)
        # Each kind spends a phase of its own for each harmonic, and all of them two for the wave vector.
        spent = 1.0 + 2.0 / max(tables.n_harmonics * self._geometry.is_kind.shape[1], 1)
        dof = np.maximum(self._geometry.is_kind.T @ seen - spent, 0.0)
        q, total = self._geometry.is_kind.T @ excess, self._geometry.is_kind.T @ known
        if q.sum() <= stats.chi2.isf(_FALSE_STRAY, max(float(dof.sum()), 1e-3)):
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
        near = linearise(self._geometry, tables, waves, self._slack(waves.k))
        known = near.information[0, :, 3, 3]
        allowed = 0.0 if self._stray is None else self._stray[:, 0]
        return np.asarray(near.push[0, :, 3] / np.sqrt(np.maximum(known * (1 + known * allowed), 1e-300)))

    def _first_phase(self, tables: Tables, k: FloatArray, turn: FloatArray) -> FloatArray:
        """Phases of the kinds that suit the channels' own phasors: (starts, kinds, harmonics)."""
        parts = tables.phasors()
        z = parts[:, 0::2] - 1j * parts[:, 1::2]  # a cos(h t + p) has the phasor a exp(i p)
        psi = k @ self._geometry.place.T + turn[:, np.newaxis] * self._geometry.lag
        times = np.arange(1, tables.n_harmonics + 1)
        turned = (
            np.abs(z) * z * np.exp(-1j * psi[..., np.newaxis] * times) * self._geometry.weight[:, np.newaxis]
        )
        return np.asarray(np.angle(np.einsum("sch,cg->sgh", turned, self._geometry.is_kind)))

    def _linearised(
        self, tables: Tables, waves: Waves, slack: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Information, gradient and gain, with amplitudes and strays taken out.

        Unknowns: kx, ky, the turn in units of its slack, then kind by kind the phases of the harmonics.
        """
        near = linearise(self._geometry, tables, waves, slack)
        gain, push, information = near.gain, near.push, near.information
        if self._stray is not None and self._stray.any():
            # With T their variance, strays e have the information F + T^-1; its inverse is T (1 + F T)^-1.
            straying = information[..., 3:, 3:] * self._stray[:, np.newaxis] + np.eye(tables.n_harmonics)
            freedom = self._stray[..., np.newaxis] * np.linalg.inv(straying)
            taken = information[..., 3:] @ freedom
            gain = gain + (push[..., np.newaxis, 3:] @ freedom @ push[..., 3:, np.newaxis]).sum(
                axis=(1, 2, 3)
            )
            push = push - (taken @ push[..., 3:, np.newaxis])[..., 0]
            information = information - taken @ information[..., 3:, :]
        return *spread(information, push, self._geometry.is_kind), gain


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of information matrices; finite, and very large where there is no information."""
    diagonal = np.einsum("sii->si", normal)
    least = np.maximum(_RIDGE * diagonal.max(axis=1, keepdims=True), 1e-30)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, least))
    both = scale[:, :, np.newaxis] * scale[:, np.newaxis]
    return np.asarray(np.linalg.inv(normal * both + _RIDGE * np.eye(normal.shape[1])) * both)

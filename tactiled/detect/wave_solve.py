"""Maximum likelihood of a plane wave over its wave vector, from the tables of a window.

Gauss-Newton with the linear part solved exactly at each step (variable projection: Golub, Pereyra 1973).
Several starting points go side by side, along the first axis of every array.

On a real skin no two taxels are quite alike, and at a good signal this is what limits the phases, not noise.
So each channel's phases may stray from its kind's, with a variance of the kind that is found from the fit
(`stray`). Strays are integrated out like any Gaussian unknown; frequencies do not depend on them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Tables, Window
from tactiled.detect.wave_model import Layout, WaveMotion

_STEPS = 6  # quadratic from a start within a fraction of a radian
_LARGEST_STEP_RAD = 0.5  # at the rim of the array: beyond, the linear model of a phase is not one
_FALSE_STRAY = 1e-3  # noise passes for strays of a kind so often
_RIDGE = 1e-12  # what no channel tells must have a finite sigma


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
        self._weight = 1.0 / variance
        self._place = np.stack([layout.x_mm, layout.y_mm], axis=1)
        self._rim_mm = max(float(np.abs(self._place).max()), 1e-3)
        kinds = np.unique(layout.kind)
        self._is_kind = (layout.kind[:, np.newaxis] == kinds).astype(np.float64)
        self._stray = None if stray is None else self._is_kind @ stray
        self._lag = window.lag
        self._motion = motion
        # Where the motion is known, turn = half_way (k . heading) (1 + what its sigmas allow).
        self._tie = window.half_way * motion.heading * float(motion.has_speed)

    def turn_of(self, k: FloatArray) -> FloatArray:
        """Turn that a known motion makes of wave vectors (starts, 2)."""
        return np.asarray(k @ self._tie)

    def _slack(self, k: FloatArray) -> FloatArray:
        """Sigma by which the turn may differ from the tie; 1 where there is none."""
        if not self._motion.has_speed:
            return np.ones(len(k))
        across = self._tie[0] * k[:, 1] - self._tie[1] * k[:, 0]
        by_speed = self.turn_of(k) * (self._motion.speed_sd_mm_s / self._motion.speed_mm_s)
        return np.asarray(np.hypot(by_speed, across * np.radians(self._motion.direction_sd_deg)))

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
            off = (turn - self.turn_of(k)) / np.where(slack > 0, slack, 1.0) * (slack > 0)
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
            turn = self.turn_of(k) + slack * (off + move[:, 2])
            phase = phase + move[:, 3:].reshape(phase.shape)
        # From (k, slack units) to (k, turn).
        to_turn = np.zeros((len(k), 3, 3))
        to_turn[:, 0, 0] = to_turn[:, 1, 1] = 1.0
        to_turn[:, 2, :2] = self._tie
        to_turn[:, 2, 2] = slack
        covariance = to_turn @ inverse[:, :3, :3] @ to_turn.transpose(0, 2, 1)
        return Waves(k, turn, gain, covariance, phase)

    def stray_of(self, tables: Tables, waves: Waves) -> FloatArray:
        """Variance of phases within each kind that noise does not account for: (kinds, harmonics).

        The moment estimate of DerSimonian and Laird (1986), where a chi-square test finds any at all.
        """
        _, push, information, _ = self._by_channel(tables, waves, self._slack(waves.k))
        known = np.einsum("chh->ch", information[0, :, 3:, 3:])
        excess = np.where(known > 0, push[0, :, 3:] ** 2 / np.where(known > 0, known, 1.0), 0.0)
        seen = (known > 0).astype(np.float64)
        # Each kind spends a phase of its own for each harmonic, and all of them two for the wave vector.
        spent = 1.0 + 2.0 / max(tables.n_harmonics * self._is_kind.shape[1], 1)
        dof = np.maximum(self._is_kind.T @ seen - spent, 0.0)
        q, total = self._is_kind.T @ excess, self._is_kind.T @ known
        usual = stats.chi2.isf(_FALSE_STRAY, np.maximum(dof, 1e-3))
        share = dof / np.maximum(self._is_kind.T @ seen, 1.0)
        found = (q > usual) & (dof > 0)
        return np.where(found, (q - dof) / np.where(found, total * share, 1.0), 0.0)

    def _first_phase(self, tables: Tables, k: FloatArray, turn: FloatArray) -> FloatArray:
        """Phases of the kinds that suit the channels' own phasors: (starts, kinds, harmonics)."""
        parts = tables.phasors()
        z = parts[:, 0::2] - 1j * parts[:, 1::2]  # a cos(h t + p) has the phasor a exp(i p)
        psi = k @ self._place.T + turn[:, np.newaxis] * self._lag
        times = np.arange(1, tables.n_harmonics + 1)
        turned = np.abs(z) * z * np.exp(-1j * psi[..., np.newaxis] * times) * self._weight[:, np.newaxis]
        return np.asarray(np.angle(np.einsum("sch,cg->sgh", turned, self._is_kind)))

    def _linearised(
        self, tables: Tables, waves: Waves, slack: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Information, gradient and gain, with amplitudes and strays taken out.

        Unknowns: kx, ky, the turn in units of its slack, then kind by kind the phases of the harmonics.
        """
        gain, push, information, own = self._by_channel(tables, waves, slack)
        if self._stray is not None and self._stray.any():
            # With T their variance, strays e have the information F + T^-1; its inverse is T (1 + F T)^-1.
            straying = information[..., 3:, 3:] * self._stray[:, np.newaxis] + np.eye(tables.n_harmonics)
            spread = self._stray[..., np.newaxis] * np.linalg.inv(straying)
            taken = information[..., 3:] @ spread
            gain = gain + (push[..., np.newaxis, 3:] @ spread @ push[..., 3:, np.newaxis]).sum(axis=(1, 2, 3))
            push = push - (taken @ push[..., 3:, np.newaxis])[..., 0]
            information = information - taken @ information[..., 3:, :]
        return *_spread(information, push, self._is_kind, own), gain

    def _by_channel(
        self, tables: Tables, waves: Waves, slack: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Gain (starts,); gradient, information of each channel, amplitudes taken out; number of phases."""
        k, turn, phase = waves.k, waves.turn, waves.phase
        n_starts, n_harmonics = len(k), tables.n_harmonics
        n_channels, n_kinds = self._is_kind.shape
        gram, product = tables.gram, tables.product
        times = np.arange(1, n_harmonics + 1)
        psi = k @ self._place.T + turn[:, np.newaxis] * self._lag
        own = np.einsum("sgh,cg->sch", phase, self._is_kind)
        alpha = psi[..., np.newaxis] * times + own
        ahead = (turn - tables.turn)[:, np.newaxis, np.newaxis]
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
        gain = (((product + rest) * model).sum(axis=-1) * self._weight).sum(axis=-1)
        by_phase = slopes * amplitude[:, :, np.newaxis]
        by_psi = (by_phase * times).sum(axis=-1, keepdims=True)
        by_turn = (late * amplitude[:, :, np.newaxis]).sum(axis=-1, keepdims=True)
        by_turn = by_turn + by_psi * self._lag[:, np.newaxis, np.newaxis]
        by_k = by_psi * self._place[:, np.newaxis] + by_turn * self._tie
        by_slack = by_turn * slack[:, np.newaxis, np.newaxis, np.newaxis]
        by = np.concatenate([by_k, by_slack, by_phase], axis=-1)
        gram_by = gram @ by
        coupling = columns.swapaxes(-1, -2) @ gram_by
        information = by.swapaxes(-1, -2) @ gram_by
        information -= coupling.swapaxes(-1, -2) @ np.linalg.solve(inner, coupling)
        information *= self._weight[:, np.newaxis, np.newaxis]
        push = (by.swapaxes(-1, -2) @ rest[..., np.newaxis])[..., 0] * self._weight[:, np.newaxis]
        return gain, push, information, n_kinds * n_harmonics


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of information matrices; finite, and very large where there is no information."""
    diagonal = np.einsum("sii->si", normal)
    least = np.maximum(_RIDGE * diagonal.max(axis=1, keepdims=True), 1e-30)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, least))
    both = scale[:, :, np.newaxis] * scale[:, np.newaxis]
    return np.asarray(np.linalg.inv(normal * both + _RIDGE * np.eye(normal.shape[1])) * both)


def _spread(
    information: FloatArray, push: FloatArray, is_kind: FloatArray, n_phases: int
) -> tuple[FloatArray, FloatArray]:
    """Sums over channels, with each kind's phases in its own rows."""
    n_starts = len(information)
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

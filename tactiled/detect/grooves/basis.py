"""A window reduced to what a plane wave's likelihood depends on.

Near one frequency, readings matter only through their products with a few functions of time: sine and cosine
of each harmonic, and the same times the way travelled, which is how the wave answers to a small change of
frequency. Slow polynomials are projected out of readings and functions alike, which is the same as fitting
them (Frisch, Waugh, Lovell). So one pass over the window makes a small table for each channel, and all
questions about wave vectors, phases and amplitudes are asked of the tables.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_NEXT_RAD = 0.75 * np.pi  # of turn: lines less than so many periods of the window apart are one
_STRAIGHT = 1  # order of the least trend: level and slope
# Of a function's sum of squares: what the trend takes whole, rounding leaves no part of a line of. It moves
# amplitudes by less than a converter of 30 bits can tell.
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Window:
    """Readings with the slow part taken out.

    The way travelled runs from about -1 to 1 over the window; `half_way` is what 1 stands for, in
    millimetres (or seconds, where the speed is not known).

    Attributes
    ----------
    volts : (channels, n) float64
        Orthogonal to `trend`.
    way : (1 or channels, n) float64
        One row where all channels travel evenly, else each channel's own.
    lag : (channels,) float64
        By how much more way each channel has travelled than `way` says.
    half_way : float
    duration_s : float
    trend : (n, terms) float64
        Orthonormal polynomials, and lines that were taken out.
    gone : tuple of float
        Turns of those lines.
    """

    volts: FloatArray
    way: FloatArray
    lag: FloatArray
    half_way: float
    duration_s: float
    trend: FloatArray
    gone: tuple[float, ...] = ()

    @property
    def n(self) -> int:
        return len(self.trend)

    @cached_property
    def power(self) -> FloatArray:
        """Sum of squares of each channel, volts^2: (channels,)."""
        return np.asarray(np.einsum("cn,cn->c", self.volts, self.volts))

    def without(self, turn: float, multiples: Iterable[float]) -> "Window":
        """The same with lines at multiples of a frequency taken to be part of the trend."""
        turns = [turn * multiple for multiple in multiples]
        angle = np.outer(self.way.mean(axis=0), turns)
        left = self._without(np.concatenate([np.cos(angle), np.sin(angle)], axis=1))
        return replace(left, gone=(*self.gone, *turns))

    def is_gone(self, turn: float) -> bool:
        """Whether a line next to this one was taken out, so that nothing can be said of it."""
        return any(abs(turn - other) < _NEXT_RAD for other in self.gone)

    def curved(self, order: int) -> "Window":
        """The same with polynomials of up to `order` taken to be part of the trend."""
        return self._without(trend_basis(self.n, order)[:, _STRAIGHT + 1 :])

    def less(self, phasors: NDArray[np.complex128], turn: float) -> "Window":
        """The same without a wave of known phasors: (channels,), as if sampled at once."""
        late = np.exp(1j * turn * (self.way + self.lag[:, np.newaxis]))
        volts = self.volts - (phasors[:, np.newaxis] * late).real
        return replace(self, volts=volts - (volts @ self.trend) @ self.trend.T)

    def _without(self, functions: FloatArray) -> "Window":
        trend = np.linalg.qr(np.concatenate([self.trend, functions], axis=1))[0]
        volts = self.volts - (self.volts @ trend) @ trend.T
        return replace(self, volts=volts, trend=np.asarray(trend))

    def frequency_hz(self, turn: float) -> float:
        """Of a phase for 1 of way, on average."""
        return turn / np.pi / self.duration_s

    @cached_property
    def largest_step(self) -> float:
        """Way between two scans, at the most."""
        return float(np.diff(self.way[0]).max())


def trend_basis(n: int, order: int) -> FloatArray:
    """Orthonormal polynomials of up to `order` on n even steps: (n, order + 1)."""
    steps = np.linspace(-1.0, 1.0, n)
    return np.asarray(np.linalg.qr(np.polynomial.legendre.legvander(steps, order))[0])


def make_window(
    volts: FloatArray, time_s: FloatArray, way_rate: FloatArray, channel_offset_s: FloatArray
) -> Window:
    """Window from readings (n, channels) at scans that begin at `time_s`, and way a second after each.

    Its trend is a straight line.
    """
    duration_s = float(time_s[-1] - time_s[0])
    way = np.concatenate([[0.0], np.cumsum(way_rate[:-1] * np.diff(time_s))])
    trend = trend_basis(len(volts), _STRAIGHT)
    readings = volts.T - (volts.T @ trend) @ trend.T
    half_way = float(np.ptp(way)) / 2 or 1.0
    way = (way - (way.min() + way.max()) / 2) / half_way
    rate = way_rate / half_way
    if np.ptp(rate) <= 1e-9 * abs(rate).max():
        return Window(readings, way[np.newaxis], channel_offset_s * rate[0], half_way, duration_s, trend)
    each = way + np.outer(channel_offset_s, rate)
    return Window(readings, each, np.zeros(len(channel_offset_s)), half_way, duration_s, trend)


@dataclass(frozen=True, eq=False)
class Tables:
    """Products of a window with cosine, sine of each harmonic, then the same times the way.

    Attributes
    ----------
    turn : float
        Phase of the fundamental for 1 of way, radians.
    gram : (1 or channels, 4 harmonics, 4 harmonics) float64
    product : (channels, 4 harmonics) float64
    """

    turn: float
    n_harmonics: int
    gram: FloatArray
    product: FloatArray

    def times_gram(self, on: FloatArray) -> FloatArray:
        """Products that combinations of the functions have: (..., functions, starts, channels)."""
        if len(self.gram) > 1:
            return np.asarray(np.einsum("cef,...fsc->...esc", self.gram, on))
        return np.asarray((self.gram[0] @ on.reshape(*on.shape[:-2], -1)).reshape(on.shape))

    def phasors(self) -> FloatArray:
        """Least-squares cosine and sine parts of each channel by itself: (channels, 2 harmonics)."""
        return self._phasors

    @cached_property
    def _phasors(self) -> FloatArray:
        m = 2 * self.n_harmonics
        if len(self.gram) == 1:
            return np.asarray(np.linalg.solve(self.gram[0, :m, :m], self.product[:, :m].T).T)
        return np.asarray(np.linalg.solve(self.gram[:, :m, :m], self.product[:, :m, np.newaxis])[..., 0])

    def turn_sd(self, variance: FloatArray) -> float:
        """Sigma of the turn (radians) where channels agree on nothing else: Cramer-Rao, fundamental alone."""
        m = 2 * self.n_harmonics
        late = np.zeros_like(self.product)  # what a change of the turn adds, as parts of the functions
        parts = self.phasors()
        late[:, m], late[:, m + 1] = parts[:, 1], -parts[:, 0]
        seen = (self.gram @ late[..., np.newaxis])[..., 0]
        own = np.linalg.solve(self.gram[:, :m, :m], seen[:, :m, np.newaxis])[..., 0]
        information = (late * seen).sum(axis=1) - (own * seen[:, :m]).sum(axis=1)
        return float(1 / np.sqrt(max(float((information / variance).sum()), 1e-12)))

    def explained(self) -> FloatArray:
        """Sum of squares that `phasors` explain in each channel, volts^2: (channels,)."""
        return np.asarray((self.phasors() * self.product[:, : 2 * self.n_harmonics]).sum(axis=1))


def tabulate(window: Window, turn: float, n_harmonics: int) -> Tables:
    """Tables of a window at one frequency."""
    wave = np.exp(1j * turn * window.way)
    rows = []
    power = np.ones_like(wave)
    for _ in range(n_harmonics):
        power = power * wave
        rows += [power.real, power.imag]
    basis = np.stack(rows, axis=1)  # (groups, 2 harmonics, n)
    basis = np.concatenate([basis, basis * window.way[:, np.newaxis]], axis=1)
    # Readings have no trend, so that functions need not be rid of theirs: their products are.
    slow = basis @ window.trend
    gram = basis @ basis.swapaxes(1, 2) - slow @ slow.swapaxes(1, 2)
    gram += _RIDGE * window.n / 2 * np.eye(basis.shape[1])
    if len(basis) == 1:
        product = window.volts @ basis[0].T
    else:
        product = (basis @ window.volts[:, :, np.newaxis])[..., 0]
    return Tables(turn, n_harmonics, gram, product)

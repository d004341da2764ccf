"""Scans of a sliding window, and the sums over them that the likelihood of a plane wave depends on.

Near one frequency, readings enter the likelihood only through their products with a few functions of time:
cosine and sine of each harmonic, and the same times the distance travelled, which describe the response to a
small change of frequency. Slow polynomials are projected out of readings and functions alike, which equals
fitting them (Frisch, Waugh, Lovell). One pass over the window therefore yields small normal equations for
each channel, and every question about wave vectors, phases and amplitudes is answered from those.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.worker import pause
from tactiled.samples.block import ScanBlock

# Part of a channel's readings. A channel with more bad ones is left out of a fit.
MOST_BAD_PART = 0.05
# Phase rate. Lines that are less than this apart cannot be resolved in one window: 0.75 of its periods.
_NEXT_RAD = 0.75 * np.pi
# Order of the trend that is always removed: level and slope.
STRAIGHT = 1
# Ridge as a fraction of a function's sum of squares. Rounding leaves nothing of a line that the trend absorbs
# whole. The ridge changes amplitudes by less than a 30-bit converter can resolve.
_RIDGE = 1e-9


class ScanWindow:
    """The newest scans, up to a number that can grow, contiguous in memory so that fits take views.

    Parameters
    ----------
    size : int
        Scans at most.
    most : int, optional
        Scans that are kept for `widen`; `size` if not given.
    """

    def __init__(self, size: int, n_channels: int, most: int | None = None) -> None:
        self.size = size
        self._most = most = max(size, most or 0)
        self._end = 0
        self._volts = np.empty((2 * most, n_channels))
        self._good = np.empty((2 * most, n_channels), dtype=np.bool_)
        self._time_s = np.empty(2 * most)
        self._speeds_mm_s = np.empty(2 * most)

    def widen(self) -> None:
        """Double the number of scans, up to the most."""
        self.size = min(2 * self.size, self._most)

    def append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        """Append scans, with the usable readings (n, channels) and the speed at each scan (n,)."""
        for first in range(0, len(block), self._most):
            self._append(block[first : first + self._most], good[first:], speeds_mm_s[first:])

    def _append(self, block: ScanBlock, good: NDArray[np.bool_], speeds_mm_s: FloatArray) -> None:
        n = len(block)
        if self._end + n > 2 * self._most:
            kept = slice(max(0, self._end - self._most), self._end)
            self._end = kept.stop - kept.start
            for store in (self._volts, self._good, self._time_s, self._speeds_mm_s):
                store[: self._end] = store[kept].copy()
        rows = slice(self._end, self._end + n)
        self._volts[rows], self._good[rows] = block.volts, good[:n]
        self._time_s[rows], self._speeds_mm_s[rows] = block.time_s, speeds_mm_s[:n]
        self._end += n

    def __len__(self) -> int:
        return min(self._end, self.size)

    @property
    def _rows(self) -> slice:
        return slice(max(0, self._end - self.size), self._end)

    @property
    def sign(self) -> float:
        """Sign of the newest speed: 1 forward, -1 backward, 0 unknown."""
        return float(np.sign(self._speeds_mm_s[self._end - 1])) if self._end else 0.0

    @property
    def volts(self) -> FloatArray:
        """Readings, oldest first: (n, channels)."""
        return self._volts[self._rows]

    @property
    def good(self) -> NDArray[np.bool_]:
        """True for usable readings: (n, channels)."""
        return self._good[self._rows]

    @property
    def time_s(self) -> FloatArray:
        """Instants at which scans began: (n,)."""
        return self._time_s[self._rows]

    @property
    def speeds_mm_s(self) -> FloatArray:
        """Speed from each scan to the next: (n,)."""
        return self._speeds_mm_s[self._rows]


def filled(volts: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Readings (n, channels) with the few bad ones interpolated linearly."""
    volts = volts.copy()
    scans = np.arange(len(volts))
    for c in np.flatnonzero(~usable.all(axis=0)):
        good = usable[:, c]
        volts[~good, c] = np.interp(scans[~good], scans[good], volts[good, c])
    return volts


@dataclass(frozen=True, eq=False)
class DetrendedWindow:
    """Readings of one window with the slow part removed.

    The distance travelled is scaled to run from about -1 to 1 over the window. `half_travel` is the distance
    that 1 stands for, in millimetres (or seconds, where the speed is unknown). A phase rate is in radians per
    unit of this scaled distance: a line of c periods in the window has the phase rate ``pi c``.

    Attributes
    ----------
    volts : (channels, n) float64
        Orthogonal to `trend`.
    travel : (1 or channels, n) float64
        One row where the speed is constant, else a row for each channel.
    skew : (channels,) float64
        Distance travelled between the instant that `travel` states and the sampling of each channel.
    trend : (n, terms) float64
        Orthonormal columns: polynomials, and lines that were removed.
    removed : tuple of float
        Phase rates of those lines.
    """

    volts: FloatArray
    travel: FloatArray
    skew: FloatArray
    half_travel: float
    duration_s: float
    trend: FloatArray
    removed: tuple[float, ...] = ()

    @property
    def n(self) -> int:
        """Number of scans."""
        return len(self.trend)

    @cached_property
    def power(self) -> FloatArray:
        """Sum of squares of each channel, volts^2: (channels,)."""
        return np.asarray(np.einsum("cn,cn->c", self.volts, self.volts))

    def without_lines(self, phase_rate: float, multiples: Iterable[float]) -> "DetrendedWindow":
        """A copy in which the lines at multiples of a phase rate are part of the trend."""
        phase_rates = [phase_rate * multiple for multiple in multiples]
        angle = np.outer(self.travel.mean(axis=0), phase_rates)
        left = self._without(np.concatenate([np.cos(angle), np.sin(angle)], axis=1))
        return replace(left, removed=(*self.removed, *phase_rates))

    def is_removed(self, phase_rate: float) -> bool:
        """Return True next to a removed line, where the window holds no information."""
        return any(abs(phase_rate - other) < _NEXT_RAD for other in self.removed)

    def with_trend_order(self, order: int) -> "DetrendedWindow":
        """A copy in which polynomials of up to `order` are part of the trend."""
        return self._without(trend_basis(self.n, order)[:, STRAIGHT + 1 :])

    def _without(self, functions: FloatArray) -> "DetrendedWindow":
        trend = np.linalg.qr(np.concatenate([self.trend, functions], axis=1))[0]
        volts = self.volts - (self.volts @ trend) @ trend.T
        return replace(self, volts=volts, trend=np.asarray(trend))

    def frequency_hz(self, phase_rate: float) -> float:
        """Mean frequency of a phase rate."""
        return phase_rate / np.pi / self.duration_s

    @cached_property
    def largest_step(self) -> float:
        """Largest scaled distance between two scans."""
        return float(np.diff(self.travel[0]).max())


@lru_cache(maxsize=16)  # windows that have their full length ask for the same few
def trend_basis(n: int, order: int) -> FloatArray:
    """Orthonormal polynomials of up to `order` on n even steps: (n, order + 1), read-only."""
    steps = np.linspace(-1.0, 1.0, n)
    basis = np.asarray(np.linalg.qr(np.polynomial.legendre.legvander(steps, order))[0])
    basis.flags.writeable = False
    return basis


def make_window(
    volts: FloatArray,
    time_s: FloatArray,
    travel_rate: FloatArray,
    channel_offset_s: FloatArray,
    trend_order: int = STRAIGHT,
) -> DetrendedWindow:
    """Remove a polynomial trend from readings and scale the distance travelled.

    Parameters
    ----------
    volts : (n, channels) float64
    time_s : (n,) float64
        Instants at which scans began.
    travel_rate : (n,) float64
        Distance per second after each scan, mm/s; ones where the speed is unknown.
    channel_offset_s : (channels,) float64
        Delay from the beginning of a scan to the sampling of each channel.
    """
    duration_s = float(time_s[-1] - time_s[0])
    travel = np.concatenate([[0.0], np.cumsum(travel_rate[:-1] * np.diff(time_s))])
    trend = trend_basis(len(volts), trend_order)
    readings = volts.T - (volts.T @ trend) @ trend.T
    half_travel = float(np.ptp(travel)) / 2 or 1.0
    travel = (travel - (travel.min() + travel.max()) / 2) / half_travel
    rate = travel_rate / half_travel
    if np.ptp(rate) <= 1e-9 * abs(rate).max():
        return DetrendedWindow(
            readings, travel[np.newaxis], channel_offset_s * rate[0], half_travel, duration_s, trend
        )
    each = travel + np.outer(channel_offset_s, rate)
    return DetrendedWindow(readings, each, np.zeros(len(channel_offset_s)), half_travel, duration_s, trend)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Inner products of a window with cosine and sine of each harmonic, then with the same times the travel.

    Attributes
    ----------
    phase_rate : float
        Of the fundamental.
    gram : (1 or channels, 4 harmonics, 4 harmonics) float64
        Products of the functions with each other.
    product : (channels, 4 harmonics) float64
        Products of the functions with the readings.
    newest : list
        Newest linearisation, kept by `solve.WaveSolver`.
    """

    phase_rate: float
    n_harmonics: int
    gram: FloatArray
    product: FloatArray
    newest: list[Any] = field(default_factory=list)

    def times_gram(self, on: FloatArray) -> FloatArray:
        """Multiply combinations of the functions (..., functions, starts, channels) by the Gram matrix."""
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

    def phase_rate_sd(self, variance: FloatArray) -> float:
        """Cramer-Rao bound of the phase rate where channels share nothing else, fundamental only."""
        m = 2 * self.n_harmonics
        late = np.zeros_like(self.product)  # derivative by the phase rate, as parts of the functions
        parts = self.phasors()
        late[:, m], late[:, m + 1] = parts[:, 1], -parts[:, 0]
        seen = (self.gram @ late[..., np.newaxis])[..., 0]
        own = np.linalg.solve(self.gram[:, :m, :m], seen[:, :m, np.newaxis])[..., 0]
        information = (late * seen).sum(axis=1) - (own * seen[:, :m]).sum(axis=1)
        return float(1 / np.sqrt(max(float((information / variance).sum()), 1e-12)))

    def explained(self) -> FloatArray:
        """Sum of squares that `phasors` explain in each channel, volts^2: (channels,)."""
        return np.asarray((self.phasors() * self.product[:, : 2 * self.n_harmonics]).sum(axis=1))


def normal_equations(window: DetrendedWindow, phase_rate: float, n_harmonics: int) -> NormalEquations:
    """Normal equations of a window at one phase rate."""
    pause()
    wave = np.exp(1j * phase_rate * window.travel)
    rows = []
    power = np.ones_like(wave)
    for _ in range(n_harmonics):
        power = power * wave
        rows += [power.real, power.imag]
    basis = np.stack(rows, axis=1)  # (groups, 2 harmonics, n)
    basis = np.concatenate([basis, basis * window.travel[:, np.newaxis]], axis=1)
    # The readings are orthogonal to the trend, so removing the trend from the Gram matrix is enough.
    slow = basis @ window.trend
    gram = basis @ basis.swapaxes(1, 2) - slow @ slow.swapaxes(1, 2)
    gram += _RIDGE * window.n / 2 * np.eye(basis.shape[1])
    if len(basis) == 1:
        product = window.volts @ basis[0].T
    else:
        product = (basis @ window.volts[:, :, np.newaxis])[..., 0]
    return NormalEquations(phase_rate, n_harmonics, gram, product)

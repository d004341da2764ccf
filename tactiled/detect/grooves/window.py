"""The scans of one fit, the same without their slow part, and the sums over them that a likelihood needs.

Near one frequency, readings enter the likelihood of a plane wave only through their products with a few
functions of time: cosine and sine of each harmonic, and the same times the distance travelled, which describe
the response to a small change of frequency. Slow polynomials are projected out of readings and functions
alike, which equals fitting them (Frisch, Waugh, Lovell). One pass over the window therefore yields small
normal equations for each channel, and every question about wave vectors, phases and amplitudes is answered
from those.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion
from tactiled.detect.grooves.outcome import Refusal
from tactiled.detect.grooves.params import WaveParams
from tactiled.detect.worker import pause

# prior: part of a channel's readings. A channel with more bad ones is left out of a fit.
_MOST_BAD_PART = 0.05
# derived: no converter reads more. Fourth powers of it, and of its noise, are finite numbers.
_MOST_VOLTS = 1e9
# derived: periods in the window. Lines that are less than this apart cannot be resolved, and removing a line
# or a trend has removed the noise that is nearer, too.
CLEAR_CYCLES = 0.75
# derived: order of the trend that is always removed: level and slope.
STRAIGHT = 1
# derived: ridge as a fraction of a function's sum of squares. Rounding leaves nothing of a line that the
# trend absorbs whole. The ridge changes amplitudes by less than a 30-bit converter can resolve.
_RIDGE = 1e-9
# derived: noise of a 22-bit converter on 3 V, volts^2: a lower bound that keeps the weights of a noiseless
# signal finite.
LEAST_VARIANCE = (1e-6) ** 2 / 12


@dataclass(frozen=True, eq=False)
class FitWindow:
    """Input of a fit: the scans of one window, and what is known of array, motion and grooves."""

    volts: FloatArray  # (n, channels)
    time_s: FloatArray  # (n,): instants at which scans began, evenly spaced or nearly so
    # (channels,): delay from the beginning of a scan to the sampling of each channel
    channel_offset_s: FloatArray
    layout: ChannelLayout
    motion: WaveMotion
    params: WaveParams
    # (n, channels): False for readings to ignore besides those that are not finite or above `_MOST_VOLTS`
    usable: NDArray[np.bool_] | None = None
    # (n,): speed from each scan to the next where it is known and not constant; `motion` then holds the mean
    speeds_mm_s: FloatArray | None = None

    @property
    def duration_s(self) -> float:
        """Time from the first scan to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    def good_readings(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """Readings (n, good channels) with the few bad ones interpolated linearly, and the good channels."""
        usable = np.abs(self.volts) <= _MOST_VOLTS
        if self.usable is not None:
            usable &= self.usable
        chosen = np.flatnonzero(usable.mean(axis=0) >= 1 - _MOST_BAD_PART)
        volts, usable = np.take(self.volts, chosen, axis=1), usable[:, chosen]
        scans = np.arange(len(volts))
        for c in np.flatnonzero(~usable.all(axis=0)):
            good = usable[:, c]
            volts[~good, c] = np.interp(scans[~good], scans[good], volts[good, c])
        return volts, chosen


@dataclass(frozen=True, eq=False)
class DetrendedWindow:
    """The good channels of a window with the slow part removed.

    The travel is the distance travelled, or the time where the speed is unknown, scaled to run from about -1
    to 1 over the window. `half_travel` is what 1 stands for, in millimetres or seconds. A phase rate is in
    radians per unit of the scaled travel: a line of c periods in the window has the phase rate ``pi c``.
    """

    volts: FloatArray  # (channels, n): orthogonal to `trend`
    travel: FloatArray  # (1 or channels, n): one row where the speed is constant, else a row for each channel
    # (channels,): distance travelled between the instant that `travel` states and the sampling of each
    # channel
    skew: FloatArray
    half_travel: float
    duration_s: float
    trend: FloatArray  # (n, terms): orthonormal columns: polynomials, and lines that were removed
    layout: ChannelLayout  # of these channels, about their centre
    motion: WaveMotion
    params: WaveParams
    removed: tuple[float, ...] = ()  # phase rates of lines that were removed

    @property
    def n(self) -> int:
        """Number of scans."""
        return len(self.trend)

    @cached_property
    def power(self) -> FloatArray:
        """Sum of squares of each channel, volts^2: (channels,)."""
        return np.asarray(np.einsum("cn,cn->c", self.volts, self.volts))

    @cached_property
    def without_speed(self) -> "DetrendedWindow":
        """A copy in which the speed is unknown."""
        return replace(self, motion=self.motion.without_speed)

    def without_lines(self, phase_rate: float, multiples: Iterable[float]) -> "DetrendedWindow":
        """A copy in which the lines at multiples of a phase rate are part of the trend."""
        phase_rates = [phase_rate * multiple for multiple in multiples]
        angle = np.outer(self.travel.mean(axis=0), phase_rates)
        left = self._without(np.concatenate([np.cos(angle), np.sin(angle)], axis=1))
        return replace(left, removed=(*self.removed, *phase_rates))

    def is_removed(self, phase_rate: float) -> bool:
        """Return True next to a removed line, where the window holds no information."""
        return any(abs(phase_rate - other) < np.pi * CLEAR_CYCLES for other in self.removed)

    def clear_harmonics(self, phase_rate: float, most: int) -> int:
        """Number of harmonics, `most` at most, below the first that is next to a removed line."""
        return next((h - 1 for h in range(2, most + 1) if self.is_removed(h * phase_rate)), most)

    @cached_property
    def curved(self) -> "DetrendedWindow":
        """A copy in which polynomials of up to the permitted order are part of the trend."""
        return self._without(trend_basis(self.n, self.params.trend_order)[:, STRAIGHT + 1 :])

    def _without(self, functions: FloatArray) -> "DetrendedWindow":
        trend = np.linalg.qr(np.concatenate([self.trend, functions], axis=1))[0]
        volts = self.volts - (self.volts @ trend) @ trend.T
        return replace(self, volts=volts, trend=np.asarray(trend))

    @cached_property
    def tie(self) -> FloatArray:
        """Phase rate per unit of the wave vector, where the motion is known; else zeros: (2,)."""
        return self.half_travel * self.motion.heading * float(self.motion.has_speed)

    def psi(self, k: FloatArray, phase_rate: FloatArray) -> FloatArray:
        """Phase of waves (waves, 2) of some phase rates (waves,) at each channel: (waves, channels)."""
        return np.asarray(k @ self.layout.xy_mm.T + phase_rate[:, np.newaxis] * self.skew)

    def frequency_hz(self, phase_rate: float) -> float:
        """Mean frequency of a phase rate."""
        return phase_rate / np.pi / self.duration_s

    @cached_property
    def largest_step(self) -> float:
        """Largest scaled distance between two scans."""
        return float(np.diff(self.travel[0]).max())

    def equations(self, phase_rate: float, n_harmonics: int = 1) -> "NormalEquations":
        """Normal equations of the harmonics of one phase rate."""
        pause()
        wave = np.exp(1j * phase_rate * self.travel)
        rows = []
        power = np.ones_like(wave)
        for _ in range(n_harmonics):
            power = power * wave
            rows += [power.real, power.imag]
        basis = np.stack(rows, axis=1)  # (groups, 2 harmonics, n)
        basis = np.concatenate([basis, basis * self.travel[:, np.newaxis]], axis=1)
        # The readings are orthogonal to the trend, so removing the trend from the Gram matrix is enough.
        slow = basis @ self.trend
        gram = basis @ basis.swapaxes(1, 2) - slow @ slow.swapaxes(1, 2)
        gram += _RIDGE * self.n / 2 * np.eye(basis.shape[1])
        if len(basis) == 1:
            product = self.volts @ basis[0].T
        else:
            product = (basis @ self.volts[:, :, np.newaxis])[..., 0]
        return NormalEquations(phase_rate, n_harmonics, gram, product, self)


@lru_cache(maxsize=16)  # windows that have their full length ask for the same few
def trend_basis(n: int, order: int) -> FloatArray:
    """Orthonormal polynomials of up to `order` on n even steps: (n, order + 1), read-only."""
    steps = np.linspace(-1.0, 1.0, n)
    basis = np.asarray(np.linalg.qr(np.polynomial.legendre.legvander(steps, order))[0])
    basis.flags.writeable = False
    return basis


def detrended(window: FitWindow) -> DetrendedWindow | Refusal:
    """Remove level and slope from the readings of the good channels, and scale the distance travelled."""
    n, params, motion = len(window.volts), window.params, window.motion
    if n <= params.trend_order + 4 * params.max_harmonics + 1:
        return Refusal("too-few-periods")
    readings, chosen = window.good_readings()
    if not len(chosen):
        return Refusal("saturated")
    rate = np.full(n, motion.speed_mm_s if motion.has_speed else 1.0)
    if window.speeds_mm_s is not None and motion.has_speed:
        rate = window.speeds_mm_s
    travel = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(window.time_s))])
    half_travel = float(np.ptp(travel)) / 2 or 1.0
    travel = (travel - (travel.min() + travel.max()) / 2) / half_travel
    rate, offset_s = rate / half_travel, window.channel_offset_s[chosen]
    if np.ptp(rate) <= 1e-9 * abs(rate).max():
        travel, skew = travel[np.newaxis], offset_s * rate[0]
    else:
        travel, skew = travel + np.outer(offset_s, rate), np.zeros(len(chosen))
    trend = trend_basis(n, STRAIGHT)
    volts = readings.T - (readings.T @ trend) @ trend.T
    layout = window.layout.centred(chosen)
    return DetrendedWindow(volts, travel, skew, half_travel, window.duration_s, trend, layout, motion, params)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Products of a window with cosine and sine of each harmonic, then with the same times the travel."""

    phase_rate: float  # of the fundamental
    n_harmonics: int
    gram: FloatArray  # (1 or channels, 4 harmonics, 4 harmonics): products of the functions with each other
    product: FloatArray  # (channels, 4 harmonics): products of the functions with the readings
    window: DetrendedWindow

    def times_gram(self, on: FloatArray) -> FloatArray:
        """Multiply combinations of the functions (..., functions, starts, channels) by the Gram matrix."""
        if len(self.gram) > 1:
            return np.asarray(np.einsum("cef,...fsc->...esc", self.gram, on))
        return np.asarray((self.gram[0] @ on.reshape(*on.shape[:-2], -1)).reshape(on.shape))

    @cached_property
    def parts(self) -> FloatArray:
        """Least-squares cosine and sine parts of each channel by itself: (channels, 2 harmonics)."""
        m = 2 * self.n_harmonics
        if len(self.gram) == 1:
            return np.asarray(np.linalg.solve(self.gram[0, :m, :m], self.product[:, :m].T).T)
        return np.asarray(np.linalg.solve(self.gram[:, :m, :m], self.product[:, :m, np.newaxis])[..., 0])

    def phasors(self, harmonic: int = 1) -> NDArray[np.complex128]:
        """Complex amplitude of one harmonic in each channel, corrected for scan skew: (channels,)."""
        late = np.exp(-1j * harmonic * self.phase_rate * self.window.skew)
        return np.asarray((self.parts[:, 2 * harmonic - 2] - 1j * self.parts[:, 2 * harmonic - 1]) * late)

    @cached_property
    def explained(self) -> FloatArray:
        """Sum of squares that `parts` explain in each channel, volts^2: (channels,)."""
        return np.asarray((self.parts * self.product[:, : 2 * self.n_harmonics]).sum(axis=1))

    @cached_property
    def variance(self) -> FloatArray:
        """Variance of the residual of each channel's own fit, volts^2: (channels,)."""
        window = self.window
        n_free = max(window.n - window.trend.shape[1] - 2 * self.n_harmonics, 1)
        return np.asarray(np.maximum((window.power - self.explained) / n_free, LEAST_VARIANCE))

    def own_phase_rate(self, variance: FloatArray) -> tuple[float, float]:
        """Phase rate where channels share nothing else, by a Gauss-Newton step, and its Cramer-Rao bound."""
        m, times = 2 * self.n_harmonics, np.arange(1.0, self.n_harmonics + 1)
        late = np.zeros_like(self.product)  # derivative by the phase rate, as parts of the functions
        late[:, m::2], late[:, m + 1 :: 2] = times * self.parts[:, 1::2], -times * self.parts[:, ::2]
        seen = (self.gram @ late[..., np.newaxis])[..., 0]
        own = np.linalg.solve(self.gram[:, :m, :m], seen[:, :m, np.newaxis])[..., 0]
        information = (late * seen).sum(axis=1) - (own * seen[:, :m]).sum(axis=1)
        total = max(float((information / variance).sum()), 1e-12)
        left = self.product[:, m:] - (self.gram[:, m:, :m] @ self.parts[..., np.newaxis])[..., 0]
        pull = float(((late[:, m:] * left).sum(axis=1) / variance).sum())
        return self.phase_rate + pull / total, float(1 / np.sqrt(total))

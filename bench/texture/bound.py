"""How well anybody could know a grating: the Cramer-Rao bound of a plane wave seen by an array.

The model, with phases in turns of the groove pattern: a channel c at (x, y), sampled at the instant t, reads

    level_c + drift_c t + sum over h of A_ch cos(2 pi h s + psi_kh) + white noise of sigma_c
    s = ((x + v t cos(theta)) cos(a) + (y + v t sin(theta)) sin(a)) / D

for a period D, an angle a of the groove normal, a speed v along theta, and harmonics h = 1, 2, ... Unknown,
besides D, a and (where nobody gives it) v: level, drift and amplitudes of each channel, and a phase psi for
each harmonic and kind k of channel (R1 of all taxels, R2 of all, ...), since the four sides of a bump meet a
ridge at different times but taxels are alike.

With G the derivatives of all readings by the parameters over sigma, the Fisher information is ``G' G`` and no
unbiased estimator has a covariance below its inverse (Kay, Fundamentals of Statistical Signal Processing I,
chapter 3). What belongs to one channel only is projected out channel by channel (the Schur complement), so
that what is left to invert has a row for D, a, v and each psi. Nothing here is shared with the estimators.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array

FloatArray = NDArray[np.float64]
# A direction with less information than this part of the largest is not observed: rounding makes 1e-16.
_UNOBSERVED = 1e-11


@dataclass(frozen=True)
class Wave:
    """A grating and the slide over it.

    Attributes
    ----------
    direction_deg : float
        Of the skin's motion, from +x towards +y.
    """

    period_mm: float
    angle_deg: float
    speed_mm_s: float
    direction_deg: float = 0.0

    @property
    def frequency_hz(self) -> float:
        """Of the ripple; negative where the skin runs against the groove normal."""
        across = np.cos(np.radians(self.direction_deg - self.angle_deg))
        return float(self.speed_mm_s * across / self.period_mm)


@dataclass(frozen=True, eq=False)
class Sensed:
    """What an array makes of a wave.

    Attributes
    ----------
    x_mm, y_mm, offset_s : (channels,) float64
        Where each channel is, and how long after the scan began it is sampled.
    kind : (channels,) int64
        Channels of one number share their phases.
    amplitude_volts : (channels, harmonics) float64
    phase_rad : (kinds, harmonics) float64
    noise_volts : (channels,) float64
        Sigma of the white noise.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    offset_s: FloatArray
    kind: NDArray[np.int64]
    amplitude_volts: FloatArray
    phase_rad: FloatArray
    noise_volts: FloatArray


@dataclass(frozen=True)
class Bound:
    """Least standard deviations of unbiased estimators; infinite for what the array cannot tell."""

    period_sd_mm: float
    angle_sd_deg: float
    speed_sd_mm_s: float


def kinds_of(array: Array) -> NDArray[np.int64]:
    """Number of each channel's kind: those of equal kind and azimuth share one."""
    azimuth = np.nan_to_num(array.azimuth_deg, nan=-1.0)
    names = list(zip(array.channel_kind, azimuth.tolist(), strict=True))
    return np.array([sorted(set(names)).index(name) for name in names], dtype=np.int64)


def turns(wave: Wave, sensed: Sensed, time_s: FloatArray) -> FloatArray:
    """Groove phase in turns (n, channels) at scans that begin at `time_s` (n,)."""
    x, y = _places(wave, sensed, time_s)
    angle = np.radians(wave.angle_deg)
    return np.asarray((x * np.cos(angle) + y * np.sin(angle)) / wave.period_mm)


def bound(wave: Wave, sensed: Sensed, time_s: FloatArray, *, is_speed_known: bool, n_drift: int = 2) -> Bound:
    """The bound for one window.

    Parameters
    ----------
    time_s : (n,) float64
        Instants at which the scans began.
    is_speed_known : bool
    n_drift : int
        Unknown terms of each channel's drift: 0 for none, 1 for its level, 2 for a straight line.
    """
    # Both origins are free, since phases are: near the middle the numbers are of one size.
    time_s = time_s - time_s.mean()
    x, y = _places(wave, sensed, time_s)
    angle, theta = np.radians(wave.angle_deg), np.radians(wave.direction_deg)
    phase = 2 * np.pi * turns(wave, sensed, time_s)
    by_period = -phase / wave.period_mm
    by_angle = 2 * np.pi * (y * np.cos(angle) - x * np.sin(angle)) / wave.period_mm
    by_speed = 2 * np.pi * (time_s[:, None] + sensed.offset_s) * np.cos(theta - angle) / wave.period_mm
    shared = [by_period, by_angle] if is_speed_known else [by_period, by_angle, by_speed]
    n_kinds, n_harmonics = sensed.phase_rad.shape
    order = np.arange(1, n_harmonics + 1)
    n_wave = len(shared)
    information = np.zeros((n_wave + n_kinds * n_harmonics,) * 2)
    for c, kind in enumerate(sensed.kind):
        own_phase = phase[:, c, None] * order + sensed.phase_rad[kind]
        swing = -sensed.amplitude_volts[c] * np.sin(own_phase)  # by the phase of each harmonic
        columns = np.zeros((len(time_s), len(information)))
        columns[:, :n_wave] = (swing @ order)[:, None] * np.stack([part[:, c] for part in shared], axis=1)
        columns[:, n_wave + kind * n_harmonics + np.arange(n_harmonics)] = swing
        own = np.column_stack([np.vander(time_s, n_drift), np.cos(own_phase)])
        basis, _ = np.linalg.qr(own)
        columns -= basis @ (basis.T @ columns)
        information += columns.T @ columns / sensed.noise_volts[c] ** 2
    period_sd, angle_sd, *speed_sd = _sigmas(information, n_wave)
    return Bound(period_sd, float(np.degrees(angle_sd)), speed_sd[0] if speed_sd else 0.0)


def _places(wave: Wave, sensed: Sensed, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where on the plate each reading is taken, mm: (n, channels) each; the array's middle at its origin."""
    theta = np.radians(wave.direction_deg)
    way_mm = wave.speed_mm_s * (time_s[:, None] + sensed.offset_s)
    return (
        sensed.x_mm - sensed.x_mm.mean() + way_mm * np.cos(theta),
        sensed.y_mm - sensed.y_mm.mean() + way_mm * np.sin(theta),
    )


def _sigmas(information: FloatArray, n_wave: int) -> list[float]:
    """Roots of the first diagonal entries of the inverse; infinite where it has none."""
    size = np.sqrt(np.diag(information))
    used = size > 0  # a kind of dead channels tells nothing of its phase, which nobody asks for
    scaled = information[np.ix_(used, used)] / np.outer(size[used], size[used])
    value, vector = np.linalg.eigh(scaled)
    seen = value > _UNOBSERVED * value[-1]
    variance = np.full(len(information), np.inf)
    variance[used] = (vector[:, seen] ** 2 / value[seen]).sum(axis=1) / size[used] ** 2
    is_open = np.zeros(len(information), dtype=np.bool_)
    is_open[used] = (np.abs(vector[:, ~seen]) > 1e-6).any(axis=1)  # it leans on what is not observed
    return [float("inf") if is_open[k] else float(np.sqrt(variance[k])) for k in range(n_wave)]

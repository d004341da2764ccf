"""Readings of an array that slides over a grating, and how well anybody could know the grating from them.

The model is a plane wave, with phases in turns of the groove pattern: a channel c at (x, y), sampled at the
instant t, reads

    level_c + drift_c t + A_c cos(2 pi s + psi_k) + white noise of sigma
    s = ((x + v t cos(theta)) cos(a) + (y + v t sin(theta)) sin(a)) / D

for a period D, an angle a of the groove normal, and a speed v along theta. Unknown, besides D, a and (where
it is not given) v: level, drift and amplitude of each channel, and a phase psi for each kind k of channel (R1
of all taxels, R2 of all, ...), since the four sides of a bump meet a ridge at different times but taxels are
alike.

`bound` is the Cramer-Rao bound of this model. With G the derivatives of all readings by the parameters over
sigma, the Fisher information is ``G' G`` and no unbiased estimator has a covariance below its inverse (Kay,
Fundamentals of Statistical Signal Processing I, chapter 3). The parameters of one channel are projected out
channel by channel (the Schur complement), so that what is left to invert has a row for D, a, v and each psi.
Nothing here is shared with the estimators.

Gratings are drawn, not listed: `draw_grating` takes the window and the noise of a cell of the grid, while
period, angle, speed, direction, phases and drifts are anywhere, so that no estimator can be tuned to the
numbers of the grid.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray, load_array

ARRAY = load_array("wang2019-3x3")
RATE_HZ = 100.0  # the board's
LEVEL_VOLTS = 1.2  # of a hold of 20 N
AMPLITUDE_VOLTS = 0.02  # of the ripple at 1.2 mm: the paper's curves
PERIODS_MM = (0.6, 6.0)
ANGLES_DEG = (-75.0, 75.0)
_SPEEDS_MM_S = (0.5, 10.0)  # quasi-static slides and faster ones
_DIRECTIONS_DEG = (-20.0, 20.0)  # of the skin's motion
_MOST_HZ = 20.0  # faster ripples are not drawn: the published procedure looks no further
_LARGEST_DRIFT = 0.5  # of the ripple's amplitude a second
_CHANNEL_STEP_S = 100e-6  # from channel to channel of the multiplexer
# A direction with less information than this part of the largest is not observed: rounding makes 1e-16.
_UNOBSERVED = 1e-11


@dataclass(frozen=True)
class Wave:
    """A grating and the slide over it; `direction_deg` is that of the skin's motion, from +x towards +y."""

    period_mm: float
    angle_deg: float
    speed_mm_s: float
    direction_deg: float = 0.0

    @property
    def frequency_hz(self) -> float:
        """Frequency of the ripple; negative where the skin runs against the groove normal."""
        across = np.cos(np.radians(self.direction_deg - self.angle_deg))
        return float(self.speed_mm_s * across / self.period_mm)


@dataclass(frozen=True, eq=False)
class ArrayResponse:
    """Places, phases and noise with which the channels of an array sense a wave."""

    # x_mm, y_mm, offset_s: (channels,): place of each channel, and how long after the scan began it is
    # sampled
    x_mm: FloatArray
    y_mm: FloatArray
    offset_s: FloatArray
    kind: NDArray[np.int64]  # (channels,): channels of one number share their phases
    phase_rad: FloatArray  # (kinds,)
    amplitude_volts: float
    noise_volts: float  # sigma of the white noise


class Bound(NamedTuple):
    """Least standard deviations of unbiased estimators; infinite for what the array cannot tell."""

    period_sd_mm: float
    angle_sd_deg: float


@dataclass(frozen=True, eq=False)
class Grating:
    """One window over one grating."""

    wave: Wave
    sensed: ArrayResponse
    drift: FloatArray  # (channels, 2): level (volts) and slope (volts a second) of each channel
    time_s: FloatArray  # (n,): instants at which the scans began

    @property
    def periods(self) -> float:
        """Number of periods of the ripple in the window."""
        return abs(self.wave.frequency_hz) * len(self.time_s) / RATE_HZ


def sensed_by(rng: np.random.Generator, snr_db: float) -> ArrayResponse:
    """Response of the array, whose channels all ripple alike, each kind at a phase of its own.

    The signal-to-noise ratio is ``10 log10(amplitude^2 / (2 sigma^2))`` of each channel.
    """
    _, kind = np.unique(ARRAY.azimuth_deg, return_inverse=True)
    return ArrayResponse(
        x_mm=ARRAY.x_mm[ARRAY.channel_taxel],
        y_mm=ARRAY.y_mm[ARRAY.channel_taxel],
        offset_s=_CHANNEL_STEP_S * np.arange(ARRAY.n_channels, dtype=np.float64),
        kind=kind,
        phase_rad=rng.uniform(-np.pi, np.pi, kind.max() + 1),
        amplitude_volts=AMPLITUDE_VOLTS,
        noise_volts=float(AMPLITUDE_VOLTS / np.sqrt(2 * 10 ** (snr_db / 10))),
    )


def draw_wave(rng: np.random.Generator) -> Wave:
    """Draw a grating, and a slide that the board can follow, 75 degrees or less from its normal."""
    while True:
        wave = Wave(
            period_mm=float(np.exp(rng.uniform(*np.log(PERIODS_MM)))),
            angle_deg=float(rng.uniform(*ANGLES_DEG)),
            speed_mm_s=float(np.exp(rng.uniform(*np.log(_SPEEDS_MM_S)))),
            direction_deg=float(rng.uniform(*_DIRECTIONS_DEG)),
        )
        tilt_deg = abs(wave.angle_deg - wave.direction_deg)
        if tilt_deg <= ANGLES_DEG[1] and abs(wave.frequency_hz) < _MOST_HZ:
            return wave


def draw_grating(
    rng: np.random.Generator, window_s: float, snr_db: float, min_periods: float = 0.0
) -> Grating:
    """Draw a window with at least so many periods."""
    wave = draw_wave(rng)
    while abs(wave.frequency_hz) < min_periods / window_s:
        wave = draw_wave(rng)
    sensed = sensed_by(rng, snr_db)
    slope = _LARGEST_DRIFT * AMPLITUDE_VOLTS * rng.uniform(-1, 1, ARRAY.n_channels)
    level = LEVEL_VOLTS * rng.uniform(0.9, 1.1, ARRAY.n_channels)
    return Grating(wave, sensed, np.column_stack([level, slope]), scan_times_s(window_s))


def scan_times_s(window_s: float) -> FloatArray:
    """Instants at which the scans of a window began."""
    return np.arange(round(window_s * RATE_HZ)) / RATE_HZ


def readings(grating: Grating, rng: np.random.Generator) -> FloatArray:
    """Volts (n, channels): drift, wave and white noise."""
    sensed, time_s = grating.sensed, grating.time_s
    ripple = wave_volts(grating.wave, sensed, time_s)
    volts = grating.drift[:, 0] + np.outer(time_s, grating.drift[:, 1]) + ripple
    return np.asarray(volts + sensed.noise_volts * rng.standard_normal(volts.shape))


def wave_volts(wave: Wave, sensed: ArrayResponse, time_s: FloatArray) -> FloatArray:
    """Ripple alone, (n, channels)."""
    phase = 2 * np.pi * turns(wave, sensed, time_s) + sensed.phase_rad[sensed.kind]
    return np.asarray(sensed.amplitude_volts * np.cos(phase))


def turns(wave: Wave, sensed: ArrayResponse, time_s: FloatArray) -> FloatArray:
    """Groove phase in turns (n, channels) at scans that begin at `time_s` (n,)."""
    x, y = _places(wave, sensed, time_s)
    angle = np.radians(wave.angle_deg)
    return np.asarray((x * np.cos(angle) + y * np.sin(angle)) / wave.period_mm)


def bound(wave: Wave, sensed: ArrayResponse, time_s: FloatArray, *, is_speed_known: bool) -> Bound:
    """Cramer-Rao bound of one window, whose scans began at `time_s` (n,)."""
    # Both origins are free, since phases are: near the middle the numbers are of one size.
    time_s = time_s - time_s.mean()
    x, y = _places(wave, sensed, time_s)
    angle, theta = np.radians(wave.angle_deg), np.radians(wave.direction_deg)
    phase = 2 * np.pi * turns(wave, sensed, time_s)
    by_period = -phase / wave.period_mm
    by_angle = 2 * np.pi * (y * np.cos(angle) - x * np.sin(angle)) / wave.period_mm
    by_speed = 2 * np.pi * (time_s[:, None] + sensed.offset_s) * np.cos(theta - angle) / wave.period_mm
    shared = [by_period, by_angle] if is_speed_known else [by_period, by_angle, by_speed]
    n_wave = len(shared)
    information = np.zeros((n_wave + len(sensed.phase_rad),) * 2)
    for c, kind in enumerate(sensed.kind):
        own_phase = phase[:, c] + sensed.phase_rad[kind]
        swing = -sensed.amplitude_volts * np.sin(own_phase)  # by the phase
        columns = np.zeros((len(time_s), len(information)))
        columns[:, :n_wave] = swing[:, None] * np.stack([part[:, c] for part in shared], axis=1)
        columns[:, n_wave + kind] = swing
        basis, _ = np.linalg.qr(np.column_stack([np.vander(time_s, 2), np.cos(own_phase)]))
        columns -= basis @ (basis.T @ columns)
        information += columns.T @ columns / sensed.noise_volts**2
    period_sd, angle_sd = _sigmas(information)
    return Bound(period_sd, float(np.degrees(angle_sd)))


def _places(wave: Wave, sensed: ArrayResponse, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places on the plate (mm) where readings are taken, (n, channels) each; origin in the array's middle."""
    theta = np.radians(wave.direction_deg)
    way_mm = wave.speed_mm_s * (time_s[:, None] + sensed.offset_s)
    return (
        sensed.x_mm - sensed.x_mm.mean() + way_mm * np.cos(theta),
        sensed.y_mm - sensed.y_mm.mean() + way_mm * np.sin(theta),
    )


def _sigmas(information: FloatArray) -> list[float]:
    """Roots of the first two diagonal entries of the inverse; infinite where it has none."""
    size = np.sqrt(np.diag(information))
    value, vector = np.linalg.eigh(information / np.outer(size, size))
    seen = value > _UNOBSERVED * value[-1]
    variance = (vector[:, seen] ** 2 / value[seen]).sum(axis=1) / size**2
    is_open = (np.abs(vector[:, ~seen]) > 1e-6).any(axis=1)  # it depends on what is not observed
    return [float("inf") if is_open[k] else float(np.sqrt(variance[k])) for k in range(2)]

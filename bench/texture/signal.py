"""Readings of an array over grooves, with their truth: the model of `texture_bound` and nothing else.

Cases are drawn, not listed: window and noise are the cells of the grid, while period, angle, speed,
direction, phases and drifts are anywhere, so that no estimator can be at home on the grid's own numbers.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from bench.texture.bound import FloatArray, Sensed, Wave, kinds_of, turns
from tactiled.array import Array

RATE_HZ = 100.0  # the board's
LEVEL_VOLTS = 1.2  # of a hold of 20 N
AMPLITUDE_VOLTS = 0.02  # of the ripple at 1.2 mm: the paper's curves
PERIODS_MM = (0.6, 6.0)
ANGLES_DEG = (-75.0, 75.0)
SPEEDS_MM_S = (0.5, 10.0)  # quasi-static slides and faster ones
DIRECTIONS_DEG = (-20.0, 20.0)  # of the skin's motion
_MOST_HZ = 20.0  # faster ripples are not drawn: the published procedure looks no further
_LARGEST_DRIFT = 0.5  # of the ripple's amplitude a second
CHANNEL_STEP_S = 100e-6  # from channel to channel of the multiplexer


@dataclass(frozen=True, eq=False)
class Case:
    """One window over one grating.

    Attributes
    ----------
    drift : (channels, 2) float64
        Level (volts) and slope (volts a second) of each channel.
    time_s : (n,) float64
        Instants at which the scans began.
    """

    wave: Wave
    sensed: Sensed
    drift: FloatArray
    time_s: FloatArray

    @property
    def periods(self) -> float:
        """How many periods of the ripple are in the window."""
        return abs(self.wave.frequency_hz) * len(self.time_s) / RATE_HZ


def sensed_by(array: Array, rng: np.random.Generator, snr_db: float, harmonics: tuple[float, ...]) -> Sensed:
    """An array whose channels all ripple alike, each kind at a phase of its own.

    Parameters
    ----------
    snr_db : float
        Of each channel: ``10 log10(amplitude^2 / (2 sigma^2))`` of the fundamental.
    harmonics : tuple of float
        Amplitudes of 2nd, 3rd, ... over the first.
    """
    kind = kinds_of(array)
    n_harmonics = 1 + len(harmonics)
    return Sensed(
        x_mm=array.x_mm[array.channel_taxel],
        y_mm=array.y_mm[array.channel_taxel],
        offset_s=CHANNEL_STEP_S * np.arange(array.n_channels, dtype=np.float64),
        kind=kind,
        amplitude_volts=np.tile(AMPLITUDE_VOLTS * np.array([1.0, *harmonics]), (array.n_channels, 1)),
        phase_rad=rng.uniform(-np.pi, np.pi, (kind.max() + 1, n_harmonics)),
        noise_volts=np.full(array.n_channels, AMPLITUDE_VOLTS / np.sqrt(2 * 10 ** (snr_db / 10))),
    )


def draw_wave(rng: np.random.Generator) -> Wave:
    """Any grating of the grid, and a slide that the board can follow, 75 degrees or less from its normal."""
    while True:
        wave = Wave(
            period_mm=float(np.exp(rng.uniform(*np.log(PERIODS_MM)))),
            angle_deg=float(rng.uniform(*ANGLES_DEG)),
            speed_mm_s=float(np.exp(rng.uniform(*np.log(SPEEDS_MM_S)))),
            direction_deg=float(rng.uniform(*DIRECTIONS_DEG)),
        )
        tilt_deg = abs(wave.angle_deg - wave.direction_deg)
        if tilt_deg <= ANGLES_DEG[1] and abs(wave.frequency_hz) < _MOST_HZ:
            return wave


def draw_case(
    array: Array,
    rng: np.random.Generator,
    window_s: float,
    snr_db: float,
    min_periods: float = 0.0,
    most_hz: float = _MOST_HZ,
) -> Case:
    """A case of a cell of the grid, with so many periods in the window or more, and no faster ripple."""
    wave = draw_wave(rng)
    while not min_periods / window_s <= abs(wave.frequency_hz) < most_hz:
        wave = draw_wave(rng)
    sensed = sensed_by(array, rng, snr_db, ())
    slope = _LARGEST_DRIFT * AMPLITUDE_VOLTS * rng.uniform(-1, 1, array.n_channels)
    level = LEVEL_VOLTS * rng.uniform(0.9, 1.1, array.n_channels)
    time_s = np.arange(round(window_s * RATE_HZ)) / RATE_HZ
    return Case(wave, sensed, np.column_stack([level, slope]), time_s)


def readings(case: Case, rng: np.random.Generator, memory: float = 0.0) -> FloatArray:
    """Volts (n, channels): drift, wave and noise.

    Parameters
    ----------
    memory : float
        What noise keeps from scan to scan, an autoregression of order 1 of each channel; 0 is white.
    """
    sensed, time_s = case.sensed, case.time_s
    volts = case.drift[:, 0] + np.outer(time_s, case.drift[:, 1]) + wave_volts(case.wave, sensed, time_s)
    noise = rng.standard_normal(volts.shape)
    if memory:
        fresh = np.sqrt(1 - memory**2)
        noise[1:] *= fresh  # the first is drawn from the steady state, so that all have one variance
        noise = lfilter([1.0], [1.0, -memory], noise, axis=0)
    return np.asarray(volts + sensed.noise_volts * noise)


def wave_volts(wave: Wave, sensed: Sensed, time_s: FloatArray) -> FloatArray:
    """The ripple alone, (n, channels)."""
    phase = 2 * np.pi * turns(wave, sensed, time_s)
    order = np.arange(1, sensed.amplitude_volts.shape[1] + 1)
    own = phase[..., None] * order + sensed.phase_rad[sensed.kind]
    return np.asarray((sensed.amplitude_volts * np.cos(own)).sum(axis=-1))

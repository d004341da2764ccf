"""A window over a grating, while it is being made: what `texture_plates` spoils."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.texture.bound import FloatArray, Sensed, Wave
from bench.texture.signal import LEVEL_VOLTS, RATE_HZ, sensed_by
from tactiled.array import Array

SNR_DB = 30.0  # 20 mV of ripple over 0.45 mV of noise: the emulated board has 0.3
SPEED_MM_S = 1.5
RANGE_VOLTS = 3.0  # of the converter
_PERIODS_MM = (0.9, 2.0)
_ANGLES_DEG = (-60.0, 60.0)


@dataclass(eq=False)
class Window:
    """A window while it is being made.

    Attributes
    ----------
    travel_mm : (n, channels) float64
        Way of the skin along the motion when each reading is taken; the window's middle at 0.
    added_volts : (n, channels) float64
        On top of level, ripple and noise.
    bend_mm : float
        Radius of the grooves; infinite is straight.
    wander : callable or None
        Place along the groove normal (turns) to what is added to it.
    given_mm_s : list of (scan, mm/s)
        Speeds that the estimator is told, from which scan on.
    beside : Wave or None
        Another grating under the skin, whose ripple is in `added_volts`.
    """

    wave: Wave
    sensed: Sensed
    time_s: FloatArray
    travel_mm: FloatArray
    added_volts: FloatArray
    valid: NDArray[np.bool_]
    given_mm_s: list[tuple[int, float]]
    phase_off_rad: FloatArray
    level_volts: FloatArray
    bend_mm: float = np.inf
    wander: Callable[[FloatArray], FloatArray] | None = None
    beside: Wave | None = None

    def turns(self, wave: Wave) -> FloatArray:
        """Phase of a grating, bent as the window's are, under each reading: (n, channels)."""
        sensed, angle, theta = self.sensed, np.radians(wave.angle_deg), np.radians(wave.direction_deg)
        x = sensed.x_mm - sensed.x_mm.mean() + self.travel_mm * np.cos(theta)
        y = sensed.y_mm - sensed.y_mm.mean() + self.travel_mm * np.sin(theta)
        across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        return np.asarray((across + along**2 / (2 * self.bend_mm)) / wave.period_mm)

    def volts(self, rng: np.random.Generator) -> FloatArray:
        """Readings (n, channels), clipped to the converter's range."""
        sensed, phase = self.sensed, self.turns(self.wave)
        if self.wander is not None:
            phase = phase + self.wander(phase)
        order = np.arange(1, sensed.amplitude_volts.shape[1] + 1)
        own = (2 * np.pi * phase + self.phase_off_rad)[..., None] * order + sensed.phase_rad[sensed.kind]
        ripple = (sensed.amplitude_volts * np.cos(own)).sum(axis=-1)
        noise = sensed.noise_volts * rng.standard_normal(ripple.shape)
        volts = self.level_volts + ripple + self.added_volts + noise
        return np.asarray(np.clip(volts, 0.0, RANGE_VOLTS))


def perfect(array: Array, rng: np.random.Generator, window_s: float, snr_db: float = SNR_DB) -> Window:
    """A window that the model describes, over any grating of moderate period."""
    wave = Wave(float(rng.uniform(*_PERIODS_MM)), float(rng.uniform(*_ANGLES_DEG)), SPEED_MM_S, 0.0)
    sensed = sensed_by(array, rng, snr_db, ())
    time_s = np.arange(round(window_s * RATE_HZ)) / RATE_HZ
    shape = (len(time_s), array.n_channels)
    return Window(
        wave=wave,
        sensed=sensed,
        time_s=time_s,
        travel_mm=SPEED_MM_S * (time_s[:, None] - time_s.mean() + sensed.offset_s),
        added_volts=np.zeros(shape),
        valid=np.ones(shape, dtype=np.bool_),
        given_mm_s=[(0, SPEED_MM_S)],
        phase_off_rad=np.zeros(array.n_channels),
        level_volts=LEVEL_VOLTS * rng.uniform(0.9, 1.1, array.n_channels),
    )

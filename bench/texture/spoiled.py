"""Windows over a grating that break the wave model, each in one known way.

`model_window` is a window that the model describes. Each entry of `MISFITS` spoils it. `GROOVELESS` are
windows without a grating, over which the only right answer is a refusal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench.texture.signal import (
    AMPLITUDE_VOLTS,
    LEVEL_VOLTS,
    RATE_HZ,
    ArrayResponse,
    Wave,
    scan_times_s,
    sensed_by,
)
from tactiled.array import Array, FloatArray

SNR_DB = 30.0  # 20 mV of ripple over 0.45 mV of noise: the emulated board has 0.3
SPEED_MM_S = 1.5
RANGE_VOLTS = 3.0  # of the converter
_PERIODS_MM = (0.9, 2.0)
_ANGLES_DEG = (-60.0, 60.0)


@dataclass(eq=False)
class SpoiledWindow:
    """A window while it is being made."""

    wave: Wave
    sensed: ArrayResponse
    time_s: FloatArray
    # (n, channels): way of the skin along the motion when each reading is taken; the window's middle at 0
    travel_mm: FloatArray
    added_volts: FloatArray  # (n, channels): on top of level, ripple and noise
    # (scan, mm/s): speeds that the estimator is given, from which scan on
    given_mm_s: list[tuple[int, float]]
    phase_off_rad: FloatArray
    level_volts: FloatArray
    bend_mm: float = np.inf  # radius of the grooves; infinite is straight
    # place along the groove normal (turns) to what is added to it
    wander: Callable[[FloatArray], FloatArray] | None = None

    def turns(self) -> FloatArray:
        """Groove phase under each reading (n, channels)."""
        sensed, wave = self.sensed, self.wave
        angle, theta = np.radians(wave.angle_deg), np.radians(wave.direction_deg)
        x = sensed.x_mm - sensed.x_mm.mean() + self.travel_mm * np.cos(theta)
        y = sensed.y_mm - sensed.y_mm.mean() + self.travel_mm * np.sin(theta)
        across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        return np.asarray((across + along**2 / (2 * self.bend_mm)) / wave.period_mm)

    def volts(self, rng: np.random.Generator) -> FloatArray:
        """Readings (n, channels), clipped to the converter's range."""
        sensed, phase = self.sensed, self.turns()
        if self.wander is not None:
            phase = phase + self.wander(phase)
        own = 2 * np.pi * phase + self.phase_off_rad + sensed.phase_rad[sensed.kind, 0]
        ripple = sensed.amplitude_volts[:, 0] * np.cos(own)
        noise = sensed.noise_volts * rng.standard_normal(ripple.shape)
        volts = self.level_volts + ripple + self.added_volts + noise
        return np.asarray(np.clip(volts, 0.0, RANGE_VOLTS))


def model_window(array: Array, rng: np.random.Generator, window_s: float) -> SpoiledWindow:
    """Draw a window that the model describes, over a grating of moderate period."""
    wave = Wave(float(rng.uniform(*_PERIODS_MM)), float(rng.uniform(*_ANGLES_DEG)), SPEED_MM_S, 0.0)
    sensed, time_s = sensed_by(array, rng, SNR_DB), scan_times_s(window_s)
    shape = (len(time_s), array.n_channels)
    return SpoiledWindow(
        wave=wave,
        sensed=sensed,
        time_s=time_s,
        travel_mm=SPEED_MM_S * (time_s[:, None] - time_s.mean() + sensed.offset_s),
        added_volts=np.zeros(shape),
        given_mm_s=[(0, SPEED_MM_S)],
        phase_off_rad=np.zeros(array.n_channels),
        level_volts=LEVEL_VOLTS * rng.uniform(0.9, 1.1, array.n_channels),
    )


Spoil = Callable[[SpoiledWindow, np.random.Generator], None]


def _nothing(_window: SpoiledWindow, _rng: np.random.Generator) -> None:
    """Leave a window that the model describes."""


def _unlike(window: SpoiledWindow, rng: np.random.Generator) -> None:
    """Let channels of a kind differ in phase by 0.1 rad rms."""
    window.phase_off_rad = 0.1 * rng.standard_normal(len(window.phase_off_rad))


def _unlike_taxels(window: SpoiledWindow, rng: np.random.Generator, *, reach_mm: float) -> None:
    """Let channels of a taxel stray alike by 0.1 rad rms, as neighbours do within `reach_mm` (Gaussian)."""
    places = np.column_stack([window.sensed.x_mm, window.sensed.y_mm])
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    alike = np.exp(-((apart / reach_mm) ** 2) / 2) if reach_mm else (apart == 0).astype(np.float64)
    value, vector = np.linalg.eigh(alike)
    window.phase_off_rad = 0.1 * vector @ (np.sqrt(value.clip(0)) * rng.standard_normal(len(value)))


def _speed_ripple(
    window: SpoiledWindow, rng: np.random.Generator, *, part: float, frequency_hz: float
) -> None:
    rad_s, phase = 2 * np.pi * frequency_hz, rng.uniform(0, 2 * np.pi)
    time_s = window.time_s[:, None] + window.sensed.offset_s
    window.travel_mm += SPEED_MM_S * part / rad_s * np.sin(rad_s * time_s + phase)


def _accelerating(window: SpoiledWindow, _rng: np.random.Generator, *, is_given: bool) -> None:
    """Let the speed grow from 0.7 to 1.3 of itself; where it is given, at each tenth of a second."""
    length_s = len(window.time_s) / RATE_HZ
    time_s = window.time_s[:, None] - window.time_s.mean() + window.sensed.offset_s
    window.travel_mm += SPEED_MM_S * 0.3 * time_s**2 / length_s
    if is_given:
        every = round(RATE_HZ / 10)
        middles_s = (np.arange(0, len(window.time_s), every) + every / 2) / RATE_HZ
        speeds = SPEED_MM_S * (1 + 0.6 * (middles_s - window.time_s.mean()) / length_s)
        window.given_mm_s = [(k * every, float(speed)) for k, speed in enumerate(speeds)]


def _hum(window: SpoiledWindow, rng: np.random.Generator, *, part: float) -> None:
    """Add mains of 50 Hz, rectified, over a board 0.9 % off: an alias at 0.9 Hz."""
    time_s = window.time_s[:, None] + window.sensed.offset_s
    hum = np.sin(2 * np.pi * 100.9 * time_s + rng.uniform(0, 2 * np.pi))
    window.added_volts += part * (AMPLITUDE_VOLTS * hum)


def _curved(window: SpoiledWindow, _rng: np.random.Generator, *, radius_mm: float) -> None:
    window.bend_mm = radius_mm


def _jittered(window: SpoiledWindow, rng: np.random.Generator, *, part: float) -> None:
    """Misplace each ridge by so many periods, rms."""
    ridges = np.arange(-2000, 2001)
    off = part * rng.standard_normal(len(ridges))
    window.wander = lambda phase: np.interp(phase, ridges, off)


MISFITS: dict[str, Spoil] = {
    "none": _nothing,
    "phases of taxels differ by 0.1 rad": _unlike,
    "the same, channels of a taxel alike": partial(_unlike_taxels, reach_mm=0.0),
    "the same, neighbours alike too (3.65 mm)": partial(_unlike_taxels, reach_mm=3.65),
    "speed ripples 30 % at 0.7 Hz": partial(_speed_ripple, part=0.30, frequency_hz=0.7),
    "speed grows from 70 to 130 %, mean given": partial(_accelerating, is_given=False),
    "the same, given each 0.1 s": partial(_accelerating, is_given=True),
    "aliased mains at 0.9 Hz, a ripple large": partial(_hum, part=1.0),
    "aliased mains at 0.9 Hz, a fifth": partial(_hum, part=0.2),
    "grooves bent, radius 300 mm": partial(_curved, radius_mm=300.0),
    "grooves bent, radius 100 mm": partial(_curved, radius_mm=100.0),
    "ridges misplaced by 5 % of the period": partial(_jittered, part=0.05),
    "ridges misplaced by 20 % of the period": partial(_jittered, part=0.20),
}
"""Ways to spoil a window, by name; `tests/detect/grooves` has further ones, such as dead channels."""


def _flat(window: SpoiledWindow, _rng: np.random.Generator) -> None:
    """Leave noise alone."""
    window.sensed = replace(window.sensed, amplitude_volts=0 * window.sensed.amplitude_volts)


def _sand_paper(window: SpoiledWindow, rng: np.random.Generator, *, grain_mm: float) -> None:
    """Put a random isotropic surface under a skin that averages over `grain_mm` (Gaussian correlation)."""
    _flat(window, rng)
    n_waves = 300
    per_mm = rng.standard_normal((n_waves, 2)) / grain_mm  # rad/mm: spectrum of exp(-r^2 / 2 grain^2)
    phase = rng.uniform(0, 2 * np.pi, n_waves)
    sensed = window.sensed
    for taxel in np.unique(np.column_stack([sensed.x_mm, sensed.y_mm]), axis=0):
        mine = (sensed.x_mm == taxel[0]) & (sensed.y_mm == taxel[1])
        x = taxel[0] + window.travel_mm[:, mine].mean(axis=1)
        field = np.cos(np.outer(x, per_mm[:, 0]) + taxel[1] * per_mm[:, 1] + phase).sum(axis=1)
        window.added_volts[:, mine] += (AMPLITUDE_VOLTS / np.sqrt(n_waves) * field)[:, None]


def _load_swings(window: SpoiledWindow, rng: np.random.Generator) -> None:
    """Let the load swing at one frequency over no plate: all channels in phase."""
    _flat(window, rng)
    wave = np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * window.time_s + rng.uniform(0, 2 * np.pi))
    window.added_volts += AMPLITUDE_VOLTS * wave[:, None]


GROOVELESS: dict[str, Spoil] = {
    "flat plate": _flat,
    "sand paper, grain 0.3 mm": partial(_sand_paper, grain_mm=0.3),
    "sand paper, grain 1 mm": partial(_sand_paper, grain_mm=1.0),
    "load that swings at one frequency": _load_swings,
}

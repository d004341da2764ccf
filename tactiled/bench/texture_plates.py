"""Windows that break the wave model in one known way each: what the misfit table is made of.

Each entry of `MISFITS` takes a perfect `Window` and spoils it. `GROOVELESS` are windows without a grating,
over which the only right answer is a refusal.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.bench.texture_bound import FloatArray, Sensed, Wave
from tactiled.bench.texture_signal import AMPLITUDE_VOLTS, LEVEL_VOLTS, RATE_HZ, sensed_by

SNR_DB = 30.0  # 20 mV of ripple over 0.45 mV of noise: the emulated board has 0.3
LSB_VOLTS = 3.0 / 4096
_RANGE_VOLTS = 3.0
_SPEED_MM_S = 1.5
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

    def volts(self, rng: np.random.Generator) -> FloatArray:
        """Readings (n, channels), clipped to the converter's range."""
        sensed, wave = self.sensed, self.wave
        angle, theta = np.radians(wave.angle_deg), np.radians(wave.direction_deg)
        x = sensed.x_mm - sensed.x_mm.mean() + self.travel_mm * np.cos(theta)
        y = sensed.y_mm - sensed.y_mm.mean() + self.travel_mm * np.sin(theta)
        across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        phase = (across + along**2 / (2 * self.bend_mm)) / wave.period_mm
        if self.wander is not None:
            phase = phase + self.wander(phase)
        order = np.arange(1, sensed.amplitude_volts.shape[1] + 1)
        own = (2 * np.pi * phase + self.phase_off_rad)[..., None] * order + sensed.phase_rad[sensed.kind]
        ripple = (sensed.amplitude_volts * np.cos(own)).sum(axis=-1)
        noise = sensed.noise_volts * rng.standard_normal(ripple.shape)
        volts = self.level_volts + ripple + self.added_volts + noise
        return np.asarray(np.clip(volts, 0.0, _RANGE_VOLTS))


Spoil = Callable[[Window, np.random.Generator], None]


def perfect(array: Array, rng: np.random.Generator, window_s: float, snr_db: float = SNR_DB) -> Window:
    """A window that the model describes, over any grating of moderate period."""
    wave = Wave(float(rng.uniform(*_PERIODS_MM)), float(rng.uniform(*_ANGLES_DEG)), _SPEED_MM_S, 0.0)
    sensed = sensed_by(array, rng, snr_db, ())
    time_s = np.arange(round(window_s * RATE_HZ)) / RATE_HZ
    shape = (len(time_s), array.n_channels)
    return Window(
        wave=wave,
        sensed=sensed,
        time_s=time_s,
        travel_mm=_SPEED_MM_S * (time_s[:, None] - time_s.mean() + sensed.offset_s),
        added_volts=np.zeros(shape),
        valid=np.ones(shape, dtype=np.bool_),
        given_mm_s=[(0, _SPEED_MM_S)],
        phase_off_rad=np.zeros(array.n_channels),
        level_volts=LEVEL_VOLTS * rng.uniform(0.9, 1.1, array.n_channels),
    )


def _nothing(_window: Window, _rng: np.random.Generator) -> None:
    """The model holds."""


def _harmonics(window: Window, rng: np.random.Generator) -> None:
    """Second and third at 50 % and 30 %: square ridges."""
    first = window.sensed.amplitude_volts[:, :1]
    phases = rng.uniform(-np.pi, np.pi, (len(window.sensed.phase_rad), 3))
    _sense(window, amplitude_volts=first * [1.0, 0.5, 0.3], phase_rad=phases)


def _gains(window: Window, rng: np.random.Generator) -> None:
    """Channels differ tenfold."""
    gain = np.exp(rng.uniform(-np.log(10) / 2, np.log(10) / 2, len(window.phase_off_rad)))
    _sense(window, amplitude_volts=window.sensed.amplitude_volts * gain[:, None])


def _unlike(window: Window, rng: np.random.Generator) -> None:
    """Channels of a kind differ in phase by 0.1 rad rms."""
    window.phase_off_rad = 0.1 * rng.standard_normal(len(window.phase_off_rad))


def _stepping(part: float, frequency_hz: float) -> Spoil:
    def spoil(window: Window, rng: np.random.Generator) -> None:
        rad_s, phase = 2 * np.pi * frequency_hz, rng.uniform(0, 2 * np.pi)
        time_s = window.time_s[:, None] + window.sensed.offset_s
        window.travel_mm += _SPEED_MM_S * part / rad_s * np.sin(rad_s * time_s + phase)

    return spoil


def _accelerating(is_told: bool) -> Spoil:
    def spoil(window: Window, _rng: np.random.Generator) -> None:
        # From 0.7 to 1.3 of the speed; where it is told, at each tenth of a second.
        length_s = len(window.time_s) / RATE_HZ
        time_s = window.time_s[:, None] - window.time_s.mean() + window.sensed.offset_s
        window.travel_mm += _SPEED_MM_S * 0.3 * time_s**2 / length_s
        if is_told:
            every = round(RATE_HZ / 10)
            middles_s = (np.arange(0, len(window.time_s), every) + every / 2) / RATE_HZ
            speeds = _SPEED_MM_S * (1 + 0.6 * (middles_s - window.time_s.mean()) / length_s)
            window.given_mm_s = [(k * every, float(speed)) for k, speed in enumerate(speeds)]

    return spoil


def _wrong_speed(window: Window, _rng: np.random.Generator) -> None:
    """Told 3 % too much: the period must come out 3 % too long."""
    window.given_mm_s = [(0, 1.03 * _SPEED_MM_S)]


def _creep(window: Window, rng: np.random.Generator) -> None:
    """Ten times the ripple, with a time constant of 1.5 s."""
    size = 10 * AMPLITUDE_VOLTS * rng.uniform(0.5, 1.0, len(window.phase_off_rad))
    window.added_volts -= size * np.exp(-window.time_s / 1.5)[:, None]


def _hum(window: Window, rng: np.random.Generator) -> None:
    """Mains of 50 Hz, rectified, over a board 0.9 % off: an alias at 0.9 Hz, a ripple large."""
    time_s = window.time_s[:, None] + window.sensed.offset_s
    window.added_volts += AMPLITUDE_VOLTS * np.sin(2 * np.pi * 100.9 * time_s + rng.uniform(0, 2 * np.pi))


def _weak_hum(window: Window, rng: np.random.Generator) -> None:
    """A fifth of that."""
    before = window.added_volts.copy()
    _hum(window, rng)
    window.added_volts = before + 0.2 * (window.added_volts - before)


def _dead(window: Window, rng: np.random.Generator) -> None:
    """Two taxels and five channels more read nothing, and are flagged."""
    channels = np.arange(len(window.phase_off_rad))
    lost = np.union1d(channels[4 * 4 : 4 * 6], rng.choice(channels, 5, replace=False))
    window.added_volts[:, lost] = -10.0
    window.valid[:, lost] = False


def _clipped(window: Window, _rng: np.random.Generator) -> None:
    """A taxel presses so hard that half of each ripple is beyond the range; those readings are flagged."""
    window.level_volts[4 * 4 : 4 * 5] = _RANGE_VOLTS
    window.valid[:, 4 * 4 : 4 * 5] = False


def _unflagged(window: Window, _rng: np.random.Generator) -> None:
    """The same, and nobody says so."""
    window.level_volts[4 * 4 : 4 * 5] = _RANGE_VOLTS


def _uneven(window: Window, _rng: np.random.Generator) -> None:
    """The plate is tilted: ripples from 10 % to 190 % along x."""
    x = window.sensed.x_mm - window.sensed.x_mm.mean()
    _sense(window, amplitude_volts=window.sensed.amplitude_volts * (1 + 0.9 * x / np.abs(x).max())[:, None])


def _curved(radius_mm: float) -> Spoil:
    def spoil(window: Window, _rng: np.random.Generator) -> None:
        window.bend_mm = radius_mm  # grooves are arcs

    return spoil


def _jittered(part: float) -> Spoil:
    def spoil(window: Window, rng: np.random.Generator) -> None:
        ridges = np.arange(-2000, 2001)
        off = part * rng.standard_normal(len(ridges))  # each ridge is misplaced by so many periods, rms
        window.wander = lambda phase: np.interp(phase, ridges, off)

    return spoil


def _coarse(window: Window, _rng: np.random.Generator) -> None:
    """A ripple of one step of the converter."""
    _sense(window, amplitude_volts=np.full_like(window.sensed.amplitude_volts, LSB_VOLTS))


def _sense(window: Window, **changes: FloatArray) -> None:
    window.sensed = Sensed(**vars(window.sensed) | changes)


MISFITS: dict[str, Spoil] = {
    "none": _nothing,
    "harmonics of 50 and 30 %": _harmonics,
    "gains differ tenfold": _gains,
    "phases of taxels differ by 0.1 rad": _unlike,
    "speed ripples 5 % at 7 Hz": _stepping(0.05, 7.0),
    "speed ripples 30 % at 0.7 Hz": _stepping(0.30, 0.7),
    "speed grows from 70 to 130 %, told the mean": _accelerating(False),
    "the same, told each 0.1 s": _accelerating(True),
    "told a speed 3 % too high": _wrong_speed,
    "creep of ten ripples in 1.5 s": _creep,
    "aliased mains at 0.9 Hz, a ripple large": _hum,
    "aliased mains at 0.9 Hz, a fifth": _weak_hum,
    "two taxels and five channels dead": _dead,
    "a taxel saturated half the time, flagged": _clipped,
    "the same, not flagged": _unflagged,
    "tilted: ripple 10 to 190 % along x": _uneven,
    "grooves bent, radius 300 mm": _curved(300.0),
    "grooves bent, radius 100 mm": _curved(100.0),
    "ridges misplaced by 5 % of the period": _jittered(0.05),
    "ridges misplaced by 20 % of the period": _jittered(0.20),
    "ripple of one converter step": _coarse,
}


def _flat(window: Window, _rng: np.random.Generator) -> None:
    """Noise alone."""
    _sense(window, amplitude_volts=np.zeros_like(window.sensed.amplitude_volts))


def _sand_paper(grain_mm: float) -> Spoil:
    """A random isotropic surface under a skin that averages over `grain_mm` (Gaussian correlation)."""

    def spoil(window: Window, rng: np.random.Generator) -> None:
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

    return spoil


def _wobble(window: Window, rng: np.random.Generator) -> None:
    """The whole contact breathes at one frequency, no plate behind it: all channels in phase."""
    _flat(window, rng)
    wave = np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * window.time_s + rng.uniform(0, 2 * np.pi))
    window.added_volts += AMPLITUDE_VOLTS * wave[:, None]


GROOVELESS: dict[str, Spoil] = {
    "flat plate": _flat,
    "sand paper, grain 0.3 mm": _sand_paper(0.3),
    "sand paper, grain 1 mm": _sand_paper(1.0),
    "load that breathes at one frequency": _wobble,
}

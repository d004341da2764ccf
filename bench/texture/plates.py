"""Windows that break the wave model in one known way each: what the misfit table is made of.

Each entry of `MISFITS` takes a perfect `Window` and spoils it. `GROOVELESS` are windows without a grating,
over which the only right answer is a refusal.
"""

from collections.abc import Callable

import numpy as np

from bench.texture.bound import FloatArray, Sensed
from bench.texture.signal import AMPLITUDE_VOLTS, RATE_HZ
from bench.texture.window import RANGE_VOLTS, SPEED_MM_S, Window

LSB_VOLTS = RANGE_VOLTS / 4096
Spoil = Callable[[Window, np.random.Generator], None]


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


def _unlike_taxels(reach_mm: float) -> Spoil:
    """All channels of a taxel stray alike by 0.1 rad rms, as neighbours do within `reach_mm` (Gaussian)."""

    def spoil(window: Window, rng: np.random.Generator) -> None:
        places = np.column_stack([window.sensed.x_mm, window.sensed.y_mm])
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        alike = np.exp(-((apart / reach_mm) ** 2) / 2) if reach_mm else (apart == 0).astype(np.float64)
        value, vector = np.linalg.eigh(alike)
        window.phase_off_rad = 0.1 * vector @ (np.sqrt(value.clip(0)) * rng.standard_normal(len(value)))

    return spoil


def _stepping(part: float, frequency_hz: float) -> Spoil:
    def spoil(window: Window, rng: np.random.Generator) -> None:
        rad_s, phase = 2 * np.pi * frequency_hz, rng.uniform(0, 2 * np.pi)
        time_s = window.time_s[:, None] + window.sensed.offset_s
        window.travel_mm += SPEED_MM_S * part / rad_s * np.sin(rad_s * time_s + phase)

    return spoil


def _accelerating(is_told: bool) -> Spoil:
    def spoil(window: Window, _rng: np.random.Generator) -> None:
        # From 0.7 to 1.3 of the speed; where it is told, at each tenth of a second.
        length_s = len(window.time_s) / RATE_HZ
        time_s = window.time_s[:, None] - window.time_s.mean() + window.sensed.offset_s
        window.travel_mm += SPEED_MM_S * 0.3 * time_s**2 / length_s
        if is_told:
            every = round(RATE_HZ / 10)
            middles_s = (np.arange(0, len(window.time_s), every) + every / 2) / RATE_HZ
            speeds = SPEED_MM_S * (1 + 0.6 * (middles_s - window.time_s.mean()) / length_s)
            window.given_mm_s = [(k * every, float(speed)) for k, speed in enumerate(speeds)]

    return spoil


def _wrong_speed(window: Window, _rng: np.random.Generator) -> None:
    """Told 3 % too much: the period must come out 3 % too long."""
    window.given_mm_s = [(0, 1.03 * SPEED_MM_S)]


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
    window.level_volts[4 * 4 : 4 * 5] = RANGE_VOLTS
    window.valid[:, 4 * 4 : 4 * 5] = False


def _unflagged(window: Window, _rng: np.random.Generator) -> None:
    """The same, and nobody says so."""
    window.level_volts[4 * 4 : 4 * 5] = RANGE_VOLTS


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
    "the same, channels of a taxel alike": _unlike_taxels(0.0),
    "the same, neighbours alike too (3.65 mm)": _unlike_taxels(3.65),
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

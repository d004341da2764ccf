"""Windows of a slide over surfaces without a grating: the only right answer is a refusal."""

from collections.abc import Callable
from functools import partial

import numpy as np

from bench.texture.signal import AMPLITUDE_VOLTS, ARRAY, LEVEL_VOLTS, ArrayResponse, scan_times_s, sensed_by
from tactiled.array import FloatArray

SNR_DB = 30.0  # ripples of 20 mV over 0.45 mV of noise: the emulated board has 0.3
SPEED_MM_S = 1.5  # along +x
WINDOW_S = 5.0
_WAVES = 300  # of which a random surface is the sum


def readings(name: str, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return volts (n, channels) over one of `SURFACES`, and when in a scan channels are sampled."""
    sensed, time_s = sensed_by(rng, SNR_DB), scan_times_s(WINDOW_S)
    level = LEVEL_VOLTS * rng.uniform(0.9, 1.1, ARRAY.n_channels)
    noise = sensed.noise_volts * rng.standard_normal((len(time_s), ARRAY.n_channels))
    return level + SURFACES[name](sensed, time_s, rng) + noise, sensed.offset_s


def _flat(sensed: ArrayResponse, time_s: FloatArray, _: np.random.Generator) -> FloatArray:
    return np.zeros((len(time_s), len(sensed.x_mm)))


def _sand_paper(
    sensed: ArrayResponse, time_s: FloatArray, rng: np.random.Generator, *, grain_mm: float
) -> FloatArray:
    """Put a random isotropic surface under a skin that averages over `grain_mm` (Gaussian correlation)."""
    per_mm = rng.standard_normal((_WAVES, 2)) / grain_mm  # rad/mm: spectrum of exp(-r^2 / 2 grain^2)
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    x = sensed.x_mm + SPEED_MM_S * (time_s[:, None] + sensed.offset_s)
    turns = x[..., None] * per_mm[:, 0] + sensed.y_mm[:, None] * per_mm[:, 1] + phase
    return np.asarray(AMPLITUDE_VOLTS / np.sqrt(_WAVES) * np.cos(turns).sum(axis=-1))


def _load_swings(sensed: ArrayResponse, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Let the load swing at one frequency: all channels in phase."""
    wave = np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * time_s + rng.uniform(0, 2 * np.pi))
    return np.asarray(AMPLITUDE_VOLTS * wave[:, None] * np.ones(len(sensed.x_mm)))


SURFACES: dict[str, Callable[[ArrayResponse, FloatArray, np.random.Generator], FloatArray]] = {
    "flat plate": _flat,
    "sand paper, grain 0.3 mm": partial(_sand_paper, grain_mm=0.3),
    "sand paper, grain 1 mm": partial(_sand_paper, grain_mm=1.0),
    "load that swings at one frequency": _load_swings,
}

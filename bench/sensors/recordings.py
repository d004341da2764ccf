"""Synthetic recordings of sensors of several kinds, made without any code of emulator or detectors.

A recording is a slide of `DURATION_S` at constant speed that is under way when it begins, over ridges or over
a surface without a period. Readings are in the unit of the sensor, far from zero, rounded as the sensor
rounds, and their time stamps jitter by a tenth of the scan period.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
DURATION_S = 10.0
_JITTER = 0.1  # of the scan period, standard deviation of a stamp
_LEAST_HZ, _MOST_OF_RATE = 0.8, 0.4  # ripple frequencies: eight periods or more, and not aliased

XYZ = [
    {"name": "x", "kind": "shear_x"},
    {"name": "y", "kind": "shear_y"},
    {"name": "z", "kind": "normal"},
]
NORMAL = [{"name": "z", "kind": "normal"}]


@dataclass(frozen=True)
class Sensor:
    """Kind of sensor.

    Attributes
    ----------
    array : mapping
        Array file, as a user writes it.
    level, step : float
        Readings under load, and the step to which they are rounded, in the unit of the sensor.
    noise : float
        Standard deviation of the noise.
    """

    name: str
    rate_hz: float
    array: dict[str, Any]
    level: float
    step: float
    noise: float


def _pad(unit: str, low: float, high: float, **more: Any) -> dict[str, Any]:
    return {"name": "sensor", "unit": unit, "range": [low, high], **more}


SENSORS = (
    Sensor(
        "16 taxels, places unknown, counts, 20 Hz",
        20.0,
        _pad("count", 0, 4095, taxel_count=16, taxel_channels=NORMAL),
        2300.0,
        1.0,
        9.0,
    ),
    Sensor(
        "4x4 normal taxels, counts, 35.6 Hz",
        35.6,
        _pad("count", 0, 4095, grids=[{"x_mm": [0, 4, 8, 12], "y_mm": [0, 4, 8, 12]}], taxel_channels=NORMAL),
        2300.0,
        1.0,
        9.0,
    ),
    Sensor(
        "4x4 x/y/z taxels, counts, 60 Hz",
        60.0,
        _pad("count", 0, 65535, grids=[{"x_mm": [0, 5, 10, 15], "y_mm": [0, 5, 10, 15]}], taxel_channels=XYZ),
        39_000.0,
        1.0,
        20.0,
    ),
    Sensor(
        "5 magnetometers x/y/z, uT, 100 Hz",
        100.0,
        _pad(
            "uT",
            -5000,
            5000,
            taxels=[{"x_mm": x, "y_mm": y} for x, y in ((0, 0), (7, 0), (-7, 0), (0, 7), (0, -7))],
            taxel_channels=XYZ,
        ),
        -800.0,
        0.15,
        1.5,
    ),
    Sensor(
        "3x3 pillars fx/fy/fz, N, 300 Hz",
        300.0,
        _pad("N", -20, 20, grids=[{"x_mm": [0, 4, 8], "y_mm": [0, 4, 8]}], taxel_channels=XYZ),
        1.5,
        0.001,
        0.01,
    ),
    Sensor(
        "one load cell, N, 1000 Hz",
        1000.0,
        _pad("N", 0, 50, taxel_count=1, taxel_channels=NORMAL),
        6.0,
        0.002,
        0.02,
    ),
)
Surface = Literal["ridges", "white noise", "1/f noise", "shared noise", "resonance"]
FLAT: tuple[Surface, ...] = ("white noise", "1/f noise", "shared noise", "resonance")


@dataclass(frozen=True, eq=False)
class Recording:
    """Slide with known truth; `ripple_hz` is 0 where the surface has no period."""

    time_s: FloatArray
    readings: FloatArray
    speed_mm_s: float
    period_mm: float = 0.0
    tilt_deg: float = 0.0
    ripple_hz: float = field(default=0.0)


def make(sensor: Sensor, surface: Surface, snr_db: float, seed: int) -> Recording:
    """Make a recording; `snr_db` is the power of the ripple over that of the noise, in each channel."""
    rng = np.random.default_rng([seed, len(sensor.name), FLAT.index(surface) if surface in FLAT else 9])
    n = round(DURATION_S * sensor.rate_hz)
    regular_s = np.arange(n) / sensor.rate_hz
    time_s = 100.0 + regular_s + _JITTER / sensor.rate_hz * rng.standard_normal(n).clip(-3, 3)
    x, y = _places(sensor.array)
    channels = len(x)
    speed_mm_s = float(rng.uniform(3, 15))  # over ridges, their period and frequency give another
    noise = _noise(rng, surface, n, channels, sensor.rate_hz)
    found = {}
    if surface == "ridges":
        highest = min(_MOST_OF_RATE * sensor.rate_hz, 40.0)
        ripple_hz = float(np.exp(rng.uniform(np.log(_LEAST_HZ), np.log(highest))))
        tilt = np.radians(rng.uniform(-30, 30))
        period_mm = float(np.exp(rng.uniform(np.log(0.8), np.log(6.0))))
        speed_mm_s = float(ripple_hz * period_mm / np.cos(tilt))
        along = (x * np.cos(tilt) + y * np.sin(tilt)) / period_mm
        phase = 2 * np.pi * (ripple_hz * regular_s[:, np.newaxis] + along) + rng.uniform(0, 0.5, channels)
        gains = rng.uniform(0.6, 1.4, channels)
        wave = np.cos(phase) + 0.3 * np.cos(2 * phase + rng.uniform(0, 6.3))
        noise = noise + np.sqrt(2) * 10 ** (snr_db / 20) * gains * wave
        found = {"period_mm": period_mm, "tilt_deg": float(np.degrees(tilt)), "ripple_hz": ripple_hz}
    offsets = sensor.level * rng.uniform(0.8, 1.2, channels)
    readings = np.rint((offsets + sensor.noise * noise) / sensor.step) * sensor.step
    return Recording(time_s, readings, speed_mm_s, **found)


def _places(array: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Places of the channels; at random where the array file has none."""
    if "taxel_count" in array:
        side = int(np.ceil(np.sqrt(array["taxel_count"])))
        places = [(4.0 * column, 4.0 * row) for row in range(side) for column in range(side)]
    elif "taxels" in array:
        places = [(taxel["x_mm"], taxel["y_mm"]) for taxel in array["taxels"]]
    else:
        places = [(x, y) for grid in array["grids"] for y in grid["y_mm"] for x in grid["x_mm"]]
    each = np.repeat(np.array(places, dtype=np.float64), len(array["taxel_channels"]), axis=0)
    return each[:, 0], each[:, 1]


def _noise(rng: np.random.Generator, surface: Surface, n: int, channels: int, rate_hz: float) -> FloatArray:
    white = rng.standard_normal((n, channels))
    frequency = np.maximum(np.fft.rfftfreq(n, 1 / rate_hz), 1 / DURATION_S)[:, np.newaxis]
    if surface in ("white noise", "ridges"):
        # Rubber creeps and grips: a part of the noise has a slope even over ridges.
        shape = 1 / frequency**0.5 if surface == "ridges" else np.ones_like(frequency)
    elif surface == "resonance":
        centre = rng.uniform(0.1, 0.3) * rate_hz
        damping = rng.uniform(0.1, 0.3)  # of grippers and silicone; below, a resonance is as narrow as a line
        ratio = frequency / centre
        shape = 1 + 3 / np.sqrt((1 - ratio**2) ** 2 + (2 * damping * ratio) ** 2)
    else:
        shape = 1 / frequency
    noise = np.fft.irfft(np.fft.rfft(white, axis=0) * shape, n, axis=0)
    noise /= noise.std(axis=0)
    if surface == "shared noise":
        common = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * shape[:, 0], n)
        noise = np.sqrt(0.2) * noise + np.sqrt(0.8) * (common / common.std())[:, np.newaxis]
    return np.asarray(noise)

"""Disturbances of a scene as functions of time."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.scene.phases import Disturbance

Shape = Callable[[Disturbance, FloatArray], FloatArray]

_LEAST_FRICTION = 0.01  # of the plate's: contact models need a limit above zero
_SWELL = 0.1  # part of its time over which a sine grows, and fades, so that it begins and ends without a kink


class Disturbances:
    """Sums of a scene's disturbances."""

    def __init__(self, disturbances: Sequence[Disturbance]) -> None:
        self._disturbances = tuple(disturbances)

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Extra load (N), travel x and y (mm), pull x and y (N); all have the shape of `time_s`."""
        travel, pull = self._vector("travel_mm", time_s), self._vector("pull_n", time_s)
        return self._sum("load_n", time_s), travel.real, travel.imag, pull.real, pull.imag

    def velocity_mm_s(self, time_s: FloatArray) -> FloatArray:
        """Velocity (..., 2) of the travel."""
        rate = self._vector("travel_mm", time_s, _rate)
        return np.stack([rate.real, rate.imag], axis=-1)

    def temperature_k(self, time_s: FloatArray) -> FloatArray:
        return self._sum("temperature_k", time_s)

    def friction_part(self, time_s: FloatArray) -> FloatArray:
        """Friction over that of the plate, at least `_LEAST_FRICTION`."""
        return np.maximum(1.0 + self._sum("friction", time_s), _LEAST_FRICTION)

    def _sum(self, on: str, time_s: FloatArray) -> FloatArray:
        out = np.zeros(np.shape(time_s))
        for extra in self._disturbances:
            if extra.on == on:
                out += _value(extra, time_s)
        return out

    def _vector(self, on: str, time_s: FloatArray, of: Shape | None = None) -> NDArray[np.complex128]:
        """Sum of x + iy over the disturbances of one kind, each given by `of`, by default its value."""
        of = of or _value
        out = np.zeros(np.shape(time_s), dtype=np.complex128)
        for extra in self._disturbances:
            if extra.on == on:
                angle = np.deg2rad(extra.direction_deg)
                out += of(extra, time_s) * complex(round(np.cos(angle), 15), round(np.sin(angle), 15))
        return out


def _value(extra: Disturbance, time_s: FloatArray) -> FloatArray:
    since_s = np.asarray(time_s) - extra.start_s
    part = np.clip(since_s / extra.duration_s, 0.0, 1.0)
    if extra.shape == "ramp":
        return np.asarray(extra.amplitude * part)
    if extra.shape == "pulse":
        return np.asarray(
            extra.amplitude * np.sin(np.pi * part) ** 2 * (part < 1)
        )  # sin(pi) is not exactly 0
    swell = np.clip(np.minimum(part, 1 - part) / _SWELL, 0.0, 1.0)
    wave = np.sin(2 * np.pi * extra.frequency_hz * since_s)
    return np.asarray(extra.amplitude * swell * swell * (3 - 2 * swell) * wave)


def _rate(extra: Disturbance, time_s: FloatArray) -> FloatArray:
    """Time derivative of `_value`."""
    since_s = np.asarray(time_s) - extra.start_s
    part = since_s / extra.duration_s
    is_active = (part >= 0) & (part < 1)
    if extra.shape == "ramp":
        return np.asarray(extra.amplitude / extra.duration_s * is_active)
    if extra.shape == "pulse":
        return np.asarray(extra.amplitude / extra.duration_s * np.pi * np.sin(2 * np.pi * part) * is_active)
    swell = np.clip(np.minimum(part, 1 - part) / _SWELL, 0.0, 1.0)
    swell_rate = 6 * swell * (1 - swell) / (_SWELL * extra.duration_s) * np.where(part < 0.5, 1, -1)
    omega = 2 * np.pi * extra.frequency_hz
    wave, wave_rate = np.sin(omega * since_s), omega * np.cos(omega * since_s)
    return np.asarray(extra.amplitude * (swell_rate * wave + swell * swell * (3 - 2 * swell) * wave_rate))

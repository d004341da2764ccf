"""Disturbances of a scene as functions of time: any instants at all, in any order, the same numbers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.phases import Disturbance

FloatArray = NDArray[np.float64]

_SWELL = 0.1  # part of its time over which a sine swells, and dies: no kinks of its own making


class Disturbances:
    """Sums of a scene's disturbances.

    Parameters
    ----------
    disturbances : sequence of Disturbance
    """

    def __init__(self, disturbances: Sequence[Disturbance]) -> None:
        self._disturbances = tuple(disturbances)

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Extra load (N), travel x and y (mm), pull x and y (N); all have the shape of `time_s`."""
        travel, pull = self._vector("travel_mm", time_s), self._vector("pull_n", time_s)
        return self._sum("load_n", time_s), travel.real, travel.imag, pull.real, pull.imag

    def temperature_k(self, time_s: FloatArray) -> FloatArray:
        return self._sum("temperature_k", time_s)

    def _sum(self, on: str, time_s: FloatArray) -> FloatArray:
        out = np.zeros(np.shape(time_s))
        for extra in self._disturbances:
            if extra.on == on:
                out += _value(extra, time_s)
        return out

    def _vector(self, on: str, time_s: FloatArray) -> NDArray[np.complex128]:
        """x + iy."""
        out = np.zeros(np.shape(time_s), dtype=np.complex128)
        for extra in self._disturbances:
            if extra.on == on:
                angle = np.deg2rad(extra.direction_deg)
                out += _value(extra, time_s) * complex(round(np.cos(angle), 15), round(np.sin(angle), 15))
        return out


def _value(extra: Disturbance, time_s: FloatArray) -> FloatArray:
    since_s = np.asarray(time_s) - extra.start_s
    part = np.clip(since_s / extra.duration_s, 0.0, 1.0)
    if extra.shape == "ramp":
        return np.asarray(extra.amplitude * part)
    if extra.shape == "pulse":
        return np.asarray(extra.amplitude * np.sin(np.pi * part) ** 2 * (part < 1))  # sin(pi) is no zero
    swell = np.clip(np.minimum(part, 1 - part) / _SWELL, 0.0, 1.0)
    wave = np.sin(2 * np.pi * extra.frequency_hz * since_s)
    return np.asarray(extra.amplitude * swell * swell * (3 - 2 * swell) * wave)

"""Disturbances of a scene as functions of time."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.scene.phases import Disturbance

_SWELL = 0.1  # part of its time over which a sine grows, and fades, so that it begins and ends without a kink


def disturbance(disturbances: Sequence[Disturbance], on: str, time_s: FloatArray) -> FloatArray:
    """Sum of the disturbances of a quantity without direction, in the shape of `time_s`."""
    out = np.zeros(np.shape(time_s))
    for extra in disturbances:
        if extra.on == on:
            out += _value(extra, time_s)
    return out


def pull_n(disturbances: Sequence[Disturbance], time_s: FloatArray) -> NDArray[np.complex128]:
    """Extra pull on a held object as x + iy."""
    out = np.zeros(np.shape(time_s), dtype=np.complex128)
    for extra in disturbances:
        if extra.on == "pull_n":
            angle = np.deg2rad(extra.direction_deg)
            out += _value(extra, time_s) * complex(round(np.cos(angle), 15), round(np.sin(angle), 15))
    return out


def _value(extra: Disturbance, time_s: FloatArray) -> FloatArray:
    since_s = np.asarray(time_s) - extra.start_s
    part = np.clip(since_s / extra.duration_s, 0.0, 1.0)
    if extra.shape == "ramp":
        return np.asarray(extra.amplitude * part)
    if extra.shape == "pulse":  # sin(pi) is not exactly 0
        return np.asarray(extra.amplitude * np.sin(np.pi * part) ** 2 * (part < 1))
    swell = np.clip(np.minimum(part, 1 - part) / _SWELL, 0.0, 1.0)
    wave = np.sin(2 * np.pi * extra.frequency_hz * since_s)
    return np.asarray(extra.amplitude * swell * swell * (3 - 2 * swell) * wave)

"""Motions of a person who presses a sensor, and of a hand that holds something: forces on each taxel."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactiled.array import Array, FloatArray

Motion = Literal["press", "walk", "hold", "flat", "tip"]
LARGEST_N = 20.0
"""Range of the normal force."""
_FRICTION = 0.6


@dataclass(frozen=True, eq=False)
class Loads:
    """Forces on the skin over time."""

    time_s: FloatArray  # (n,)
    taxels_n: FloatArray  # (n, taxels, 3): x, y, normal on each taxel

    def wrench(self, array: Array) -> FloatArray:
        """Return force (N) and moment about the origin of the array frame (N mm), (n, 6)."""
        fx, fy, fz = np.moveaxis(self.taxels_n, 2, 0)
        x, y = array.x_mm, array.y_mm
        parts = (fx, fy, fz, y * fz, -x * fz, x * fy - y * fx)
        return np.stack([part.sum(axis=1) for part in parts], axis=1)


def play(
    motion: Motion,
    array: Array,
    stiffness: FloatArray,
    seconds: float,
    rng: np.random.Generator,
    rate_hz: float = 100.0,
) -> Loads:
    """Draw a motion over taxels of some stiffness (taxels,).

    "press": presses of 2 to 4 s at places near the centre, with shear. "walk": the same while the place
    wanders over the whole array, so that taxels do not share the load in proportion. "hold": contacts of
    10 to 20 s with sway, taps and slow pulls. "flat": presses with a flat plate, without shear. "tip":
    presses with a finger tip on one taxel after the other.
    """
    n = round(seconds * rate_hz)
    time_s = np.arange(n) / rate_hz
    normal, shear = np.zeros(n), np.zeros((n, 2))
    place = np.zeros((n, 2))
    x, y = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
    reach = float(np.hypot(x, y).max()) or 1.0
    wander = {"press": 0.3, "walk": 0.8, "hold": 0.5, "flat": 0.05, "tip": 0.0}[motion] * reach
    spread = np.zeros(n)
    turn = np.zeros(n)
    at_s, taxel = rng.uniform(0.8, 1.2), 0
    while at_s < seconds:
        length_s = float(rng.uniform(10, 20) if motion == "hold" else rng.uniform(2.0, 4.0))
        k = np.flatnonzero((time_s >= at_s) & (time_s < at_s + length_s))
        t = time_s[k] - at_s
        normal[k] = _course(t, length_s, motion, rng)
        shear[k] = _shear(t, length_s, normal[k], motion, rng)
        begin, end = rng.uniform(-wander, wander, (2, 2))
        if motion == "tip":
            begin = end = np.array([x[taxel % len(x)], y[taxel % len(x)]]) + rng.normal(0, 0.05 * reach, 2)
            taxel += 1
        elif motion != "walk":
            end = begin + 0.15 * (end - begin)
        place[k] = begin + (end - begin) * (t / length_s)[:, np.newaxis]
        spread[k] = reach * rng.uniform(0.7, 1.6) * {"flat": 2.0, "tip": 0.3}.get(motion, 1.0)
        turn[k] = 0.0 if motion == "flat" else rng.normal(0, 0.15) * np.sin(np.pi * t / length_s) ** 2
        at_s += length_s + rng.uniform(0.4, 1.0)
    spread = np.where(spread > 0, spread, reach)
    distance2 = (x - place[:, :1]) ** 2 + (y - place[:, 1:]) ** 2
    share = stiffness * np.exp(-distance2 / (2 * spread[:, np.newaxis] ** 2))
    share /= share.sum(axis=1, keepdims=True)
    loads = normal[:, np.newaxis] * share
    pulls = shear[:, np.newaxis, :] * share[:, :, np.newaxis]
    # A turn about the place pulls each taxel sideways, in proportion to its load.
    arm = np.stack([-(y - place[:, 1:]), x - place[:, :1]], axis=2) / reach
    pulls = pulls + arm * (turn[:, np.newaxis] * loads)[:, :, np.newaxis]
    return Loads(time_s, np.concatenate([pulls, loads[:, :, np.newaxis]], axis=2))


def _course(t: FloatArray, length_s: float, motion: Motion, rng: np.random.Generator) -> FloatArray:
    """Normal force of one contact, from touch to release."""
    peak = rng.uniform(0.15, 1.0) * LARGEST_N
    rise_s = rng.uniform(0.2, 0.8)
    rise, fall = np.clip(t / rise_s, 0, 1), np.clip((length_s - t) / rng.uniform(0.2, 0.8), 0, 1)
    sway = 1 + rng.uniform(0.02, 0.25) * np.sin(2 * np.pi * rng.uniform(0.2, 1.5) * t + rng.uniform(0, 6))
    if motion == "hold":
        for _ in range(int(rng.integers(0, 4))):
            at_s, width_s = rng.uniform(0, length_s), rng.uniform(0.03, 0.1)
            sway = sway + 0.2 * np.exp(-0.5 * ((t - at_s) / width_s) ** 2)
    return np.minimum(peak * _smooth(rise) * _smooth(fall) * sway, LARGEST_N)


def _shear(
    t: FloatArray, length_s: float, normal: FloatArray, motion: Motion, rng: np.random.Generator
) -> FloatArray:
    """Tangential force (n, 2) within the friction limit."""
    if motion == "flat":
        return np.zeros((len(t), 2))
    part = np.zeros((len(t), 2))
    for _ in range(1 if motion == "press" else 2):
        angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.9) * _FRICTION
        course = size * np.sin(np.pi * t / length_s) ** 2 * np.sin(2 * np.pi * rng.uniform(0.15, 0.7) * t)
        part += course[:, np.newaxis] * np.array([np.cos(angle), np.sin(angle)])
    most = np.maximum(np.hypot(part[:, 0], part[:, 1]) / _FRICTION, 1.0)
    return np.asarray(part / most[:, np.newaxis] * normal[:, np.newaxis])


def _smooth(part: FloatArray) -> FloatArray:
    """Minimum-jerk course from 0 to 1."""
    return np.asarray(part**3 * (10 - 15 * part + 6 * part**2))

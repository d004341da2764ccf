"""The plate under the nodes of a skin: its height and the frames in which they touch it."""

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.mechanics.base import Surface

FloatArray = NDArray[np.float64]


def plate_under(surface: Surface, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height over the plane of the ridges, 0 or less, and contact frames, at places over the plate.

    Returns
    -------
    height_mm : (n,) float64
    frame : (3, 3, n) float64
        ``frame[i, :, k]``: contact direction i (normal into the skin, two tangents) of place k as
        (into the skin, x, y).
    """
    depth, period = surface.depth_mm, surface.period_mm
    angle = np.deg2rad(surface.angle_deg) if depth > 0 else 0.0
    c, s = np.cos(angle), np.sin(angle)
    phase = 2 * np.pi * (x_mm * c + y_mm * s) / period
    height = depth * (np.cos(phase) - 1) / 2
    slope = -depth * np.pi / period * np.sin(phase)
    tilt = 1 / np.sqrt(1 + slope**2)
    frame = np.zeros((3, 3, len(phase)))
    frame[0] = tilt, -slope * tilt * c, -slope * tilt * s
    frame[1] = slope * tilt, tilt * c, tilt * s
    frame[2, 1], frame[2, 2] = -s, c
    return height, frame

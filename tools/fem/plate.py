"""Distance of points to a rigid plate with sinusoidal grooves (`base.Surface`), as contact needs it."""

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Surface

_NEAR_MM = 0.03  # farther than this from touching, the height stands in for the distance
_NEWTON_STEPS = 8  # from the point's own foot, near the plate: quadratic, two or three would do


def distance(surface: Surface, place_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Signed distance, its gradient and its second derivative.

    The plate lies above the skin: its valleys are at z = 0, its ridges reach down to z = -depth.

    Parameters
    ----------
    place_mm : (n, 3) float64
        Points of the skin in the frame of the plate.

    Returns
    -------
    gap_mm : (n,), normal : (n, 3), curvature : (n, 3, 3)
        Negative where they overlap; the normal points from the plate to the skin.
    """
    angle, wave = np.deg2rad(surface.angle_deg), 2 * np.pi / surface.period_mm
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    s, drop = place_mm @ along, -place_mm[:, 2]
    half = surface.depth_mm / 2
    height = half * (1 + np.cos(wave * s))
    near = drop - height < _NEAR_MM
    foot = s.copy()
    for _ in range(_NEWTON_STEPS):
        h, slope, bend = _profile(half, wave, foot)
        rate = 1 + slope**2 + (h - drop) * bend
        step = ((foot - s) + (h - drop) * slope) / np.maximum(rate, 0.1)
        foot = np.where(near, foot - step, s)
    h, slope, bend = _profile(half, wave, foot)
    length = np.sqrt(1 + slope**2)
    gap = np.where(near, ((drop - h) - slope * (s - foot)) / length, drop - height)
    normal = (-slope[:, None] * along + np.array([0.0, 0.0, -1.0])) / length[:, None]
    tangent = (along + slope[:, None] * np.array([0.0, 0.0, -1.0])) / length[:, None]
    bent = -bend / length**3
    bent = bent / np.maximum(1 + bent * gap, 0.1)
    return gap, normal, bent[:, None, None] * tangent[:, :, None] * tangent[:, None, :]


def _profile(half: float, wave: float, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height of the plate and its first two derivatives."""
    return half * (1 + np.cos(wave * s)), -half * wave * np.sin(wave * s), -half * wave**2 * np.cos(wave * s)

"""Conversion of forces on the bump to forces on its read-out areas, by linear elasticity.

A force at (x, y) of the bump acts on the area at azimuth e with a weight; finite elements give the weights
at the points of the bump's surface (`fem.compliance`, coarse mesh). They are smooth, so polynomials are
fitted to them: in s along e and q across it, even in q for normal forces and forces along e, odd for forces
across.
"""

from functools import cache

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout
from tactiled.emulator.mechanics.skin import load_compliance

# At large strain the pressure moves with the tilting bump, the more the larger the load, which linear
# weights do not contain. Growth of the weights per newton of load on the taxel, fitted under 2.5 N
# (config/contact/ fem-coarse-flat-0.6-heavy.json; other loads and friction coefficients were not fitted) to
# the forces on half chips at rest and to left minus right at full slip. The patch had independent bristles
# under the pressure of a thin bonded layer, (1 - r^2 / a^2)^2. No reference has a larger load than
# `_LARGEST_N`; beyond it the weights stay constant.
_NORMAL_GROWTH, _TILT_GROWTH = 0.0102, 0.0745
_LARGEST_N = 3.8
_PATCH_MM = 0.83  # contact radius of the finite elements at 1.667 N, over which the weights are averaged
_ORDER = 5  # residual of the fits: rms below 0.01


def mean_side_weights(azimuth_deg: FloatArray, readout: Readout) -> tuple[FloatArray, FloatArray]:
    """Newtons on each area per newton on the taxel: of pressing (a,), along x and y on the skin (2, a).

    They hold at small load; see `growth`. The mean is over a round patch, weighted by the pressure of a ball
    on a thin incompressible layer bonded below, ``p ~ (1 - r^2 / a^2)^2`` (Johnson, Contact Mechanics, 1985,
    section 5.8).
    """
    radius = (np.arange(8) + 0.5) / 8
    angle = 2 * np.pi * np.arange(16) / 16
    x = _PATCH_MM * np.outer(radius, np.cos(angle)).ravel()
    y = _PATCH_MM * np.outer(radius, np.sin(angle)).ravel()
    share = np.repeat(radius * (1 - radius**2) ** 2, len(angle))
    share /= share.sum()
    azimuth = np.deg2rad(azimuth_deg)[:, None]
    cos, sin = np.cos(azimuth).round(15), np.sin(azimuth).round(15)
    s, q = cos * x + sin * y, cos * y - sin * x
    normal, along, across = _fits(readout)
    pull_s, pull_q = _even(s, q) @ along, (q[..., None] * _even(s, q)) @ across
    tangential = np.stack([cos * pull_s - sin * pull_q, sin * pull_s + cos * pull_q], axis=-1)
    return _even(s, q) @ normal @ share, np.einsum("anv,n->va", tangential, share)


def growth(normal_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors (..., 1) on the weights of normal and of tangential forces, at a load of the whole taxel."""
    load = np.minimum(normal_n, _LARGEST_N)[..., None]
    return 1 + _NORMAL_GROWTH * load, 1 + _TILT_GROWTH * load


def _even(s: FloatArray, q: FloatArray) -> FloatArray:
    """Monomials s^j q^(2k) up to a total order."""
    terms = [s**j * q ** (2 * k) for j in range(_ORDER + 1) for k in range((_ORDER - j) // 2 + 1)]
    return np.stack(terms, axis=-1)


@cache
def _fits(readout: Readout) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients for normal forces, forces along the azimuth, and forces across it."""
    data = load_compliance()
    x, y = data["x_mm"], data["y_mm"]
    normal = data[f"{readout}_from_normal"][2]  # the area at +x: s is x, q is y
    tangential = data[f"{readout}_from_tangential"][2]
    basis = _even(x, y)
    odd = y[:, None] * basis
    return (
        np.linalg.lstsq(basis, normal)[0],
        np.linalg.lstsq(basis, tangential[:, 0])[0],
        np.linalg.lstsq(odd, tangential[:, 1])[0],
    )

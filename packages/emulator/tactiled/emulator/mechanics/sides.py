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
from tactiled.resources import shipped

# At large strain the pressure moves with the tilting bump, the more the larger the load, which linear
# weights do not contain. Growth of the weights per newton of load on the taxel, fitted under 2.5 N
# (config/contact/ fem-coarse-flat-0.6-heavy.json; other loads and friction coefficients were not fitted) to
# the forces on half chips at rest and to left minus right at full slip. The patch had independent bristles
# under the pressure of a thin bonded layer, (1 - r^2 / a^2)^2. No reference has a larger load than
# `_LARGEST_N`; beyond it the weights stay constant.
_NORMAL_GROWTH, _TILT_GROWTH = 0.0102, 0.0745
_LARGEST_N = 3.8
_ORDER = 5  # residual of the fits: rms below 0.01


class SideWeights:
    """Weights of the read-out areas at given azimuths.

    Parameters
    ----------
    azimuth_deg : (a,) float64
    readout : {"edge", "half"}
        ``edge``: the chip beyond 1 mm from its axis, which reproduces the paper's 0.07 N a side and its
        change of almost 100 %; ``half``: half the chip.
    """

    def __init__(self, azimuth_deg: FloatArray, readout: Readout = "edge") -> None:
        angle = np.deg2rad(azimuth_deg)
        self._cos, self._sin = np.cos(angle).round(15), np.sin(angle).round(15)
        self._fits = _fits(readout)

    def at(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Newtons on each area per newton at places of the bump, at small load; see `growth` for large loads.

        Returns
        -------
        normal : (a, n) float64
            Per newton of pressing.
        tangential : (a, n, 2) float64
            Per newton along x and y on the skin.
        """
        cos, sin = self._cos[:, None], self._sin[:, None]
        s, q = cos * x_mm + sin * y_mm, cos * y_mm - sin * x_mm
        normal, along, across = self._fits
        pull_s = _even(s, q) @ along
        pull_q = (q[..., None] * _even(s, q)) @ across
        tangential = np.stack([cos * pull_s - sin * pull_q, sin * pull_s + cos * pull_q], axis=-1)
        return np.asarray(_even(s, q) @ normal), tangential


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
    with np.load(shipped("config", "contact", "compliance-coarse.npz")) as data:
        x, y = data["x_mm"].astype(np.float64), data["y_mm"].astype(np.float64)
        normal = data[f"{readout}_from_normal"][2].astype(np.float64)  # the area at +x: s is x, q is y
        tangential = data[f"{readout}_from_tangential"][2].astype(np.float64)
    basis = _even(x, y)
    odd = y[:, None] * basis
    return (
        np.linalg.lstsq(basis, normal)[0],
        np.linalg.lstsq(basis, tangential[:, 0])[0],
        np.linalg.lstsq(odd, tangential[:, 1])[0],
    )

"""Linear skin of a taxel for contact model `compliance`, from the shipped arrays of finite elements.

Components are (into the skin, x, y). Large displacements enter to first order: a force acts at the displaced
place of its node, which adds a couple,

    pressing times displacement along the surface - friction times displacement into the skin.

The whole couple acts on the read-out areas under the bump, but only a part of it turns the bump's own
surface: most of it arises in deeper layers. Also the skin stiffens: ``N = N' (1 + N' / 24 N)`` displaces it
as N' would displace a linear skin. Signorini's and Coulomb's laws are homogeneous in the forces, so contact
is solved for N' and all its forces are scaled up.

The three constants stand for higher orders. They are fitted to finite elements on flat plates with friction
0.6 under 0.6 N and 2.5 N (config/contact/fem-coarse-flat-0.6-light.json, -heavy.json), with which no error is
stated.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import BASE_MM, BUMP_MM, CHIP_MM, Readout
from tactiled.resources import shipped

_REACH_MM = 0.35  # neighbourhood for the slope of a map at a node: two to three nodes in each direction
# Part of a displacement by which the material that carries the pressure down is displaced. Left minus right
# at full slip requires 0.75 under 0.6 N and 0.87 under 2.5 N.
_DRAGGED = 0.82
# Part of a couple that turns the surface. At full slip under 2.5 N the centroid of pressure is then 0.089 mm
# ahead of the apex in the skin, as in finite elements; without, 0.063 mm.
_TURNING = 0.2
# With it the skin at full slip under 2.5 N is dragged along by 0.259 mm, as in finite elements; without,
# 0.276 mm.
_STIFFENING_N = 24.0
# Largest displacement in the couples, twice that under friction 0.9: first order is not valid beyond, and
# without a bound couples could grow without limit.
_LARGEST_MM = 0.6
_HEIGHT_MM = CHIP_MM + BASE_MM + BUMP_MM  # arm of friction at the apex over the read-out areas
_SIDES_DEG = np.array([180.0, 270.0, 0.0, 90.0])  # azimuths of the read-out areas in the arrays


@dataclass(frozen=True, eq=False)
class SkinCompliance:
    """Nodes and compliance of a taxel's surface."""

    # x_mm, y_mm, gap_mm: (n,): surface nodes, and their depth under the apex
    x_mm: FloatArray
    y_mm: FloatArray
    gap_mm: FloatArray
    area_mm2: FloatArray  # (n,): area of each node
    compliance: FloatArray  # (3, n, 3, n): mm/N
    side: FloatArray  # (4, 3, n): force on the area at each of `_SIDES_DEG` by a force component on each node
    gradient: FloatArray  # (2, n, n): derivatives along x and y at the nodes of values at the nodes, 1/mm


class DisplacementEffects:
    """Displacements, and forces on the read-out areas (a,), by forces at displaced nodes."""

    def __init__(self, skin: SkinCompliance, azimuth_deg: FloatArray) -> None:
        self._side = np.tensordot(_azimuth_weights(azimuth_deg), skin.side, 1)
        self._side_slope = np.einsum("dfl,al->adf", skin.gradient, self._side[:, 0])
        self._arm_mm = _HEIGHT_MM - skin.gap_mm
        n = len(skin.x_mm)
        # A couple is a dipole of normal forces: by virtual work the transpose of the gradient.
        dipoles = np.concatenate(list(skin.gradient)).T
        self._by_couples = _TURNING * skin.compliance.reshape(3 * n, 3 * n)[:, :n] @ dipoles

    def turned_mm(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Displacements (3, n) by the couples of forces (3, n) at nodes displaced by (3, n)."""
        moved = np.clip(moved_mm, -_LARGEST_MM, _LARGEST_MM)
        couple = force_n[0] * moved[1:] - force_n[1:] * moved[0]
        return np.asarray((self._by_couples @ couple.ravel()).reshape(3, -1))

    def side_n(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Forces (t, a) on the read-out areas, 0 or more, by forces and displacements (t, 3, n)."""
        arm = np.clip(1 - moved_mm[:, 0] / self._arm_mm, 0.0, 1.0)
        levered = np.concatenate([force_n[:, :1], force_n[:, 1:] * arm[:, None]], axis=1)
        side = np.tensordot(levered, self._side, ([1, 2], [1, 2]))
        side += _DRAGGED * np.einsum("tn,tin,ain->ta", force_n[:, 0], moved_mm[:, 1:], self._side_slope)
        return np.maximum(side, 0.0)


def on_linear_skin_n(load_n: FloatArray) -> FloatArray:
    """N' of a load N; 0 where there is no load."""
    load_n = np.maximum(load_n, 0.0)
    return np.asarray(2 * load_n / (1 + np.sqrt(1 + 4 * load_n / _STIFFENING_N)))


def stiffening(linear_n: FloatArray) -> FloatArray:
    """Ratio of N to N', as a function of N'."""
    return np.asarray(1 + linear_n / _STIFFENING_N)


@cache
def shipped_skin(readout: Readout = "edge") -> SkinCompliance:
    """Skin with the shipped compliance."""
    arrays = load_compliance()
    n, c_nt = len(arrays["x_mm"]), arrays["c_nt"]
    compliance = np.empty((3, n, 3, n))
    compliance[0, :, 0] = arrays["c_nn"]
    compliance[0, :, 1:] = c_nt.transpose(0, 2, 1)
    compliance[1:, :, 0] = c_nt.transpose(2, 1, 0)
    compliance[1:, :, 1:] = arrays["c_tt"].transpose(1, 0, 3, 2)
    normal = arrays[f"{readout}_from_normal"]
    tangential = arrays[f"{readout}_from_tangential"].transpose(0, 2, 1)
    return SkinCompliance(
        **{name: arrays[name] for name in ("x_mm", "y_mm", "gap_mm", "area_mm2")},
        compliance=compliance,
        side=np.concatenate([normal[:, None], tangential], axis=1),
        gradient=_gradient(arrays["x_mm"], arrays["y_mm"]),
    )


def load_compliance() -> dict[str, FloatArray]:
    """Shipped arrays of finite elements, in float64, provenance left out; signs and units in docs/contact.md.

    n points of the surface, m at the bottom, axes x and y: ``c_nn`` (n, n), ``c_nt`` (n, n, 2) and ``c_tt``
    (n, 2, n, 2) in mm/N, u_n = c_nn p + c_nt t and u_t = c_nt^T p + c_tt t. ``PART_from_normal`` and
    ``PART_from_tangential`` are the forces (N/N) on half the chip, beyond 1 mm and within 0.5 mm of the axis
    (-x, -y, +x, +y), and at each bottom point. Pressing is positive; a bonded chip can be pulled.
    """
    with np.load(shipped("config", "contact", "compliance-coarse.npz")) as file:
        return {name: np.asarray(file[name], dtype=np.float64) for name in file.files if name != "provenance"}


def _azimuth_weights(wanted_deg: FloatArray) -> FloatArray:
    """Weights (a, 4) of `_SIDES_DEG` in the trigonometric interpolant; exact there."""
    turn = np.deg2rad(wanted_deg[:, None] - _SIDES_DEG)
    return np.asarray((1 + 2 * np.cos(turn) + np.cos(turn * 2)) / 4)


def _gradient(x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Slopes of the plane fitted to the values in each node's neighbourhood, Gaussian weights."""
    dx, dy = x_mm - x_mm[:, None], y_mm - y_mm[:, None]
    weight = np.exp(-(dx**2 + dy**2) / (2 * (_REACH_MM / 2) ** 2))
    base = np.stack([np.ones_like(dx), dx, dy])
    gram = np.einsum("akn,kn,bkn->kab", base, weight, base)
    plane = np.linalg.solve(gram, (base * weight).transpose(1, 0, 2))
    return np.ascontiguousarray(plane[:, 1:].transpose(1, 0, 2))

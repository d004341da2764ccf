"""Surface of a taxel for contact model `compliance`, from the shipped arrays of finite elements."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout
from tactiled.resources import shipped

_REACH_MM = 0.35  # neighbourhood for the slope of a map at a node: two to three nodes in each direction


@dataclass(frozen=True, eq=False)
class SkinCompliance:
    """Nodes and compliance of a taxel's surface; components are (into the skin, x, y)."""

    # x_mm, y_mm, gap_mm: (n,): surface nodes, and their depth under the apex
    x_mm: FloatArray
    y_mm: FloatArray
    gap_mm: FloatArray
    area_mm2: FloatArray  # (n,): area of each node
    compliance: FloatArray  # (3, n, 3, n): mm/N
    side_azimuth_deg: FloatArray  # (s,): azimuths, equally spaced, at which the read-out areas were measured
    side: FloatArray  # (s, 3, n): force on each area by a force component on each node
    gradient: FloatArray  # (2, n, n): derivatives along x and y at the nodes of values at the nodes, 1/mm

    @classmethod
    def from_arrays(cls, arrays: dict[str, FloatArray], readout: Readout) -> "SkinCompliance":
        """Take the arrays of `fem.compliance`; ``half`` chips or areas near the ``edge`` as read-out."""
        x_mm, y_mm = arrays["x_mm"], arrays["y_mm"]
        c_nt, n = arrays["c_nt"], len(x_mm)
        compliance = np.empty((3, n, 3, n))
        compliance[0, :, 0] = arrays["c_nn"]
        compliance[0, :, 1:] = c_nt.transpose(0, 2, 1)
        compliance[1:, :, 0] = c_nt.transpose(2, 1, 0)
        compliance[1:, :, 1:] = arrays["c_tt"].transpose(1, 0, 3, 2)
        normal = arrays[f"{readout}_from_normal"]
        tangential = arrays[f"{readout}_from_tangential"].transpose(0, 2, 1)
        return cls(
            x_mm,
            y_mm,
            arrays["gap_mm"],
            arrays["area_mm2"],
            compliance,
            np.array([180.0, 270.0, 0.0, 90.0]),
            np.concatenate([normal[:, None], tangential], axis=1),
            _gradient(x_mm, y_mm),
        )

    def at_azimuths(self, azimuth_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`side` at any azimuths, and the derivatives (a, 2, n) of its normal part by the place of the force.

        Values between the known azimuths are interpolated trigonometrically.
        """
        side = np.tensordot(_azimuth_weights(azimuth_deg, self.side_azimuth_deg), self.side, 1)
        return side, np.einsum("dfl,al->adf", self.gradient, side[:, 0])


def _azimuth_weights(wanted_deg: FloatArray, known_deg: FloatArray) -> FloatArray:
    """Weights of known equally spaced azimuths in the trigonometric interpolant; exact at the known ones."""
    turn = np.deg2rad(np.asarray(wanted_deg)[:, None] - known_deg)
    count = len(known_deg)
    orders = np.arange(1, (count + 1) // 2)
    weights = 1 + 2 * np.cos(turn[..., None] * orders).sum(axis=-1)
    if count % 2 == 0:
        weights += np.cos(turn * (count // 2))
    return np.asarray(weights / count)


def _gradient(x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Slopes of the plane fitted to the values in each node's neighbourhood, Gaussian weights."""
    dx, dy = x_mm - x_mm[:, None], y_mm - y_mm[:, None]
    weight = np.exp(-(dx**2 + dy**2) / (2 * (_REACH_MM / 2) ** 2))
    base = np.stack([np.ones_like(dx), dx, dy])
    gram = np.einsum("akn,kn,bkn->kab", base, weight, base)
    plane = np.linalg.solve(gram, (base * weight).transpose(1, 0, 2))
    return np.ascontiguousarray(plane[:, 1:].transpose(1, 0, 2))


@cache
def shipped_skin(mesh: str = "coarse", readout: Readout = "edge") -> SkinCompliance:
    """Skin with the shipped compliance."""
    return SkinCompliance.from_arrays(load_compliance(mesh), readout)


def load_compliance(fineness: str = "coarse") -> dict[str, FloatArray]:
    """Shipped arrays, in float64, provenance left out."""
    with np.load(shipped("config", "contact", f"compliance-{fineness}.npz")) as file:
        return {name: np.asarray(file[name], dtype=np.float64) for name in file.files if name != "provenance"}

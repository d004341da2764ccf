"""Force on an electrode: the normal force under a part of the chip, from the forces that hold its bottom.

Nodal forces do not resolve areas smaller than a cell, so each point's force is divided as the area around it
(its shape function) lies inside or outside of the part.

For one pressure (0.83 mm radius), coarse and medium mesh against fine: half chips carry 1.3 and 0.6 % less of
a normal force and 4.5 and 1.7 % less of the couple of a tangential one, areas near the edge 4 and 2 % less of
both. (A bilinear traction with the same nodal forces overshoots between points: on the coarse mesh 3 and 12 %
for halves, 15 and 23 % for edges.)
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tools.fem.mesh import CHIP_RADIUS_MM, TaxelMesh

BoolArray = NDArray[np.bool_]
Part = Callable[[FloatArray, FloatArray], BoolArray]

SIDES = ("-x", "-y", "+x", "+y")  # resistors R1, R2, R3, R4 of the shipped array
# Sample points along each side of a face: areas near the edge are right within 1.5 %, halves within 0.5 %.
_FINE = 16
EDGE_MM = 1.0  # the areas that reproduce the paper's 0.07 N a side and its near-100 % change lie beyond this
CENTRE_MM = 0.5  # assumed radius of the common electrode
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # of a face's reference square


def side_parts(beyond_mm: float) -> list[Part]:
    """Parts of the chip beyond a distance from the axis, on each of `SIDES`; 0 gives half chips."""

    def part(axis: int, sign: float) -> Part:
        return lambda x, y: sign * (x, y)[axis] > beyond_mm

    return [part(0, -1.0), part(1, -1.0), part(0, 1.0), part(1, 1.0)]


def centre(x: FloatArray, y: FloatArray) -> BoolArray:
    """The part of the chip under the common electrode."""
    return np.hypot(x, y) < CENTRE_MM


def read_out(mesh: TaxelMesh, parts: list[Part]) -> FloatArray:
    """Weights (parts, m) that turn the forces on the bottom points into the force on each part of the chip.

    A part says whether points (x, y), mm, belong to it; the chip's rim is added.
    """
    points, faces = mesh.points_mm[mesh.bottom, :2], mesh.bottom_faces
    around, inside = np.zeros(len(points)), np.zeros((len(parts), len(points)))
    for place, weight in zip(*_samples(), strict=True):
        shape = np.prod(1 + _CORNERS * place, axis=1) / 4
        share = weight * shape * _jacobian(points[faces], place)[:, None]
        np.add.at(around, faces, share)
        x, y = np.einsum("a,fai->if", shape, points[faces])
        chip = np.hypot(x, y) < CHIP_RADIUS_MM
        for k, part in enumerate(parts):
            np.add.at(inside[k], faces, share * (part(x, y) & chip)[:, None])
    return inside / around


def surface_areas(mesh: TaxelMesh) -> FloatArray:
    """Projected area, mm2, that each surface point stands for (n,)."""
    points = mesh.points_mm[mesh.surface_faces][:, :, :2]
    area = np.zeros(len(mesh.points_mm))
    for place in _CORNERS / np.sqrt(3.0):
        shape = np.prod(1 + _CORNERS * place, axis=1) / 4
        share = shape * _jacobian(points, place)[:, None]
        np.add.at(area, mesh.surface_faces, share)
    return area[mesh.surface]


def _samples() -> tuple[FloatArray, FloatArray]:
    middle = (np.arange(_FINE) + 0.5) / _FINE * 2 - 1
    places = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    return places, np.full(len(places), 4.0 / len(places))


def _jacobian(corners: FloatArray, place: FloatArray) -> FloatArray:
    """Area of a face per unit of its reference square at a place, for faces (f, 4, 2)."""
    du = _CORNERS[:, 0] * (1 + _CORNERS[:, 1] * place[1]) / 4
    dv = _CORNERS[:, 1] * (1 + _CORNERS[:, 0] * place[0]) / 4
    pu, pv = np.einsum("a,fai->fi", du, corners), np.einsum("a,fai->fi", dv, corners)
    return np.asarray(pu[:, 0] * pv[:, 1] - pu[:, 1] * pv[:, 0])

"""What an electrode feels: the normal force under a part of the chip, from the forces that hold its bottom.

Nodal forces know no areas smaller than a cell. They are turned into a bilinear traction (its consistent nodal
forces are the given ones) and that is integrated over the part.

On the coarse mesh that traction overshoots between points. For one pressure, coarse against medium mesh:
half chips carry 3 % less of a normal force and 11 % less of the couple of a tangential one, areas near the
edge 15 and 22 % less. Sharing each point's force by the area around it instead gives 1, 2, 3 and 3 %: better,
and what to change to when the runs, and what is calibrated on them, are made anew.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from tactiled.emulator.mechanics.fem.mesh import CHIP_RADIUS_MM, TaxelMesh

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Part = Callable[[FloatArray, FloatArray], BoolArray]

SIDES = ("-x", "-y", "+x", "+y")  # resistors R1, R2, R3, R4 of the shipped array
_FINE = (
    16  # sample points along each side of a face: areas near the edge are right within 1.5 %, halves 0.5 %
)
EDGE_MM = 1.0  # the areas that reproduce the paper's 0.07 N a side and its near-100 % change lie beyond this
CENTRE_MM = 0.5  # assumed radius of the common electrode


def side_parts(beyond_mm: float) -> list[Part]:
    """The part of the chip beyond a distance from the axis, on each of `SIDES`; 0 gives half chips."""

    def part(axis: int, sign: float) -> Part:
        return lambda x, y: sign * (x, y)[axis] > beyond_mm

    return [part(0, -1.0), part(1, -1.0), part(0, 1.0), part(1, 1.0)]


def centre(x: FloatArray, y: FloatArray) -> BoolArray:
    """The part of the chip under the common electrode."""
    return np.hypot(x, y) < CENTRE_MM


def read_out(mesh: TaxelMesh, parts: list[Part]) -> FloatArray:
    """Weights that turn the forces on the bottom points into the force on each part of the chip.

    Parameters
    ----------
    parts : list of callable
        Whether points (x, y), mm, belong to the part; the chip's rim is added.

    Returns
    -------
    (len(parts), m) float64
    """
    points = mesh.points_mm[mesh.bottom, :2]
    mass = sparse.lil_array((len(points), len(points)))
    load = np.zeros((len(points), len(parts)))
    for place, weight in zip(*_samples(), strict=True):
        shape = 0.25 * np.array(
            [
                (1 - place[0]) * (1 - place[1]),
                (1 + place[0]) * (1 - place[1]),
                (1 + place[0]) * (1 + place[1]),
                (1 - place[0]) * (1 + place[1]),
            ]
        )
        area = weight * _jacobian(points[mesh.bottom_faces], place)
        x, y = np.einsum("a,fai->if", shape, points[mesh.bottom_faces])
        for corner in range(4):
            for k, part in enumerate(parts):
                inside = part(x, y) & (np.hypot(x, y) < CHIP_RADIUS_MM)
                np.add.at(load[:, k], mesh.bottom_faces[:, corner], shape[corner] * area * inside)
        block = np.einsum("f,a,b->fab", area, shape, shape)
        rows = np.broadcast_to(mesh.bottom_faces[:, :, None], block.shape).ravel()
        columns = np.broadcast_to(mesh.bottom_faces[:, None, :], block.shape).ravel()
        mass = mass + sparse.csr_array((block.ravel(), (rows, columns)), shape=mass.shape)
    return np.asarray(splu(sparse.csc_array(mass)).solve(load).T)


def surface_areas(mesh: TaxelMesh) -> FloatArray:
    """Projected area, mm2, that each surface point stands for (n,)."""
    points = mesh.points_mm[mesh.surface_faces][:, :, :2]
    area = np.zeros(len(mesh.points_mm))
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for place in corners / np.sqrt(3.0):
        shape = np.prod(1 + corners * place, axis=1) / 4
        share = shape * _jacobian(points, place)[:, None]
        np.add.at(area, mesh.surface_faces, share)
    return area[mesh.surface]


def _samples() -> tuple[FloatArray, FloatArray]:
    middle = (np.arange(_FINE) + 0.5) / _FINE * 2 - 1
    places = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    return places, np.full(len(places), 4.0 / len(places))


def _jacobian(corners: FloatArray, place: FloatArray) -> FloatArray:
    """Area of a face per unit of its reference square at a place, for faces (f, 4, 2)."""
    along = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    du = along[:, 0] * (1 + along[:, 1] * place[1]) / 4
    dv = along[:, 1] * (1 + along[:, 0] * place[0]) / 4
    pu, pv = np.einsum("a,fai->fi", du, corners), np.einsum("a,fai->fi", dv, corners)
    return np.asarray(pu[:, 0] * pv[:, 1] - pu[:, 1] * pv[:, 0])

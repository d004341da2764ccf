"""Hexahedra of one taxel: an O-grid around the chip, bottom of the chip at z = 0, z out of the skin.

In plane, from the axis outwards: a rounded square core, rings out to the bump, rings out to the chip, rings
out to the square cell of one taxel. Upwards: chip and adhesive, base, bump. PET is left out: it is 900 times
stiffer than the rubber, so the bottom of the chip is held (the paper holds the bottom of the PET).

The dimensions are those of `tactiled.emulator.mechanics.taxel_shape`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.taxel_shape import BASE_MM, BUMP_RADIUS_MM, CAP_MM, CHIP_MM, RIM_MM
from tools.fem.materials import PDMS, RTV, RUBBER, Yeoh

IntArray = NDArray[np.int64]

MATERIALS: tuple[Yeoh, ...] = (RUBBER, RTV, PDMS)
CHIP_RADIUS_MM = 1.5  # paper: chips of 3.0 mm diameter
CELL_MM = 3.5  # paper: spacing of adjacent units


@dataclass(frozen=True)
class Fineness:
    """Numbers of elements; `side` (even, so that a node lies on the axis) along each side of the core."""

    side: int
    bump_rings: int
    chip_rings: int
    cell_rings: int
    chip_layers: int
    base_layers: int
    bump_layers: int


# Numbers of unknowns from 5 k to 26 k; the middle one is for convergence.
MESHES = {
    "coarse": Fineness(8, 3, 1, 1, 2, 2, 3),
    "medium": Fineness(12, 4, 1, 2, 3, 2, 4),
    "fine": Fineness(16, 5, 2, 2, 4, 3, 4),
}


@dataclass(frozen=True, eq=False)
class TaxelMesh:
    """Points and eight-node cells of one taxel."""

    points_mm: FloatArray  # (p, 3)
    cells: IntArray  # (c, 8): bottom face, then top face, each counter-clockwise seen from above
    material: IntArray  # (c,): index into `MATERIALS`
    # surface, surface_faces: (n,) and (f, 4): points and faces of the cap, which may touch
    surface: IntArray
    surface_faces: IntArray
    # bottom, bottom_faces: (m,) and (g, 4): points and faces at z = 0, which are held
    bottom: IntArray
    bottom_faces: IntArray


def taxel_mesh(fineness: Fineness) -> TaxelMesh:
    """Mesh one taxel."""
    plane, faces, n_bump, n_chip = _plane(fineness)
    n_plane, bump_faces = len(plane), faces[:n_bump]
    low = np.concatenate(
        [
            np.linspace(0.0, CHIP_MM, fineness.chip_layers + 1),
            CHIP_MM + np.linspace(0.0, BASE_MM, fineness.base_layers + 1)[1:],
        ]
    )
    blocks = [np.column_stack([plane, np.full(n_plane, z)]) for z in low]
    bump_points = np.unique(bump_faces)  # the first ones: the plane is numbered outwards
    bump = plane[: len(bump_points)]
    height = RIM_MM + cap_mm(np.hypot(bump[:, 0], bump[:, 1]))
    for level in np.arange(1, fineness.bump_layers + 1) / fineness.bump_layers:
        blocks.append(np.column_stack([bump, low[-1] + level * height]))

    cells, material = [], []
    for layer in range(len(low) - 1):
        cells.append(np.hstack([faces + layer * n_plane, faces + (layer + 1) * n_plane]))
        kind = np.full(len(faces), MATERIALS.index(PDMS))
        if layer < fineness.chip_layers:
            kind[:n_chip], kind[n_chip:] = MATERIALS.index(RUBBER), MATERIALS.index(RTV)
        material.append(kind)
    below, top = bump_faces + (len(low) - 1) * n_plane, bump_faces + len(low) * n_plane
    for _ in range(fineness.bump_layers):
        cells.append(np.hstack([below, top]))
        material.append(np.full(n_bump, MATERIALS.index(PDMS)))
        below, top = top, top + len(bump_points)
    surface_faces = below
    return TaxelMesh(
        points_mm=np.concatenate(blocks),
        cells=np.concatenate(cells),
        material=np.concatenate(material),
        surface=np.unique(surface_faces),
        surface_faces=surface_faces,
        bottom=np.arange(n_plane),
        bottom_faces=faces,
    )


def _plane(fineness: Fineness) -> tuple[FloatArray, IntArray, int, int]:
    """Points and faces of the O-grid, numbered outwards, and how many faces lie within bump and chip."""
    n = fineness.side
    u, v = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    # A blend of square and disc keeps the core's corners from flattening; 0.56 makes cells alike in size.
    disc = np.stack([u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)], axis=-1)
    core = 0.56 * BUMP_RADIUS_MM * (0.6 * np.stack([u, v], axis=-1) + 0.4 * disc)
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    faces = [np.stack([corner.ravel() for corner in corners], axis=1)]
    points = [core.reshape(-1, 2)]

    angle = -0.75 * np.pi + np.arange(4 * n) / n * np.pi / 2
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    square = circle / np.abs(circle).max(axis=1, keepdims=True)
    inner, inner_numbers = points[0][rim], rim
    counts = []
    for outer, rings in (
        (BUMP_RADIUS_MM * circle, fineness.bump_rings),
        (CHIP_RADIUS_MM * circle, fineness.chip_rings),
        (CELL_MM / 2 * square, fineness.cell_rings),
    ):
        start = inner
        for share in np.arange(1, rings + 1) / rings:
            inner = start + share * (outer - start)
            numbers = sum(map(len, points)) + np.arange(4 * n)
            faces.append(
                np.stack([inner_numbers, numbers, np.roll(numbers, -1), np.roll(inner_numbers, -1)], axis=1)
            )
            points.append(inner)
            inner_numbers = numbers
        counts.append(sum(map(len, faces)))
    return np.concatenate(points), np.concatenate(faces), counts[0], counts[1]


def cap_mm(radius_mm: FloatArray) -> FloatArray:
    """Height of the cap over its rim at a distance from the axis: a sphere through rim and apex."""
    sphere = (BUMP_RADIUS_MM**2 + CAP_MM**2) / (2 * CAP_MM)
    inside = np.minimum(radius_mm, BUMP_RADIUS_MM)
    return np.asarray(np.sqrt(sphere**2 - inside**2) - (sphere - CAP_MM))

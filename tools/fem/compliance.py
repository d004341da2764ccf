"""The surface compliance of a taxel as data: `config/contact/compliance-<mesh>.npz`.

``python -m tools.fem.compliance coarse`` makes the one that ships.

Signs: normal displacements and forces point INTO the skin (pressing is positive), tangential ones along x
and y of the taxel; z stands for the normal everywhere, though the cap slopes by up to 27 degrees at its rim.

Arrays, n surface points and m points at the bottom; index 2 of the tangential ones is axis x, y:

``x_mm, y_mm`` (n,), ``gap_mm`` (n,) depth under the apex, ``area_mm2`` (n,) projected area a point stands for
``c_nn`` (n, n), ``c_nt`` (n, n, 2), ``c_tt`` (n, 2, n, 2), mm/N:
u_n = c_nn p + c_nt t, u_t = c_nt^T p + c_tt t
``half_from_normal`` (4, n), ``half_from_tangential`` (4, n, 2) force on half the chip at -x, -y, +x, +y, N/N
``edge_...`` the same beyond 1 mm from the axis; ``centre_...`` (1, n) and (1, n, 2) within 0.5 mm of the axis
``bottom_x_mm, bottom_y_mm`` (m,), ``bottom_from_normal`` (m, n), ``bottom_from_tangential`` (m, n, 2) nodal
forces at the bottom, for read-out areas of other shapes (`readout.read_out`)
``provenance`` one JSON string.

Forces on a part may be negative: a bonded chip can be pulled. A contact sensor cannot show that: clamp at
zero. What is under one part is not converged on the coarse mesh (`readout` says by how much).
Stored in float32; symmetric to the last bit.
"""

import json
import sys

import numpy as np

from tactiled.array import FloatArray
from tactiled.resources import shipped
from tools.fem.linear import surface_response
from tools.fem.materials import SOURCE
from tools.fem.mesh import MATERIALS, MESHES, TaxelMesh, taxel_mesh
from tools.fem.readout import EDGE_MM, Part, centre, read_out, side_parts, surface_areas


def compliance_arrays(mesh: TaxelMesh) -> dict[str, FloatArray]:
    """The arrays above, in float64 and without provenance."""
    response, reaction = surface_response(mesh)
    into = np.array([1.0, 1.0, -1.0])  # x, y, and out of the skin to into it
    response = response * into[:, None, None] * into
    reaction = reaction * into
    place = mesh.points_mm[mesh.surface]
    arrays = {
        "x_mm": place[:, 0],
        "y_mm": place[:, 1],
        "gap_mm": place[:, 2].max() - place[:, 2],
        "area_mm2": surface_areas(mesh),
        "c_nn": response[:, 2, :, 2],
        "c_nt": response[:, 2, :, :2],
        "c_tt": response[:, :2, :, :2],
        "bottom_x_mm": mesh.points_mm[mesh.bottom, 0],
        "bottom_y_mm": mesh.points_mm[mesh.bottom, 1],
        "bottom_from_normal": reaction[:, :, 2],
        "bottom_from_tangential": reaction[:, :, :2],
    }
    named_parts: tuple[tuple[str, list[Part]], ...] = (
        ("half", side_parts(0.0)),
        ("edge", side_parts(EDGE_MM)),
        ("centre", [centre]),
    )
    for name, parts in named_parts:
        felt = np.tensordot(read_out(mesh, parts), reaction, axes=1)
        arrays[f"{name}_from_normal"], arrays[f"{name}_from_tangential"] = felt[:, :, 2], felt[:, :, :2]
    return arrays


def write_compliance(fineness: str) -> str:
    """Compute and write `config/contact/compliance-<fineness>.npz`; returns its path."""
    mesh = taxel_mesh(MESHES[fineness])
    provenance = {
        "command": f"python -m tools.fem.compliance {fineness}",
        "method": "linear elasticity, B-bar hexahedra, bottom of chip and adhesive held, sides free",
        "cells": len(mesh.cells),
        "unknowns": mesh.points_mm.size,
        "materials": {m.name: {"shear_mpa": m.shear_mpa, "bulk_mpa": m.bulk_mpa} for m in MATERIALS},
        "source": SOURCE,
    }
    path = shipped("config", "contact", f"compliance-{fineness}.npz")
    single = {name: array.astype(np.float32) for name, array in compliance_arrays(mesh).items()}
    np.savez_compressed(path, allow_pickle=False, provenance=np.array(json.dumps(provenance)), **single)
    return str(path)


if __name__ == "__main__":
    print(write_compliance(sys.argv[1]))

"""Linear elasticity of a taxel mesh at small strain, and the compliance of its surface.

Eight-node hexahedra with the dilatation averaged over each cell (the B-bar method: Hughes, The Finite Element
Method, 1987, section 4.5), which keeps nearly incompressible cells from locking.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tactiled.array import FloatArray
from tools.fem.mesh import MATERIALS, TaxelMesh

_GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)
_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
)


def stiffness(mesh: TaxelMesh) -> sparse.csr_array:
    """Stiffness matrix (3 p, 3 p), N/mm; unknown ``3 * point + axis``."""
    shear = np.array([material.shear_mpa for material in MATERIALS])[mesh.material]
    bulk = np.array([material.bulk_mpa for material in MATERIALS])[mesh.material]
    corners = mesh.points_mm[mesh.cells]
    cell = np.zeros((len(mesh.cells), 24, 24))
    volume = np.zeros(len(mesh.cells))
    dilatation = np.zeros((len(mesh.cells), 24))
    for place in np.stack(np.meshgrid(_GAUSS, _GAUSS, _GAUSS), axis=-1).reshape(-1, 3):
        along = 1 + _CORNERS * place
        slope = _CORNERS * np.stack(
            [along[:, 1] * along[:, 2], along[:, 0] * along[:, 2], along[:, 0] * along[:, 1]], axis=1
        )
        jacobian = np.einsum("aj,cai->cij", slope / 8, corners)
        weight = np.linalg.det(jacobian)  # Gauss weights are 1
        gradient = np.einsum("aj,cji->cai", slope / 8, np.linalg.inv(jacobian))
        trace = gradient.reshape(-1, 24)
        # deviatoric part: mu (grad u : grad v + grad u : grad v^T - 2/3 div u div v)
        product = np.einsum("cak,cbk->cab", gradient, gradient)
        block = np.einsum("cab,ij->caibj", product, np.eye(3)) + np.einsum(
            "caj,cbi->caibj", gradient, gradient
        )
        deviator = block.reshape(-1, 24, 24) - 2 / 3 * trace[:, :, None] * trace[:, None, :]
        cell += (shear * weight)[:, None, None] * deviator
        volume += weight
        dilatation += weight[:, None] * trace
    cell += (bulk / volume)[:, None, None] * dilatation[:, :, None] * dilatation[:, None, :]
    unknown = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(-1, 24)
    rows = np.broadcast_to(unknown[:, :, None], cell.shape).ravel()
    columns = np.broadcast_to(unknown[:, None, :], cell.shape).ravel()
    size = 3 * len(mesh.points_mm)
    return sparse.csr_array((cell.ravel(), (rows, columns)), shape=(size, size))


def surface_response(mesh: TaxelMesh) -> tuple[FloatArray, FloatArray]:
    """Displacements and reactions of the taxel, held at its bottom, under unit forces on its surface points.

    Returns
    -------
    compliance : (n, 3, n, 3) float64
        Displacement, mm, of a surface point along an axis by 1 N on another along another: symmetric.
    reaction : (m, n, 3) float64
        Force along z, N, of what holds each bottom point: positive where the chip is pressed.
    """
    matrix = stiffness(mesh)
    size, n = matrix.shape[0], len(mesh.surface)
    held = np.zeros(size, dtype=bool)
    held[(3 * mesh.bottom[:, None] + np.arange(3)).ravel()] = True
    free = np.flatnonzero(~held)
    place = np.empty(size, dtype=np.int64)
    place[free] = np.arange(len(free))
    loaded = place[(3 * mesh.surface[:, None] + np.arange(3)).ravel()]
    load = np.zeros((len(free), 3 * n))
    load[loaded, np.arange(3 * n)] = 1.0
    moved = splu(matrix[free][:, free].tocsc()).solve(load)
    compliance = moved[loaded]
    compliance = 0.5 * (compliance + compliance.T)  # removes rounding errors
    reaction = matrix[3 * mesh.bottom + 2][:, free] @ moved
    return compliance.reshape(n, 3, n, 3), reaction.reshape(len(mesh.bottom), n, 3)

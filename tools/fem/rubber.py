"""The Yeoh rubbers of a taxel mesh in three dimensions, in the form that finite elements need.

Isochoric energy W(I - 3) with I = J^(-2/3) tr(F^T F); the mixed element has the energy of the volume. First
and second derivatives by F: Holzapfel, Nonlinear Solid Mechanics, 2000, sections 6.4 and 6.6.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tools.fem.mesh import MATERIALS

IntArray = NDArray[np.int64]


class CellwiseYeoh:
    """Yeoh energy with constants cell by cell.

    Parameters
    ----------
    material : (c,) int64
        Index into `mesh.MATERIALS`.
    """

    def __init__(self, material: IntArray) -> None:
        self._members = [(rubber, np.flatnonzero(material == k)) for k, rubber in enumerate(MATERIALS)]
        self.bulk_mpa = np.array([rubber.bulk_mpa for rubber in MATERIALS])[material]

    def excess(self, deformation: FloatArray) -> FloatArray:
        """I - 3 at each point; deformation gradient (3, 3, q, c)."""
        trace = np.einsum("ij...,ij...->...", deformation, deformation)
        return np.asarray(_shrink(deformation) * trace - 3)

    def continued(self, deformation: FloatArray) -> FloatArray:
        """Share of the points in the continuation of a material, by material."""
        excess = self.excess(deformation)
        return np.array(
            [float(np.mean(rubber.continued(excess[:, cells]))) for rubber, cells in self._members]
        )

    def gradient(self, x: list[FloatArray]) -> list[FloatArray]:
        """First Piola-Kirchhoff stress (3, 3, q, c), and the state, which Yeoh does not use."""
        slope, _ = self._slopes(self.excess(x[0]))
        return [slope * self._first(x[0])[0], x[-1]]

    def hessian(self, x: list[FloatArray]) -> list[FloatArray]:
        """Its derivative (3, 3, 3, 3, q, c)."""
        deformation = x[0]
        slope, curvature = self._slopes(self.excess(deformation))
        first, inverse, scale = self._first(deformation)
        trace = np.einsum("ij...,ij...->...", deformation, deformation)
        mixed = np.einsum("ij...,kl...->ijkl...", deformation, inverse)
        second = -2 / 3 * (mixed + np.moveaxis(mixed, (0, 1), (2, 3)))
        second += 2 / 9 * trace * np.einsum("ij...,kl...->ijkl...", inverse, inverse)
        second += trace / 3 * np.einsum("il...,kj...->ijkl...", inverse, inverse)
        for i in range(3):
            for j in range(3):
                second[i, j, i, j] += 1.0
        second *= slope * scale
        second += curvature * np.einsum("ij...,kl...->ijkl...", first, first)
        return [second]

    def _first(self, deformation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dI/dF, transposed inverse of F, and 2 J^(-2/3)."""
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(deformation, (0, 1), (2, 3))), (3, 2), (0, 1))
        scale = 2 * _shrink(deformation)
        trace = np.einsum("ij...,ij...->...", deformation, deformation)
        return np.asarray(scale * (deformation - trace / 3 * inverse)), np.asarray(inverse), scale

    def _slopes(self, excess: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope, curvature = np.empty_like(excess), np.empty_like(excess)
        for rubber, cells in self._members:
            slope[:, cells] = rubber.slope(excess[:, cells])
            curvature[:, cells] = rubber.curvature(excess[:, cells])
        return slope, curvature


def _shrink(deformation: FloatArray) -> FloatArray:
    """J^(-2/3); NaN where a trial step turned a cell inside out: the solver then takes a smaller one."""
    volume = np.linalg.det(np.moveaxis(deformation, (0, 1), (2, 3)))
    return np.asarray(np.where(volume > 0, volume, np.nan) ** (-2 / 3))

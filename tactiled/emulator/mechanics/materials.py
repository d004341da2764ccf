"""Materials of the skin: Yeoh rubbers with the paper's constants, and linear PET. Stresses in MPa.

Energy (Yeoh 1993, Rubber Chem. Technol. 66:754): W(I1) = C1 (I1 - 3) + C2 (I1 - 3)^2 + C3 (I1 - 3)^3.
Uniaxial, incompressible: I1 = l^2 + 2 / l, nominal stress 2 (l - l^-2) W'(I1).

With C3 < 0 that energy softens without end, so beyond the strain where W'' reaches zero W' is held constant (a
neo-Hookean solid of the stiffness reached there): the least change that keeps the stress rising with stretch and
finite elements elliptic. Whoever asks for a stress gets the flag that says so.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SOURCE = "Wang, Chen, Mei, Micromachines 2019, 10(9), 579, table 1 (least squares on compression curves)"


@dataclass(frozen=True)
class Yeoh:
    """A rubber.

    Attributes
    ----------
    c1_mpa, c2_mpa, c3_mpa : float
        Yeoh constants; c1 > 0.
    poisson : float
        At small strain; gives the bulk modulus only.
    """

    name: str
    c1_mpa: float
    c2_mpa: float
    c3_mpa: float
    poisson: float
    source: str = SOURCE

    @property
    def shear_mpa(self) -> float:
        """Shear modulus at small strain, 2 W'(3)."""
        return 2 * self.c1_mpa

    @property
    def bulk_mpa(self) -> float:
        """Bulk modulus from shear modulus and Poisson ratio (linear elasticity)."""
        return 2 * self.shear_mpa * (1 + self.poisson) / (3 * (1 - 2 * self.poisson))

    @property
    def excess_limit(self) -> float:
        """I1 - 3 where W'' = 0 and the continuation begins; infinite if that is never."""
        roots = np.roots([6 * self.c3_mpa, 2 * self.c2_mpa]) if self.c3_mpa else np.empty(0)
        if self.c3_mpa >= 0 or not roots.size:
            return float("inf")
        return max(float(roots[0]), 0.0)

    def energy(self, excess: ArrayLike) -> FloatArray:
        """W, MPa, at I1 - 3, with the continuation."""
        x = np.asarray(excess, dtype=np.float64)
        inside = np.minimum(x, self.excess_limit)
        yeoh = self.c1_mpa * inside + self.c2_mpa * inside**2 + self.c3_mpa * inside**3
        return np.asarray(yeoh + (x - inside) * self.slope(inside))

    def slope(self, excess: ArrayLike) -> FloatArray:
        """W' = dW/dI1, MPa, at I1 - 3, with the continuation."""
        x = np.minimum(np.asarray(excess, dtype=np.float64), self.excess_limit)
        return np.asarray(self.c1_mpa + 2 * self.c2_mpa * x + 3 * self.c3_mpa * x**2)

    def curvature(self, excess: ArrayLike) -> FloatArray:
        """W'' = d2W/dI1^2, MPa, at I1 - 3, zero in the continuation."""
        x = np.asarray(excess, dtype=np.float64)
        return np.where(x < self.excess_limit, 2 * self.c2_mpa + 6 * self.c3_mpa * np.minimum(x, 1e6), 0.0)

    def continued(self, excess: ArrayLike) -> BoolArray:
        """Whether the continuation answers at I1 - 3."""
        return np.asarray(np.asarray(excess, dtype=np.float64) > self.excess_limit)


RUBBER = Yeoh("conductive rubber", 0.5686, 0.0540, -0.0181, 0.47)
RTV = Yeoh("RTV adhesive", 0.5551, -0.0356, 0.0027, 0.48)
PDMS = Yeoh("PDMS", 0.7997, 0.2881, -0.0375, 0.47)

"""Materials of the skin: Yeoh rubbers with the paper's constants. Stresses in MPa.

Energy (Yeoh 1993, Rubber Chem. Technol. 66:754): W(I1) = C1 (I1 - 3) + C2 (I1 - 3)^2 + C3 (I1 - 3)^3.
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray

SOURCE = "Wang, Chen, Mei, Micromachines 2019, 10(9), 579, table 1 (least squares on compression curves)"


@dataclass(frozen=True)
class Yeoh:
    """Yeoh rubber."""

    name: str
    # c1_mpa, c2_mpa, c3_mpa: Yeoh constants; c1 > 0
    c1_mpa: float
    c2_mpa: float
    c3_mpa: float
    poisson: float  # at small strain, below 0.5; gives the bulk modulus only

    @property
    def shear_mpa(self) -> float:
        """Shear modulus at small strain, 2 W'(3)."""
        return 2 * self.c1_mpa

    @property
    def bulk_mpa(self) -> float:
        """Bulk modulus from shear modulus and Poisson ratio (linear elasticity)."""
        return 2 * self.shear_mpa * (1 + self.poisson) / (3 * (1 - 2 * self.poisson))

    def uniaxial_mpa(self, stretch: FloatArray) -> FloatArray:
        """Nominal stress 2 (l - l^-2) W'(I1) of an incompressible bar, where I1 = l^2 + 2 / l."""
        excess = stretch**2 + 2 / stretch - 3
        slope = self.c1_mpa + excess * (2 * self.c2_mpa + excess * 3 * self.c3_mpa)
        return np.asarray(2 * (stretch - stretch**-2) * slope)


RUBBER = Yeoh("conductive rubber", 0.5686, 0.0540, -0.0181, 0.47)
RTV = Yeoh("RTV adhesive", 0.5551, -0.0356, 0.0027, 0.48)
PDMS = Yeoh("PDMS", 0.7997, 0.2881, -0.0375, 0.47)

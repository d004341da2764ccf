"""Materials of the skin: Yeoh rubbers with the paper's constants. Stresses in MPa.

Energy (Yeoh 1993, Rubber Chem. Technol. 66:754): W(I1) = C1 (I1 - 3) + C2 (I1 - 3)^2 + C3 (I1 - 3)^3.
Uniaxial, incompressible: I1 = l^2 + 2 / l, nominal stress 2 (l - l^-2) W'(I1).

With C3 < 0 that energy softens without end and loses ellipticity (`stability`). Beyond the strain where W''
becomes negative such a material is continued with constant W', as a neo-Hookean solid of the stiffness
reached there. Stress and tangent are continuous, stress rises with stretch without end, and finite elements
stay elliptic. Stresses come with a flag for the continuation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.stability import any_state_limit
from tactiled.errors import ContractError

BoolArray = NDArray[np.bool_]

SOURCE = "Wang, Chen, Mei, Micromachines 2019, 10(9), 579, table 1 (least squares on compression curves)"
_EXTREME = 1e6  # stretch, and its inverse: the fourth powers in the stress stay finite


@dataclass(frozen=True, eq=False)
class Uniaxial:
    """Stress at uniaxial stretches, arrays of their shape."""

    stress_mpa: FloatArray  # nominal stress (force over undeformed area), negative in compression
    tangent_mpa: FloatArray  # derivative of the stress by the stretch
    # The stress is that of the continuation, outside the range in which the constants are valid
    continued: BoolArray


@dataclass(frozen=True)
class Yeoh:
    """Yeoh rubber with the continuation above."""

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

    @property
    def excess_limit(self) -> float:
        """I1 - 3 where the continuation begins; infinite if the energy is elliptic everywhere."""
        if np.isinf(any_state_limit(self.c1_mpa, self.c2_mpa, self.c3_mpa)):
            return float("inf")
        # Where W'' = 0 after hardening; a material that softens from the start is neo-Hookean throughout.
        return -self.c2_mpa / (3 * self.c3_mpa) if self.c3_mpa < 0 < self.c2_mpa else 0.0

    def energy(self, excess: ArrayLike) -> FloatArray:
        """W, MPa, at I1 - 3, with the continuation."""
        x = np.asarray(excess, dtype=np.float64)
        inside = np.minimum(x, self.excess_limit)
        yeoh = inside * (self.c1_mpa + inside * (self.c2_mpa + inside * self.c3_mpa))
        return np.asarray(yeoh + (x - inside) * self.slope(inside))

    def slope(self, excess: ArrayLike) -> FloatArray:
        """W' = dW/dI1, MPa, at I1 - 3, with the continuation."""
        x = np.minimum(np.asarray(excess, dtype=np.float64), self.excess_limit)
        return np.asarray(self.c1_mpa + x * (2 * self.c2_mpa + x * 3 * self.c3_mpa))

    def curvature(self, excess: ArrayLike) -> FloatArray:
        """W'' = d2W/dI1^2, MPa, at I1 - 3, zero in the continuation."""
        x = np.asarray(excess, dtype=np.float64)
        return np.where(self.continued(x), 0.0, 2 * self.c2_mpa + 6 * self.c3_mpa * x)

    def continued(self, excess: ArrayLike) -> BoolArray:
        """Return whether I1 - 3 is in the continuation."""
        return np.asarray(np.asarray(excess, dtype=np.float64) > self.excess_limit)

    def uniaxial(self, stretch: ArrayLike) -> Uniaxial:
        """Stress and tangent of an incompressible bar.

        Parameters
        ----------
        stretch : array_like
            1 + strain, above 0.

        Raises
        ------
        ContractError
            A stretch is not a positive number.
        """
        length = positive(stretch)
        excess = length**2 + 2 / length - 3
        slope = self.slope(excess)
        pull = length - length**-2
        return Uniaxial(
            stress_mpa=2 * pull * slope,
            tangent_mpa=2 * (1 + 2 * length**-3) * slope + 4 * pull**2 * self.curvature(excess),
            continued=self.continued(excess),
        )


def positive(stretch: ArrayLike) -> FloatArray:
    """Stretch as an array; `ContractError` unless all are numbers whose powers stay finite."""
    length = np.asarray(stretch, dtype=np.float64)
    if not np.all((length >= 1 / _EXTREME) & (length <= _EXTREME)):
        raise ContractError(f"stretch must be from {1 / _EXTREME:g} to {_EXTREME:g} (it is 1 + strain)")
    return length


RUBBER = Yeoh("conductive rubber", 0.5686, 0.0540, -0.0181, 0.47)
RTV = Yeoh("RTV adhesive", 0.5551, -0.0356, 0.0027, 0.48)
PDMS = Yeoh("PDMS", 0.7997, 0.2881, -0.0375, 0.47)

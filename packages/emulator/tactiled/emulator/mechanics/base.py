"""Interface of the physical contact models of taxels.

A model steps through time, because friction depends on the past. `step` is called on a fixed grid of
instants, so that chunking changes nothing; `stepper` interpolates for any instant.

Frame of a taxel: origin on the axis of its bump, x and y as in the array, z out of the skin. `base_mm` is the
place of that origin over the surface (taxel place plus travel of the skin). Forces are those on the skin.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

HeldQuantity = Literal["force", "displacement"]
Readout = Literal["edge", "half"]  # area under a side electrode, see `sides.SideWeights`

# Bits of `TaxelForces.warnings`; the forces are then the best that the model can compute.
BEYOND_REFERENCES = 1  # more load than in any finite-element run: the errors are not known
NOT_CONVERGED = 2  # the solver stopped at its iteration limit
BOTTOMED = 4  # pressed deeper than the bump is high: the load curve is extrapolated

# Largest loads on a taxel in the finite-element references (config/contact/fem-*.json), pressed and sheared.
# Up to there every material is within its stable range (their columns `continued_*` are 0).
PRESSED_REFERENCE_N, SHEARED_REFERENCE_N = 3.94, 2.5
_SHEARED = 0.01  # tangential over normal force; a press alone causes less


@dataclass(frozen=True)
class Surface:
    """Surface under the bumps.

    Attributes
    ----------
    friction : float
        Coulomb coefficient, while sliding.
    period_mm, angle_deg, depth_mm : float
        Grooves; ``depth_mm = 0`` is a flat plate. Height above the valleys is
        ``depth (1 + cos(2 pi s / period)) / 2`` with s along the groove normal (cos angle, sin angle).
    static_ratio, stribeck_mm_s : float
        Friction at rest over friction while sliding, and the speed scale of the fall (Stribeck).
    unevenness : float
        Standard deviation of friction from place to place, over its mean (`unevenness`).
    """

    friction: float
    period_mm: float = 1.0
    angle_deg: float = 0.0
    depth_mm: float = 0.0
    static_ratio: float = 1.0
    stribeck_mm_s: float = 1.0
    unevenness: float = field(default=0.0, repr=False)  # solved tables are named by the text of even plates


@dataclass(frozen=True, eq=False)
class TaxelForces:
    """Forces on the skin and state of the contact at one instant, for t taxels."""

    normal_n: FloatArray  # (t,): total normal force, 0 or more
    tangential_n: FloatArray  # (t, 2): friction force on the skin
    # (t, a): normal force on the read-out area at each azimuth, 0 or more (the sensor measures no tension)
    side_n: FloatArray
    slipping: FloatArray  # (t,): share of the contact area that slips, 0 to 1; 0 without contact
    indentation_mm: FloatArray  # (t,): approach since first touch of a flat plate
    warnings: NDArray[np.int64]  # (t,): bits `BEYOND_REFERENCES`, `NOT_CONVERGED`, `BOTTOMED`


class TaxelModel(Protocol):
    """Contact model of taxels, built with ``(surface, azimuth_deg: (a,), n_taxels)`` and more."""

    def reset(self) -> None:
        """Return to no contact and no history."""
        ...

    def step(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """Advance to the next instant.

        Parameters
        ----------
        held : {"force", "displacement"}
            Quantity that is imposed along z.
        value : (t,) float64
            Normal force, N, or indentation, mm (negative: no touch), at the end of the step.
        base_mm : (t, 2) float64
            Place over the surface at the end of the step.
        """
        ...


def beyond_references(felt: TaxelForces) -> NDArray[np.bool_]:
    """Flag taxels that bear more than any reference does; the shape of ``felt.normal_n``."""
    shear_n = np.linalg.norm(felt.tangential_n, axis=-1)
    limit_n = np.where(shear_n > _SHEARED * felt.normal_n, SHEARED_REFERENCE_N, PRESSED_REFERENCE_N)
    return np.asarray(felt.normal_n > limit_n * (1 + 1e-9))

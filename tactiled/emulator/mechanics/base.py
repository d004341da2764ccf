"""What every physical contact model (rung) takes and gives: the seam of the ladder.

A rung steps through time: friction remembers. `step` is called on a fixed grid of instants, so that how a
caller chunks time changes nothing; `stepper` makes such a rung answer at any instant.

Frame of a taxel: origin on the axis of its bump, x and y as in the array, z out of the skin. `base_mm` is
where that origin is over the surface (taxel place plus travel of the skin). Forces are those on the skin.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

HeldQuantity = Literal["force", "displacement"]

# Bits of `TaxelForces.warnings`: the number is still the best the rung has.
BEYOND_REFERENCES = 1  # more load than finite elements were asked for: a rung's errors are not known there
NOT_CONVERGED = 2  # the solver stopped at its iteration limit
BOTTOMED = 4  # pressed deeper than the bump is high: the load curve is extrapolated

# Largest loads on a taxel in the finite-element references (config/contact/fem-*.json), pressed and sheared.
# Up to there every material is within its stable range (their columns `continued_*` are 0).
PRESSED_REFERENCE_N, SHEARED_REFERENCE_N = 3.94, 2.5
_SHEARED = 0.01  # tangential over normal force: what a press sideways makes by itself is less


@dataclass(frozen=True)
class Surface:
    """What the bump is on.

    Attributes
    ----------
    friction : float
        Coulomb coefficient, while sliding.
    period_mm, angle_deg, depth_mm : float
        Grooves; ``depth_mm = 0`` is a flat plate. Height above the valleys is
        ``depth (1 + cos(2 pi s / period)) / 2`` with s along the groove normal (cos angle, sin angle).
    static_ratio, stribeck_mm_s : float
        Friction at rest over friction while sliding, and the speed over which it falls (Stribeck).
    """

    friction: float
    period_mm: float = 1.0
    angle_deg: float = 0.0
    depth_mm: float = 0.0
    static_ratio: float = 1.0
    stribeck_mm_s: float = 1.0


@dataclass(frozen=True, eq=False)
class TaxelForces:
    """What the skin feels at one instant, for t taxels.

    Attributes
    ----------
    normal_n : (t,) float64
        Total normal force, 0 or more.
    tangential_n : (t, 2) float64
        Friction force on the skin.
    side_n : (t, a) float64
        Normal force on the read-out area at each asked azimuth, 0 or more (a contact sensor cannot pull).
    slipping : (t,) float64
        Share of the contact area that slips, 0 to 1; 0 without contact.
    indentation_mm : (t,) float64
        Approach since first touch of a flat plate.
    warnings : (t,) int64
        Bits named above.
    """

    normal_n: FloatArray
    tangential_n: FloatArray
    side_n: FloatArray
    slipping: FloatArray
    indentation_mm: FloatArray
    warnings: NDArray[np.int64]


class Rung(Protocol):
    """A contact model. Built with ``(surface, azimuth_deg: (a,), n_taxels)`` and parameters of its own."""

    def reset(self) -> None:
        """No contact, no history."""
        ...

    def step(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """Advance to the next instant.

        Parameters
        ----------
        held : {"force", "displacement"}
            What is imposed along z.
        value : (t,) float64
            Normal force, N, or indentation, mm (negative: no touch), at the end of the step.
        base_mm : (t, 2) float64
            Place over the surface at the end of the step.
        dt_s : float
        """
        ...


def beyond_references(felt: TaxelForces) -> NDArray[np.bool_]:
    """Which taxels bear more than any reference does; the shape of ``felt.normal_n``."""
    shear_n = np.linalg.norm(felt.tangential_n, axis=-1)
    limit_n = np.where(shear_n > _SHEARED * felt.normal_n, SHEARED_REFERENCE_N, PRESSED_REFERENCE_N)
    return np.asarray(felt.normal_n > limit_n * (1 + 1e-9))

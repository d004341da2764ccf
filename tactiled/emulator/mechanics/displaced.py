"""What large displacements add to a linear skin, to first order (rung `compliance`).

A force acts where friction has dragged its node to, not where the node was: it has a couple more,

    pressing times displacement along the surface - friction times displacement into the skin.

What is under the bump feels it whole, the bump's own surface little of it: most of the couple arises in
layers too deep to turn the surface. And the skin stiffens: ``N = N' (1 + N' / 24 N)`` on it displaces it as
N' would a linear one. Signorini's and Coulomb's laws are homogeneous in the forces, so contact is solved for
N' and all its forces are scaled up.

The three constants make up for what first order leaves out. They are fitted to finite elements on flat plates
with friction 0.6 under 0.6 N and 2.5 N (config/contact/fem-coarse-flat-0.6-light.json, -heavy.json), which
``./run bench contact`` does not score.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.skin import SkinCompliance
from tactiled.emulator.mechanics.taxel_shape import BASE_MM, CAP_MM, CHIP_MM, RIM_MM

# Of a displacement, what the material that carries the pressure down is dragged along. Left minus right at
# full slip asks for 0.75 under 0.6 N and for 0.87 under 2.5 N.
_DRAGGED = 0.82
# Of a couple, what turns the surface. At full slip under 2.5 N the centroid of pressure is then 0.089 mm
# ahead of the apex in the skin, as in finite elements; without, 0.063 mm.
_TURNING = 0.2
# With it the skin at full slip under 2.5 N is dragged along by 0.259 mm, as in finite elements; without,
# 0.276 mm.
_STIFFENING_N = 24.0
# First order means nothing beyond: twice what friction 0.9 drags, and a bound that keeps couples from
# running away.
_LARGEST_MM = 0.6
_HEIGHT_MM = CHIP_MM + BASE_MM + RIM_MM + CAP_MM  # arm of friction at the apex over the read-out areas


def on_linear_skin_n(load_n: FloatArray) -> FloatArray:
    """N' of a load; 0 where there is none."""
    load_n = np.maximum(load_n, 0.0)
    return np.asarray(2 * load_n / (1 + np.sqrt(1 + 4 * load_n / _STIFFENING_N)))


def stiffening(linear_n: FloatArray) -> FloatArray:
    """N over N', by N'."""
    return np.asarray(1 + linear_n / _STIFFENING_N)


class Displaced:
    """Read-out and turning of one skin by forces at displaced nodes; components are (into the skin, x, y).

    Parameters
    ----------
    skin : SkinCompliance
    azimuth_deg : (a,) float64
        Of the read-out areas.
    """

    def __init__(self, skin: SkinCompliance, azimuth_deg: FloatArray) -> None:
        self._side, self._side_slope = skin.at_azimuths(azimuth_deg)
        self._arm_mm = _HEIGHT_MM - skin.gap_mm
        n = len(skin.x_mm)
        # A couple is a dipole of normal forces: by virtual work the transpose of the gradient.
        dipoles = np.concatenate(list(skin.gradient)).T
        self._by_couples = _TURNING * skin.compliance.reshape(3 * n, 3 * n)[:, :n] @ dipoles

    def turned_mm(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Displacements (3, n) by the couples of forces (3, n) at displaced nodes (3, n)."""
        moved = np.clip(moved_mm, -_LARGEST_MM, _LARGEST_MM)
        couple = force_n[0] * moved[1:] - force_n[1:] * moved[0]
        return np.asarray((self._by_couples @ couple.ravel()).reshape(3, -1))

    def side_n(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Forces on the areas (t, a), 0 or more, by forces and displacements (t, 3, n) of t taxels."""
        arm = np.clip(1 - moved_mm[:, 0] / self._arm_mm, 0.0, 1.0)
        levered = np.concatenate([force_n[:, :1], force_n[:, 1:] * arm[:, None]], axis=1)
        side = np.tensordot(levered, self._side, ([1, 2], [1, 2]))
        side += _DRAGGED * np.einsum("tn,tin,ain->ta", force_n[:, 0], moved_mm[:, 1:], self._side_slope)
        return np.maximum(side, 0.0)

"""First-order effects of large displacements on a linear skin (contact model `compliance`).

A force acts at the displaced place of its node, which adds a couple,

    pressing times displacement along the surface - friction times displacement into the skin.

The whole couple acts on the read-out areas under the bump, but only a part of it turns the bump's own
surface: most of it arises in deeper layers. Also the skin stiffens: ``N = N' (1 + N' / 24 N)`` displaces it
as N' would displace a linear skin. Signorini's and Coulomb's laws are homogeneous in the forces, so contact
is solved for N' and all its forces are scaled up.

The three constants stand for higher orders. They are fitted to finite elements on flat plates with friction
0.6 under 0.6 N and 2.5 N (config/contact/fem-coarse-flat-0.6-light.json, -heavy.json), which ``./run bench
contact`` does not score.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.skin import SkinCompliance
from tactiled.emulator.mechanics.taxel_shape import BASE_MM, CAP_MM, CHIP_MM, RIM_MM

# Part of a displacement by which the material that carries the pressure down is displaced. Left minus right
# at full slip requires 0.75 under 0.6 N and 0.87 under 2.5 N.
_DRAGGED = 0.82
# Part of a couple that turns the surface. At full slip under 2.5 N the centroid of pressure is then 0.089 mm
# ahead of the apex in the skin, as in finite elements; without, 0.063 mm.
_TURNING = 0.2
# With it the skin at full slip under 2.5 N is dragged along by 0.259 mm, as in finite elements; without,
# 0.276 mm.
_STIFFENING_N = 24.0
# Largest displacement in the couples, twice that under friction 0.9: first order is not valid beyond, and
# without a bound couples could grow without limit.
_LARGEST_MM = 0.6
_HEIGHT_MM = CHIP_MM + BASE_MM + RIM_MM + CAP_MM  # arm of friction at the apex over the read-out areas


def on_linear_skin_n(load_n: FloatArray) -> FloatArray:
    """N' of a load N; 0 where there is no load."""
    load_n = np.maximum(load_n, 0.0)
    return np.asarray(2 * load_n / (1 + np.sqrt(1 + 4 * load_n / _STIFFENING_N)))


def stiffening(linear_n: FloatArray) -> FloatArray:
    """Ratio of N to N', as a function of N'."""
    return np.asarray(1 + linear_n / _STIFFENING_N)


class DisplacementEffects:
    """Displacements and side forces by forces at displaced nodes, as (into the skin, x, y).

    Parameters
    ----------
    azimuth_deg : (a,) float64
        Azimuths of the read-out areas.
    """

    def __init__(self, skin: SkinCompliance, azimuth_deg: FloatArray) -> None:
        self._side, self._side_slope = skin.at_azimuths(azimuth_deg)
        self._arm_mm = _HEIGHT_MM - skin.gap_mm
        n = len(skin.x_mm)
        # A couple is a dipole of normal forces: by virtual work the transpose of the gradient.
        dipoles = np.concatenate(list(skin.gradient)).T
        self._by_couples = _TURNING * skin.compliance.reshape(3 * n, 3 * n)[:, :n] @ dipoles

    def turned_mm(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Displacements (3, n) by the couples of forces (3, n) at nodes displaced by (3, n)."""
        moved = np.clip(moved_mm, -_LARGEST_MM, _LARGEST_MM)
        couple = force_n[0] * moved[1:] - force_n[1:] * moved[0]
        return np.asarray((self._by_couples @ couple.ravel()).reshape(3, -1))

    def side_n(self, force_n: FloatArray, moved_mm: FloatArray) -> FloatArray:
        """Forces (t, a) on the read-out areas, 0 or more, by forces and displacements (t, 3, n)."""
        arm = np.clip(1 - moved_mm[:, 0] / self._arm_mm, 0.0, 1.0)
        levered = np.concatenate([force_n[:, :1], force_n[:, 1:] * arm[:, None]], axis=1)
        side = np.tensordot(levered, self._side, ([1, 2], [1, 2]))
        side += _DRAGGED * np.einsum("tn,tin,ain->ta", force_n[:, 0], moved_mm[:, 1:], self._side_slope)
        return np.maximum(side, 0.0)

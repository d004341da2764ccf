"""Tangential force of taxels that slip gradually, as parallel elements that stick or slide.

A ball pressed on a plane by P answers a tangential travel x (1 = gross slip) with the force
``Q = mu P (1 - (1 - x)^(3/2))`` (Cattaneo 1938; Mindlin, J. Appl. Mech. 16, 1949; Johnson, Contact
Mechanics, 7.2). Parallel springs of stiffness k_n, each with a slider of limit f_n (Iwan, J. Appl. Mech. 33,
1966), give the same curve in straight pieces. Unloading then follows the doubled curve (Masing) without a
rule for it, because a slider that turns back must move through twice its spring's travel before it slides.

All taxels share one rigid motion: two shifts and one turn. The taxel of the smaller load reaches its limit
first, since its limit grows as P and its stiffness as P^(1/3). All arrays have one row for each hypothesis
of the friction coefficient.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray

N_RINGS = 10  # leave the curve within 0.002 of mu P
MINDLIN_POWER = 1.5  # p of Q / mu P = 1 - (1 - x)^p; also its slope at x = 0
# Near gross slip no ring sticks and the tangent stiffness vanishes; this share of it keeps the step finite.
_STIFFNESS_FLOOR = 0.02
_LONGEST_STEP = 0.5  # travels at gross slip that a Newton step may take
_N_NEWTON = 2  # a step of 20 ms moves a small part of the travel; the rest is met in the next step
_TINY = 1e-12


class Rings(NamedTuple):
    """Shares of the parallel elements of one taxel.

    Attributes
    ----------
    stiffness : (rings,) float64
        Share of the initial stiffness; sums to 1.
    limit : (rings,) float64
        Share of the friction limit; sums to 1.
    """

    stiffness: FloatArray
    limit: FloatArray


def mindlin_rings(n: int = N_RINGS) -> Rings:
    """Return the rings whose loading curve joins n + 1 points of Mindlin's curve.

    Points at ``1 - x = (1 - t)^(4/3)`` with equal steps of t have the same error in every piece: the error of
    a chord is its squared length times the curvature, ``3/4 (1 - x)^(-1/2)``.
    """
    x = 1.0 - (1.0 - np.arange(n + 1) / n) ** (4.0 / 3.0)
    slope = np.diff(1.0 - (1.0 - x) ** 1.5) / np.diff(x)
    drop = slope - np.append(slope[1:], 0.0)
    return Rings(stiffness=drop / slope[0], limit=drop * x[1:])


class RingForces:
    """Forces in the rings of all taxels, for each hypothesis of friction.

    Parameters
    ----------
    friction : (hypotheses,) float64
        Friction coefficients.
    x, y : (taxels,) float64
        Places of the taxels from the point about which the turn is counted, in any unit.
    rings : Rings
    """

    def __init__(self, friction: FloatArray, x: FloatArray, y: FloatArray, rings: Rings) -> None:
        shape = (len(friction), len(x), len(rings.limit))
        self._friction = friction
        self._rings = rings
        self._x, self._y = x, y
        self._moments = np.stack([np.ones_like(x), x, y, x**2 + y**2], axis=1)
        self._turns = bool(np.any(self._moments[:, 3] > 0))
        self._force = np.zeros((2, *shape))
        self._sticks = np.ones(shape, dtype=np.bool_)

    def advance(self, load: FloatArray, wanted: FloatArray) -> None:
        """Move the taxels so that their forces sum to the measured total.

        Parameters
        ----------
        load : (taxels,) float64
            Normal loads, at least 0.
        wanted : (3,) float64
            Sum of the taxels' forces along x and y, and their moment about the origin of the places, in the
            unit of the loads (and of the places). A hypothesis that cannot bear it slides.
        """
        cap = (self._friction[:, np.newaxis] * load)[:, :, np.newaxis] * self._rings.limit
        stiffness = np.cbrt(load)
        spring = stiffness[:, np.newaxis] * self._rings.stiffness
        # Travel at gross slip is `MINDLIN_POWER` times limit over stiffness (x = 1).
        reach = (
            MINDLIN_POWER
            * self._friction
            * float(np.max(load / np.maximum(stiffness, _TINY)))
            * _LONGEST_STEP
        )
        self._return_to_limit(cap)
        for _ in range(_N_NEWTON):
            x_step, y_step = self._rigid_step(stiffness, wanted, reach)
            self._force[0] += spring * x_step[:, :, np.newaxis]
            self._force[1] += spring * y_step[:, :, np.newaxis]
            self._return_to_limit(cap)

    def taxel_forces(self) -> FloatArray:
        """Return the tangential forces (2, hypotheses, taxels)."""
        return np.asarray(self._force.sum(axis=3))

    def sliding_share(self) -> FloatArray:
        """Return the share of the initial stiffness (hypotheses, taxels) whose rings slide.

        For a ball it is ``1 - c / a`` of the stick radius c (Mindlin: tangential stiffness goes as c).
        """
        return np.asarray(1.0 - self._sticks @ self._rings.stiffness)

    def _return_to_limit(self, cap: FloatArray) -> None:
        """Shorten the forces that exceed their limits, without turning them (radial return)."""
        size = np.sqrt(self._force[0] ** 2 + self._force[1] ** 2)
        np.less(size, cap, out=self._sticks)
        self._force *= np.minimum(1.0, cap / np.maximum(size, _TINY))

    def _rigid_step(
        self, stiffness: FloatArray, wanted: FloatArray, reach: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the displacements (hypotheses, taxels) of one Newton step towards the wanted total."""
        force_x, force_y = self.taxel_forces()
        lack_x = wanted[0] - force_x.sum(axis=1)
        lack_y = wanted[1] - force_y.sum(axis=1)
        lack_m = wanted[2] - (force_y @ self._x - force_x @ self._y)
        tangent = stiffness * np.maximum(self._sticks @ self._rings.stiffness, _STIFFNESS_FLOOR)
        k, kx, ky, kr = (tangent @ self._moments).T
        k = np.maximum(k, _TINY)
        turn = np.zeros_like(k)
        if self._turns:
            about_centre = np.maximum(kr - (kx**2 + ky**2) / k, _TINY)
            turn = (lack_m + (ky * lack_x - kx * lack_y) / k) / about_centre
        across = np.maximum(np.sqrt(self._moments[:, 3].max()), _TINY)
        turn = np.clip(turn, -reach / across, reach / across)
        shift_x = np.clip((lack_x + ky * turn) / k, -reach, reach)
        shift_y = np.clip((lack_y - kx * turn) / k, -reach, reach)
        return (
            shift_x[:, np.newaxis] - turn[:, np.newaxis] * self._y,
            shift_y[:, np.newaxis] + turn[:, np.newaxis] * self._x,
        )

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
from tactiled.detect.grip.elementary import cbrt, length, sum_in_order

N_RINGS = 10  # leave the curve within 0.002 of mu P
MINDLIN_POWER = 1.5  # p of Q / mu P = 1 - (1 - x)^p; also its slope at x = 0
# Near gross slip no ring sticks and the tangent stiffness vanishes; this share of it keeps the step finite.
_STIFFNESS_FLOOR = 0.02
# Travel of a Newton step over load / stiffness and friction: half of the travel at gross slip, which is
# `MINDLIN_POWER` times limit over stiffness (x = 1).
_LONGEST_STEP = 0.5 * MINDLIN_POWER
_N_NEWTON = 2  # a step of 20 ms moves a small part of the travel; the rest is met in the next step
_REACHED = 0.99  # of the limit, for a friction that cannot bear the total: there a step is still finite
_LEAST_TURN = 1e-6  # of the stiffness against turns: one loaded taxel has none about itself
_STICKS = 1.0 - 1e-9  # of its limit: a ring that rests on it slides, however the last bits are rounded
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

    `compiled_grip.c` does the same with the same bits, so that sums over rings and taxels run over a leading
    axis, where numpy adds one term after the other if there are two hypotheses or more.

    Parameters
    ----------
    friction : (hypotheses,) float64
        Friction coefficients.
    x, y : (taxels,) float64
        Places of the taxels from the point about which the turn is counted, in any unit.
    rings : Rings
    """

    def __init__(self, friction: FloatArray, x: FloatArray, y: FloatArray, rings: Rings) -> None:
        shape = (len(x), len(friction))
        n_rings = len(rings.limit)
        self._friction = friction
        self._limit = rings.limit[:, np.newaxis, np.newaxis]
        self._stiffness = rings.stiffness[:, np.newaxis, np.newaxis]
        self._x, self._y = x[:, np.newaxis], y[:, np.newaxis]
        self._across = float(np.sqrt((x**2 + y**2).max()))
        self._least_turn = _LEAST_TURN * self._across * self._across
        self._force = np.zeros((2, n_rings, *shape))
        self._sums = np.zeros(
            (3, *shape)
        )  # forces of the taxels along x and y; share of stiffness that sticks
        self._sums[2] = 1.0

    def advance(self, load: FloatArray, wanted: FloatArray) -> None:
        """Move the taxels so that their forces sum to the measured total.

        Parameters
        ----------
        load : (taxels,) float64
            Normal loads, at least 0.
        wanted : (3,) float64
            Sum of the taxels' forces along x and y, and their moment about the origin of the places, in the
            unit of the loads (and of the places). A hypothesis that cannot bear it comes close to its limit
            in the same direction: steps towards what it cannot reach would turn it on the spot.
        """
        stiffness = cbrt(load)
        bearable = _REACHED * sum_in_order(load) / max(length(wanted), _TINY)
        least_turn = max(self._least_turn * sum_in_order(stiffness), _TINY)
        targets = wanted[:, np.newaxis] * np.minimum(self._friction * bearable, 1.0)
        load, stiffness = load[:, np.newaxis], stiffness[:, np.newaxis]
        cap = self._friction * load * self._limit
        spring = stiffness * self._stiffness
        reach = self._friction * (_LONGEST_STEP * float(np.max(load / np.maximum(stiffness, _TINY))))
        self._return_to_limit(cap)
        for _ in range(_N_NEWTON):
            x_step, y_step = self._rigid_step(stiffness, targets, reach, least_turn)
            self._force[0] += spring * x_step
            self._force[1] += spring * y_step
            self._return_to_limit(cap)

    def taxel_forces(self) -> FloatArray:
        """Return the tangential forces (2, hypotheses, taxels)."""
        return np.ascontiguousarray(self._sums[:2].swapaxes(1, 2))

    def sliding_share(self) -> FloatArray:
        """Return the share of the initial stiffness (hypotheses, taxels) whose rings slide.

        For a ball it is ``1 - c / a`` of the stick radius c (Mindlin: tangential stiffness goes as c).
        """
        return np.ascontiguousarray(1.0 - self._sums[2].T)

    def _return_to_limit(self, cap: FloatArray) -> None:
        """Shorten the forces that exceed their limits, without turning them (radial return), and sum them."""
        size = np.sqrt(self._force[0] ** 2 + self._force[1] ** 2)
        sticks = size < _STICKS * cap
        self._force *= np.minimum(cap / np.maximum(size, _TINY), 1.0)
        self._sums[:2] = self._force.sum(axis=1)
        self._sums[2] = (sticks * self._stiffness).sum(axis=0)

    def _rigid_step(
        self, stiffness: FloatArray, targets: FloatArray, reach: FloatArray, least_turn: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the displacements (taxels, hypotheses) of one Newton step towards totals (3, hypotheses)."""
        x, y = self._x, self._y
        force_x, force_y, sticking = self._sums
        lack_x = targets[0] - force_x.sum(axis=0)
        lack_y = targets[1] - force_y.sum(axis=0)
        lack_m = targets[2] - (force_y * x - force_x * y).sum(axis=0)
        # A ring that slides bears no more along its force, but as much as its spring across it.
        square = np.maximum(force_x * force_x + force_y * force_y, _TINY)
        lost = stiffness * (1.0 - np.maximum(sticking, _STIFFNESS_FLOOR)) / square
        xx = stiffness - lost * force_x * force_x
        xy = -(lost * force_x * force_y)
        yy = stiffness - lost * force_y * force_y
        turned_x, turned_y = x * xy - y * xx, x * yy - y * xy
        kxx, kxy, kyy = xx.sum(axis=0), xy.sum(axis=0), yy.sum(axis=0)
        kx, ky, kr = turned_x.sum(axis=0), turned_y.sum(axis=0), (x * turned_y - y * turned_x).sum(axis=0)
        det = np.maximum(kxx * kyy - kxy * kxy, _TINY)
        to_x, to_y = (kyy * kx - kxy * ky) / det, (kxx * ky - kxy * kx) / det
        about_centre = np.maximum(kr - to_x * kx - to_y * ky, least_turn)
        turn = (lack_m - to_x * lack_x - to_y * lack_y) / about_centre
        shift_x = (kyy * lack_x - kxy * lack_y) / det - to_x * turn
        shift_y = (kxx * lack_y - kxy * lack_x) / det - to_y * turn
        # The whole step is shortened, so that it keeps its direction.
        length = np.sqrt(shift_x * shift_x + shift_y * shift_y) + np.abs(turn) * self._across
        part = np.minimum(reach / np.maximum(length, _TINY), 1.0)
        shift_x, shift_y, turn = shift_x * part, shift_y * part, turn * part
        return shift_x - turn * y, shift_y + turn * x


def rings_numbers(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the constants of `RingForces` for taxels at places, in the order of `struct contact_numbers`."""
    across = float(np.sqrt((x**2 + y**2).max()))
    limits = _STIFFNESS_FLOOR, _LONGEST_STEP, across, _STICKS, _TINY
    return np.array([*limits, _N_NEWTON, _REACHED, _LEAST_TURN * across * across])

"""Direction of a slip and its standard deviation, from the growth of the taxels' shear over load.

Shear grows along the motion that loads the skin. On a skin that already bears shear at an angle to it, the
slip may take another direction, because friction balances the sum of both: an object that is pulled harder
slides along the sum of all pulls at the friction limit, one that is dragged by a hand follows the hand. The
direction lies between the growth and the sum at the limit, and its standard deviation reaches to both.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.detector import ContactScan
from tactiled.events.types import UNKNOWN_SD_DEG

# Of the turn from the growth to the sum at the limit: drags make a tenth of it, pulls two thirds.
_TURNS, _TURNS_SD = 0.4, 0.33
_SHARED = 1.1  # taxels share some of their error (a tilt of the load), which no spread shows
_MODEL_SD = 0.05  # radians: resistors that are 5 % unequal turn one taxel by so much
_AVERAGED = 3  # scans at each end of the growth


class Direction(NamedTuple):
    """Direction of the skin's motion over the surface, from +x towards +y."""

    angle_deg: float
    sd_deg: float


def direction(scan: ContactScan, past: Sequence[FloatArray]) -> Direction:
    """Return the direction of a slip; the sd is `UNKNOWN_SD_DEG` where the skin turns on the spot.

    Parameters
    ----------
    scan : ContactScan
    past : sequence of (2, taxels) float64
        Shear over the total load, of the newest scans up to this one.
    """
    shears = np.array(past)  # (scans, 2, taxels)
    totals = shears.sum(axis=2)
    now = shears[-_AVERAGED:].mean(axis=0)
    change = now.sum(axis=1) - totals
    start = int(np.argmax((change**2).sum(axis=1)))
    grown = now - shears[max(0, start - _AVERAGED + 1) : start + _AVERAGED].mean(axis=0)
    x, y = grown.sum(axis=1)
    size = math.hypot(x, y)
    ratio = scan.model.trend.value
    if size <= 1e-9 or math.hypot(ratio[0], ratio[1]) < abs(float(ratio[2])):
        return Direction(0.0, UNKNOWN_SD_DEG)
    along = np.array([x, y]) / size
    across = along[0] * grown[1] - along[1] * grown[0]
    n = len(across)
    spread = _SHARED * math.sqrt(n / max(n - 1, 1) * float((across**2).sum())) / size
    limit = float(scan.model.friction.friction @ scan.model.friction.weights)
    turn = _open_turn(along, now.sum(axis=1), limit)
    angle = math.atan2(-along[1], -along[0]) + _TURNS * turn
    sd = math.sqrt(_MODEL_SD**2 / n + spread**2 + (_TURNS_SD * turn) ** 2)
    return Direction(math.remainder(math.degrees(angle), 360.0), min(UNKNOWN_SD_DEG, math.degrees(sd)))


def _open_turn(along: FloatArray, total: FloatArray, limit: float) -> float:
    """Return the angle from the growth to the total shear at the friction limit."""
    ahead, across = float(along @ total), float(along[0] * total[1] - along[1] * total[0])
    at_limit = max(ahead, math.sqrt(max(limit**2 - across**2, 0.0)), 1e-9)
    return math.atan2(across, at_limit)

"""Direction of a slip and its standard deviation, from the growth of the taxels' shear over load.

Shear grows along the motion that loads the skin. Three things make the direction of the growth another than
that of the slip, and each has its part in the standard deviation:

- Noise and unequal gains turn each taxel on its own: their spread is measured.
- On a skin that already bears shear at an angle to it, the slip may take another direction, because friction
  balances the sum of both: an object that is pulled harder slides along the sum of all pulls at the friction
  limit, one that is dragged by a hand follows the hand. The direction lies between the two.
- The course of the growth bends. Before gross slip the motion may have turned, so that the bend is
  uncertainty. Near the friction limit the course bends because sides of taxels are relieved of their whole
  load and taxels slip one after another: at gross slip the direction is that of the first half of the growth.
"""

import math
from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.filter import ContactFilter
from tactiled.events.types import UNKNOWN_SD_DEG

# physical: of the turn from the growth to the sum at the limit: drags make a tenth of it, pulls two thirds.
_TURNS, _TURNS_SD = 0.4, 0.33
_MODEL_SD = 0.05  # derived: radians: resistors that are 5 % unequal turn one taxel by so much
_FEWEST = 4  # derived: taxels whose spread has a variance: fewer have no more than three degrees of freedom
# prior: of the square of the largest change of shear: noise makes less
_GREW = 0.1
AVERAGED = 3  # choice: scans at each end of the growth, if they take no longer than `DIRECTION_S`
# derived: of the angle from the growth to its first half: what that half still has of the bend of the second.
_BEND_LEFT = 0.2


class Direction(NamedTuple):
    """Direction of the skin's motion over the surface, from +x towards +y."""

    angle_deg: float
    sd_deg: float


def direction(contact: ContactFilter, shears: FloatArray, n_averaged: int, *, is_gross: bool) -> Direction:
    """Return the direction of a slip; the sd is `UNKNOWN_SD_DEG` where the skin turns on the spot.

    Parameters
    ----------
    shears : (scans, 2, taxels) float64
        Shear over the total load, of the newest scans up to this one.
    """
    totals = shears.sum(axis=2)
    now = shears[-n_averaged:].mean(axis=0)
    start = _grows_from(totals, now.sum(axis=1), n_averaged)
    before = shears[max(0, start - n_averaged + 1) : start + n_averaged].mean(axis=0)
    # Not np.hypot, which is the C library's: its last bit depends on the processor.
    size = math.hypot(*(now - before).sum(axis=1))
    load = contact.load
    turns = abs(contact.moment / load) > math.hypot(contact.total_x / load, contact.total_y / load)
    if size <= 1e-9 or turns:
        return Direction(0.0, UNKNOWN_SD_DEG)
    total, along = now.sum(axis=1), (now - before).sum(axis=1) / size
    slides = is_gross or contact.p_sliding_now > 0.5 * contact.p_incipient
    if slides and float(along @ total) < 0:  # shear that falls while the contact slides opposes the slip
        return _opposed_to(total, _spread(now, contact))
    turn = _open_turn(along, total, contact.friction_now[1])
    bend = _bend(totals[start:] - before.sum(axis=1), along, size)
    angle = _TURNS * turn + (bend if slides else 0.0)
    sd = math.hypot(_spread(now - before, contact), _TURNS_SD * turn, (_BEND_LEFT if slides else 1.0) * bend)
    cos, sin = math.cos(angle), math.sin(angle)
    return _opposed_to(np.array([cos * along[0] - sin * along[1], sin * along[0] + cos * along[1]]), sd)


def _grows_from(totals: FloatArray, now: FloatArray, n_averaged: int) -> int:
    """Return the scan from which shear grew to its present value (2,).

    It is the one of the largest change; but where shear was released first, the one at which least was left.
    Where shear has hardly grown since, it fell and rests: what is left of the change is noise.
    """
    change = ((now - totals) ** 2).sum(axis=1)
    farthest = int(np.argmax(change))
    released = (totals[farthest : max(farthest + 1, len(totals) - n_averaged)] ** 2).sum(axis=1)
    least = farthest + int(np.argmin(released))
    grows = (totals[least] ** 2).sum() < now @ now and change[least] > _GREW * change[farthest]
    return least if grows else farthest


def opposed(contact: ContactFilter, shears: FloatArray) -> Direction:
    """Return the direction that the shears (scans, 2, taxels) oppose: that of a contact that slides."""
    now = shears.mean(axis=0)
    if math.hypot(*now.sum(axis=1)) <= 1e-9:
        return Direction(0.0, UNKNOWN_SD_DEG)
    return _opposed_to(now.sum(axis=1), _spread(now, contact))


def _opposed_to(shear: FloatArray, sd: float) -> Direction:
    """Return the direction of the motion that a shear opposes; `sd` in radians."""
    angle_deg = math.degrees(math.atan2(-shear[1], -shear[0]))
    return Direction(angle_deg, min(UNKNOWN_SD_DEG, math.degrees(sd)))


def _spread(shear: FloatArray, contact: ContactFilter) -> float:
    """Return the standard deviation of the direction of the sum of shears (2, taxels), in radians.

    The sum across the direction has Student's t distribution with one degree of freedom less than taxels,
    whose variance exceeds the estimated one by (n - 1) / (n - 3).
    """
    total = shear.sum(axis=1)
    size = max(math.hypot(total[0], total[1]), 1e-12)
    n = shear.shape[1]
    if n < _FEWEST:
        return math.hypot(_MODEL_SD / math.sqrt(n), math.sqrt(2) * contact.signs.ratio_noise / size)
    across = (total[0] * shear[1] - total[1] * shear[0]) / size
    return math.sqrt(n / (n - 3) * float((across**2).sum())) / size


def _bend(course: FloatArray, along: FloatArray, size: float) -> float:
    """Return the angle from a growth of shear to its first half.

    Parameters
    ----------
    course : (scans, 2) float64
        Growth up to each scan.
    along : (2,) float64
        Direction of all of it.
    size : float
        Length of all of it.
    """
    part = course @ along / size
    middle = int(np.argmin(np.abs(part - 0.5)))
    near = course[max(0, middle - 1) : middle + 2].mean(axis=0)
    return math.atan2(2.0 * float(along[0] * near[1] - along[1] * near[0]), size)


def _open_turn(along: FloatArray, total: FloatArray, limit: float) -> float:
    """Return the angle from the growth to the total shear at the friction limit."""
    ahead, across = float(along @ total), float(along[0] * total[1] - along[1] * total[0])
    at_limit = max(ahead, math.sqrt(max(limit**2 - across**2, 0.0)), 1e-9)
    return math.atan2(across, at_limit)

"""Direction of a slip and its standard deviation, from a growth of shear.

Shear grows along the motion that loads the skin. On a skin that already bears shear at an angle to it, the
slip may take another direction, because friction balances the sum of both. An object that is pulled harder
and harder begins to slide along the sum of all pulls at the friction limit; one that is dragged by a hand
follows the hand. The turn from the growth of shear to the sum at the limit is therefore uncertain: drags make
about a tenth of it, pulls about two thirds. The stated direction lies between, and its standard deviation
covers both.

Further errors are included: the spread of the taxels (noise, unequal resistors), a common bend of all
taxels, and relieved sides. A side that has lost its load no longer follows the growth. The opposite side may
then have changed by twice as much, so the difference between the two adds to the uncertainty.
"""

import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.response import AXES, PRESSURE, UNEQUAL_SHEAR, motion
from tactiled.events.types import UNKNOWN_SD_DEG

# One taxel shows no spread: resistors that are 5 % unequal turn it by so much (radians), and then its noise.
_ONE_TAXEL_SD = 0.05
# Taxels share some of their error (a tilt of the load), which no spread shows; and radians that the divider's
# bend turns them all. With both, 70, 71 and 67 % of directions lie within one sigma in the three settings,
# on seeds 1001 to 1024 of the physical families.
_SHARED = 1.1
_MODEL_SD = 0.004
# Part of its other side that a relieved side still reads, where the first taxels are relieved: 0.4 to 0.55
# where all are.
_RELIEVED = 0.6
# Shear over pressure at the limit, in the middle of dry skins: pairs show 1.9 times friction, 0.3 to 0.9.
_LIMIT = 1.1
# Of the turn that is open: drags 0 to 0.3, pulls 0.4 to 1, on 32 scenes of both whose skin was sheared at 20
# to 110 degrees to the growth.
_TURNS, _TURNS_SD = 0.4, 0.33


def direction(
    evidence: ShearEvidence, along: FloatArray, change: FloatArray, now: FloatArray
) -> tuple[float, float]:
    """Return direction and sigma in degrees; sigma is `UNKNOWN_SD_DEG` where the skin turns on the spot.

    Parameters
    ----------
    evidence : ShearEvidence
        Of an array with shear channels.
    along : (3,) float64
        Unit vector of the growth.
    change : (channels,) float64
        Rise of each reading.
    now : (7,) float64
        Newest response.
    """
    size = float(np.hypot(along[0], along[1]))
    if size <= abs(float(along[2])):
        return 0.0, UNKNOWN_SD_DEG
    towards = along[:2] / size
    open_turn = _open_turn(towards, now)
    angle = math.atan2(towards[1], towards[0]) + _TURNS * open_turn
    sd = math.hypot(
        _MODEL_SD,
        _spread(evidence, towards, change),
        _hidden(evidence, towards, change, now),
        _TURNS_SD * open_turn,
    )
    return math.remainder(math.degrees(angle), 360.0), min(UNKNOWN_SD_DEG, math.degrees(sd))


def _spread(evidence: ShearEvidence, towards: FloatArray, change: FloatArray) -> float:
    """Standard error of the direction of a sum of taxels that point to different sides."""
    x, y = (evidence.shear_weights @ change)[:, evidence.taxels]
    total = float(np.hypot(x.sum(), y.sum()))
    n = len(x)
    if total == 0:
        return np.pi
    if n < 2:
        noise = evidence.noise(np.array([*towards, 0.0]))
        return math.hypot(_ONE_TAXEL_SD, math.sqrt(2) * noise / total)
    across = towards[0] * y - towards[1] * x
    return _SHARED * math.sqrt(n / (n - 1) * float((across**2).sum())) / total


def _hidden(evidence: ShearEvidence, towards: FloatArray, change: FloatArray, now: FloatArray) -> float:
    """Return the angle by which relieved sides may bend the direction of the growth."""
    grown = evidence.weights @ change
    halves = np.stack([now, now - grown])[:, :PRESSURE].reshape(2, 2, AXES)[..., :2]  # (scan, half, axis)
    relieved = (halves.min(axis=1) < _RELIEVED * halves.max(axis=1)).any(axis=0)
    both = grown[:PRESSURE].reshape(2, AXES)[:, :2].sum(axis=0)  # rising and falling side: none if all tell
    size = float(np.hypot(*motion(grown)[:2]))
    across = towards[::-1] * np.where(relieved, both, 0.0)
    return float(np.hypot(*across)) / size if size > 0 else 0.0


def _open_turn(towards: FloatArray, now: FloatArray) -> float:
    """Return the angle from the growth to the total shear at the friction limit."""
    x, y = motion(now)[:2] / max(float(now[PRESSURE]), 1.0)
    ahead, across = float(towards[0] * x + towards[1] * y), float(towards[0] * y - towards[1] * x)
    at_limit = max(ahead, math.sqrt(max(_LIMIT**2 - across**2, 0.0)))
    return math.atan2(math.copysign(max(abs(across) - UNEQUAL_SHEAR, 0.0), across), at_limit)

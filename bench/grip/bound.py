"""Cramer-Rao bound of utilisation: what the shares of the taxels tell in one scan, at best.

The bound takes Mindlin's curve for true, and stiffness and friction of all taxels for alike. The noise, the
prior of friction and the scatter of the taxels' gains remain.
"""

import numpy as np
from scipy.optimize import brentq

from bench.worlds.world import World
from tactiled.array import FloatArray
from tactiled.detect.grip.observe import Responses

PRIOR_SD = 0.6  # of log friction, as `GripParams.friction_log_sd`
_STEP = 1e-3  # of log friction, for the derivative
_EVERY = 10  # scans
_LEAST_USED, _MOST_USED = 0.5, 0.99


def shares(load: FloatArray, friction: float, total: float) -> FloatArray:
    """Return the shears (taxels,) of taxels on one rigid plate by Mindlin's curve.

    Parameters
    ----------
    load : (taxels,) float64
    friction : float
    total : float
        Shear of all taxels together, less than friction bears.
    """
    limit = friction * load
    # Travel over that of gross slip of each taxel, for a travel of 1: stiffness over limit goes as P^(-2/3).
    ease = load ** (1 / 3) / np.maximum(limit, 1e-12)

    def borne(travel: float) -> FloatArray:
        return np.asarray(limit * (1 - (1 - np.minimum(travel * ease, 1.0)) ** 1.5))

    farthest = float(1 / ease[load > 0].min())
    return borne(float(brentq(lambda travel: borne(travel).sum() - total, 0.0, farthest)))


def utilisation_sd(load: FloatArray, used: float, noise_sd: float, gain_sd: float) -> float:
    """Return the least standard deviation of utilisation.

    Parameters
    ----------
    load : (taxels,) float64
    used : float
        True utilisation.
    noise_sd : float
        Of a taxel's shear, over its friction coefficient, in the unit of `load`.
    gain_sd : float
        Of the logarithm of a taxel's gain.
    """
    total = used * float(load.sum())
    shear = shares(load, 1.0, total)
    slope = (shares(load, np.exp(_STEP), total) - shear) / _STEP
    information = float((slope**2 / (noise_sd**2 + (gain_sd * shear) ** 2)).sum()) + 1 / PRIOR_SD**2
    return float(used / np.sqrt(information))


def bounds(world: World, gain_sd: float) -> FloatArray:
    """Return the bound at some scans of a world, with a utilisation from one half up and no gross slip."""
    responses = Responses(world.array)
    shear_sd = responses.noise(np.full(world.array.n_channels, 1e-3 * world.noise_mv))[0]
    scans = np.flatnonzero(
        (world.utilisation >= _LEAST_USED) & (world.utilisation < _MOST_USED) & ~world.gross
    )
    found = []
    for scan in scans[::_EVERY]:
        load = np.maximum(responses.of(world.block.volts[scan])[0], 0.0)
        if load.sum() > 0:
            used = float(world.utilisation[scan])
            found.append(utilisation_sd(load, used, shear_sd / world.static_friction, gain_sd))
    return np.array(found)

"""Shears of taxels under a rigid object that is pulled once, by Mindlin's curve: no code of the detectors."""

import numpy as np

from tactiled.array import FloatArray


def slid_to(
    load: FloatArray, travel: FloatArray, mu: float, motion: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return shears (n, 2, taxels) along the motion of each taxel.

    A ball's stiffness goes as the cube root of its load, its limit as the load: the lightly loaded taxel
    slips first, ``Q = mu P (1 - (1 - x)^(3/2))`` (Johnson, Contact Mechanics, 7.2).

    Parameters
    ----------
    load : (n, taxels) float64
    travel : (n,) float64
        From 0 to 1, at which the last taxel slips.
    mu : float
    motion : two (taxels,) float64
        Motion of the skin at the taxels, along x and y.
    """
    size = np.hypot(*motion)
    reach = np.cbrt(load) ** 2 / np.maximum(size, 1e-12)
    x = np.minimum(travel[:, np.newaxis] * reach.max(axis=1, keepdims=True) / np.maximum(reach, 1e-12), 1.0)
    force = mu * load * (1.0 - (1.0 - x) ** 1.5)
    along = np.stack(motion) / np.maximum(size, 1e-12)
    return np.asarray(force[:, np.newaxis] * along)


def travel_for(load: FloatArray, used: FloatArray) -> FloatArray:
    """Return the travels (n,) of a shift at which loads (taxels,) use parts (n,) of the limit."""
    grid = np.linspace(0.0, 1.0, 2001)
    force = slid_to(np.tile(load, (len(grid), 1)), grid, 1.0, (np.ones_like(load), np.zeros_like(load)))
    return np.interp(used, force.sum(axis=(1, 2)) / load.sum(), grid)

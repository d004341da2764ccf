"""Channels that make loads and shears of the taxels, and the sides of the taxels."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.fast import RelievedSides

_TINY = 1e-12  # derived


def own_channels(weights: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the few channels that make each response, and their weights.

    Parameters
    ----------
    weights : (kinds, taxels, channels) float64

    Returns
    -------
    (n, kinds, taxels) int64, (n, kinds, taxels) float64
        Indices and weights; a weight is 0 where a response has fewer channels.
    """
    n_most = max(1, int(np.count_nonzero(weights, axis=2).max()))
    own = np.argsort(weights == 0, axis=2, kind="stable")[..., :n_most]
    own_weights = np.take_along_axis(weights, own, axis=2)
    return (
        np.ascontiguousarray(own.transpose(2, 0, 1), dtype=np.int64),
        np.ascontiguousarray(own_weights.transpose(2, 0, 1)),
    )


class Responses:
    """Weights that make loads and shears of the taxels out of readings.

    Attributes
    ----------
    weights : (3, taxels, channels) float64
        Load, shear along x and along y of each taxel. Shear is the force of the object on the skin, so that
        it opposes the motion of the skin.
    own, own_weights : (n, 3, taxels)
        `own_channels` of them.
    taxel_channels : (taxels, channels) bool
        True where a channel is part of a taxel's load or shear.
    """

    def __init__(self, array: Array) -> None:
        self.weights = np.concatenate([array.normal_weights()[np.newaxis], -array.shear_weights()])
        self.own, self.own_weights = own_channels(self.weights)
        self.taxel_channels = np.any(self.weights != 0, axis=0)

    def of(self, volts: FloatArray) -> FloatArray:
        """Return load, shear x and shear y (3, taxels) of one scan (channels,)."""
        return np.asarray((self.own_weights * volts[self.own]).sum(axis=0))


def relieved_sides(array: Array) -> RelievedSides | None:
    """Return the correction of taxels with relieved sides; None where taxels have no opposed sides."""
    is_side = np.array(array.channel_kind) == "side"
    shear = -array.shear_weights()
    sides = np.concatenate([np.maximum(shear, 0.0), np.maximum(-shear, 0.0)]) * is_side
    even = sides.sum(axis=2).reshape(-1)
    if not np.all(even > 0):
        return None
    own, weights = own_channels(sides)
    return RelievedSides(own.reshape(-1), weights.reshape(-1), np.maximum(even, _TINY))

"""Response of the whole array to tangential motion: seven whole numbers per scan.

Noise of single channels averages out where the taxels agree, so decisions are made on a few means:

* x, y: mean over the taxels of the opposed pairs (R1 - R3, R2 - R4) or of the shear channels: the skin
  moves along (x, y).
* turn: mean of (r x s) / mean |r| over taxels at r from their middle: a skin that turns on the spot moves
  each taxel another way, and x and y see nothing of it.
* pressure: mean of the taxels' pressure responses, against which the others are compared.

Arrays without shear channels have x and y too: first moments of the pressure about the middle of the array,
over the mean distance from it. A load that shifts between taxels moves them; a load that grows in place
moves them no more than pressure times the shift of its centre. They tell no direction of motion.

Each axis is kept as two halves, the channels that rise with motion along it and those that fall: long before
gross slip the falling side of a pair may be relieved of all it carries and read nothing, and the difference
bends there for no reason of friction. The rising side goes on.

A taxel with a reading missing drops out of every mean, since half a pair would take pressure for shear.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.pairs import whole_weights

AXES = 3  # x, y, turn
RISING, FALLING, PRESSURE = slice(0, 3), slice(3, 6), 6  # columns of `responses`
COLUMNS = 7
# Readings are whole within 2^23 and an axis weighs at most a few of them; what is larger is clipped, so that
# filters of whole weights stay exact (`slip.filters`).
LARGEST = 2.0**24
# A side that has lost all its load still reads what spreads under its electrodes from the opposite side: 0.41
# to 0.45 of the reading there, on scenes of 8 to 16 N.
_UNLOADED_PART = 0.5
UNEQUAL_SHEAR = 0.07  # shear over pressure that unequal resistors (5 %) show where there is none


class ResponseModel:
    """Weights from readings to responses.

    Parameters
    ----------
    array : Array

    Attributes
    ----------
    has_direction : bool
        The array has shear channels: x and y are those of the motion.
    needs : (taxels, channels) float64
        1 for the channels that a taxel's response needs.
    pressed : (channels,) float64
        Readings under an even pressure of 1.
    """

    def __init__(self, array: Array) -> None:
        self.has_direction = array.has_shear
        self._x_mm, self._y_mm = array.x_mm, array.y_mm
        self._shear = array.shear_weights()
        self._normal = array.normal_weights()
        needed = (self._shear != 0).any(axis=0) | (self._normal != 0)  # (taxels, channels)
        self.needs = needed.astype(np.float64)
        kinds = np.array(array.channel_kind)
        self.pressed = np.where((kinds == "side") | (kinds == "normal"), array.sign, 0.0)
        # A side channel belongs to one half; a shear channel, which goes both ways, half to each.
        self._two_way = kinds != "side"

    def whole_taxels(self, ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the taxels (..., taxels) whose channels are all valid, from (..., channels)."""
        return np.asarray((~ok).astype(np.float64) @ self.needs.T == 0)

    def worst(self, of_channels: FloatArray) -> FloatArray:
        """Return the largest value (taxels,) over each taxel's needed channels."""
        return np.asarray((self.needs * of_channels).max(axis=1))

    def weights(self, taxels: NDArray[np.bool_]) -> FloatArray:
        """Return the weights (7, channels) of the means over some taxels (taxels,); zero without taxels.

        Multiples of 2^-20, so that sums over whole readings are exact in any order.
        """
        n = int(taxels.sum())
        axes = np.zeros((AXES, self._normal.shape[1]))
        if n == 0:
            return np.zeros((COLUMNS, self._normal.shape[1]))
        x, y = self._x_mm - self._x_mm[taxels].mean(), self._y_mm - self._y_mm[taxels].mean()
        reach = np.hypot(x, y)[taxels].mean()
        used = taxels.astype(np.float64) / n
        from_middle = np.stack([x, y]) * used / reach if reach > 0 else np.zeros((2, len(used)))
        if self.has_direction:
            axes[:2] = used @ self._shear
            axes[2] = from_middle[0] @ self._shear[1] - from_middle[1] @ self._shear[0]
        else:
            axes[:2] = from_middle @ self._normal
        rising = np.where(self._two_way, axes / 2, np.maximum(axes, 0.0))
        return whole_weights(np.concatenate([rising, rising - axes, [used @ self._normal]]))


def responses(weights: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the whole responses of readings (n, channels) on the grid.

    Returns
    -------
    (n, 7) float64
        The rising half of x, y and turn, their falling half, pressure. Motion is rising less falling.
    """
    return np.asarray(np.clip(np.rint(steps @ weights.T), -LARGEST, LARGEST))


def motion(rows: FloatArray) -> FloatArray:
    """Return the response (..., 3) along x, y and turn, of whole responses (..., 7)."""
    return np.asarray(rows[..., RISING] - rows[..., FALLING])


def rising_half(along: FloatArray) -> FloatArray:
    """Return the weights (6,) of the halves of the axes that rise with motion along a unit vector (3,)."""
    return np.concatenate([np.maximum(along, 0.0), np.maximum(-along, 0.0)])


def unit(vector: FloatArray) -> FloatArray:
    """Scale a vector to length 1; zero stays zero."""
    size = float(np.sqrt((vector**2).sum()))
    return vector / size if size > 0 else vector


def moved(before: FloatArray, now: FloatArray) -> FloatArray:
    """Return the change (3,) of the response between two scans (7,), without fully relieved halves."""
    halves = np.stack([before[:PRESSURE], now[:PRESSURE]]).reshape(2, 2, AXES)  # (scan, half, axis)
    lowest = halves.min(axis=0)
    change = halves[1] - halves[0]
    both = change[0] - change[1]
    rising_only = lowest[1] < _UNLOADED_PART * lowest[0]
    falling_only = lowest[0] < _UNLOADED_PART * lowest[1]
    return np.asarray(np.where(rising_only, 2 * change[0], np.where(falling_only, -2 * change[1], both)))

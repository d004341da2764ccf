"""Loads and shears of taxels of which one side has lost its load.

Shear presses one side of a taxel and relieves the opposite one. From where that side bears nothing it reads
what spreads under its electrodes from its neighbours: its reading then grows with theirs, so that the
difference of the two sides bends, and their mean grows though the load does not. Friction would bend the
shear in the same way. The pressed side goes on as before. So from then on, the shear of that axis is taken
from the pressed side alone, in the proportion that it had, and the load from the other pair of sides. Where
that pair has a relieved side, too, the load stays where it was.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.observe import own_channels

# Part of the pressed side's reading, below which the opposite one has lost its load: it then reads 0.41 to
# 0.48 of it (finite elements of the 2019 taxel under 8 to 16 N).
_RELIEVED = 0.5
_MOST_SPREAD = (
    1.3  # of the mean of all sides over the load, where some are relieved: 1.02 to 1.16 on the same
)
_LEAST_PRESSED = 0.1  # of the load, by which a side must be pressed for its part of the shear to be known
_TINY = 1e-12


class RelievedSides:
    """Correction of loads and shears, scan by scan.

    Parameters
    ----------
    array : Array
    """

    def __init__(self, array: Array) -> None:
        is_side = np.array(array.channel_kind) == "side"
        shear = -array.shear_weights()
        sides = np.concatenate([np.maximum(shear, 0.0), np.maximum(-shear, 0.0)]) * is_side
        even = sides.sum(axis=2).reshape(2, 2, array.n_taxels)
        self.own, self.weights = own_channels(sides)
        # Arrays whose taxels have no opposed sides need no correction.
        self.is_needed = bool(np.all(even > 0))
        # Readings of the sides (half, axis, taxel) under an even load of 1.
        self.even = np.maximum(even, _TINY)
        self._load = np.zeros(array.n_taxels)
        self._proportion, self._weight = np.zeros((2, 2, array.n_taxels))
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        self.relieved = np.zeros_like(self._proportion, dtype=np.bool_)
        """True for the pairs, by axis and taxel, that are read from one side."""
        self._load[:] = 0.0
        self._proportion[:], self._weight[:] = 2.0, _TINY

    def correct(self, response: FloatArray, readings: FloatArray) -> None:
        """Replace loads and shears (3, taxels) of a scan where readings (channels,) show a relieved side."""
        if not self.is_needed:
            return
        side = (self.weights * readings[self.own]).sum(axis=0).reshape(self.even.shape) / self.even
        high, low = side.max(axis=0), side.min(axis=0)
        # A taxel that is lifted has no pressed side: its sides read noise, each less than half of the other.
        self.relieved = relieved = (low < _RELIEVED * high) & (high > _LEAST_PRESSED * self._load)
        whole = ~relieved.any(axis=0)
        other = _other_pair(side, relieved)
        held = np.where(np.isfinite(other), other, self._load)
        self._load[:] = np.where(whole, response[0], np.maximum(held, response[0] / _MOST_SPREAD))
        # Beyond the load that the other pair reads: the same one before and after a side is relieved.
        pressed = high - np.where(relieved, self._load, side.mean(axis=0))[::-1]
        known = ~relieved & (pressed > _LEAST_PRESSED * self._load)
        # Least squares over the contact: the error of a single scan would last while the side is relieved.
        moved = np.where(known, pressed, 0.0)
        self._weight += moved * moved
        self._proportion += moved * (np.abs(response[1:]) - self._proportion * moved) / self._weight
        if np.all(whole):
            return
        sign = np.where(side[0] >= side[1], 1.0, -1.0)
        shear = sign * self._proportion * np.maximum(pressed, 0.0)
        response[1:] = np.where(relieved, shear, response[1:])
        response[0] = self._load


def _other_pair(side: FloatArray, relieved: NDArray[np.bool_]) -> FloatArray:
    """Return the least load (taxels,) of the pairs without a relieved side; infinite without such a pair."""
    return np.asarray(np.where(relieved, np.inf, side.mean(axis=0)).min(axis=0))


def relief_numbers() -> FloatArray:
    """Return the constants of `RelievedSides` in the order of `struct readings_numbers`."""
    return np.array([_RELIEVED, _MOST_SPREAD, _LEAST_PRESSED, _TINY])

"""Loads and shears of taxels of which one side has lost its load.

Shear presses one side of a taxel and relieves the opposite one. From where that side bears nothing it reads
what spreads under its electrodes from its neighbours: its reading then grows with theirs, so that the
difference of the two sides bends, and their mean grows though the load does not. Friction would bend the
shear in the same way. The pressed side goes on as before. So from then on, the shear of that axis is taken
from the pressed side alone, in the proportion that it had, and the load from the other pair of sides. Where
that pair has a relieved side, too, the load stays where it was.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import Array, FloatArray
from tactiled.detect.grip.observe import own_channels

# Part of the pressed side's reading, below which the opposite one has lost its load: it then reads 0.41 to
# 0.48 of it (finite elements of the 2019 taxel under 8 to 16 N).
_RELIEVED = 0.5
_MOST_SPREAD = (
    1.3  # of the mean of all sides over the load, where some are relieved: 1.02 to 1.16 on the same
)
_LEAST_PRESSED = 0.1  # of the load, by which a side must be pressed for its part of the shear to be known
_TINY = 1e-12


class RelievedSides:
    """Correction of loads and shears, scan by scan; `compiled_grip.c` does the same with the same bits.

    Parameters
    ----------
    array : Array
    """

    def __init__(self, array: Array) -> None:
        is_side = np.array(array.channel_kind) == "side"
        shear = -array.shear_weights()
        sides = np.concatenate([np.maximum(shear, 0.0), np.maximum(-shear, 0.0)]) * is_side
        even = sides.sum(axis=2).reshape(2, 2, array.n_taxels)
        self._own, self._weights = own_channels(sides)
        # Arrays whose taxels have no opposed sides need no correction.
        self._is_needed = bool(np.all(even > 0))
        # Readings of the sides (half, axis, taxel) under an even load of 1.
        self._even = np.maximum(even, _TINY)
        self._load = np.zeros(array.n_taxels)
        self._proportion, self._weight = np.zeros((2, 2, array.n_taxels))
        self._compiled: Callable[..., None] | None = None
        if (library := compiled.library()) is not None:
            # Arrays whose addresses are bound must live as long as this object.
            self._numbers = np.array([_RELIEVED, _MOST_SPREAD, _LEAST_PRESSED])
            kept = (
                self._own,
                self._weights,
                self._even,
                self._numbers,
                self._load,
                self._proportion,
                self._weight,
            )
            self._compiled = compiled.bind(library.tactiled_relieve, array.n_taxels, len(self._own), *kept)
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        self.relieved = np.zeros_like(self._proportion, dtype=np.bool_)
        """True for the pairs, by axis and taxel, that are read from one side."""
        self._load[:] = 0.0
        self._proportion[:], self._weight[:] = 2.0, _TINY

    def correct(self, response: FloatArray, readings: FloatArray) -> None:
        """Replace loads and shears (3, taxels) of a scan where readings (channels,) show a relieved side."""
        if not self._is_needed:
            return
        if self._compiled is not None:
            self.relieved = np.empty_like(self.relieved)
            readings = compiled.dense(readings, np.float64)
            self._compiled(*(compiled.address(values) for values in (readings, response, self.relieved)))
            return
        side = (self._weights * readings[self._own]).sum(axis=0).reshape(self._even.shape) / self._even
        high, low = side.max(axis=0), side.min(axis=0)
        self.relieved = relieved = low < _RELIEVED * high
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

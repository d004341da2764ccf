"""Detection of stuck channels, whose valid readings do not follow the load.

A wire that came off, an input that is held by its neighbour, a multiplexer that does not switch: the reading
stays where it is. Two things tell it from a quiet channel, whose converter lawfully repeats a code for as
long as noise and load stay within it.

1. It had noise. Of the `_HISTORY` scans before the code began to repeat, readings turned back from one scan
   to the next in `_TURNED` or more. White noise of a last bit or more turns back in half of all scans and
   repeats a code in at most 0.4 of them, so that `_LONG` repeats in a row come by chance once in 1e15 scans;
   noise that only flips the last bit turns back in a quarter at most. Where noise stops everywhere, as
   when a motor stops, most channels rest, and none is stuck.
2. It stayed while a press moved the others of its taxel, all of them and one way, by the pressure that ends
   a contact or more. Shear moves two of four sides and leaves two, and relief leaves 0.4 of a side; a press
   leaves none.

A channel works again with its first reading that differs, and not because the press is over.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.fast import StuckChannels
from tactiled.detect.signal.pressure import LEAST_SIDES
from tactiled.detect.signal.quantise import Quantiser
from tactiled.errors import ContractError

_HISTORY, _TURNED = 128, 52  # derived: 0.4 of all: 3.3 standard deviations above a last bit that flips
_LONG = 40  # derived: 0.4^40 is 1e-16
_MOST = 1 / 3  # prior: of the channels: where more rest, the noise has stopped
_PRESSED_OF_RANGE = 0.01  # physical: where the array file has no pressure that ends a contact (0.15 of +-8 V)


class StuckChannelDetector:
    """Detect stuck channels in a stream of readings."""

    def __init__(self, array: Array) -> None:
        self._search = stuck_channels(array)

    def process(self, steps: FloatArray) -> NDArray[np.bool_]:
        """Return which readings (n, channels) are stuck; the result does not depend on chunking."""
        if steps.shape[1:] != (self._search.n_channels,):
            raise ContractError(f"steps {steps.shape} for an array of {self._search.n_channels} channels")
        stuck = np.empty(steps.shape, dtype=np.bool_)
        flat = steps.ravel()
        self._search.take(len(steps), 0, flat, stuck.reshape(-1).view(np.uint8))
        return stuck


def stuck_channels(array: Array) -> StuckChannels:
    """Return the search for stuck channels of an array."""
    pressed = _PRESSED_OF_RANGE * (array.high - array.low) if array.contact is None else array.contact.below
    sides = _sides(array)
    judged = [len({*row} - {c}) >= LEAST_SIDES - 1 for c, row in enumerate(sides.tolist())]
    return StuckChannels(
        array.sign.astype(np.float64),
        sides.reshape(-1),
        np.array(judged, dtype=np.uint8),
        pressed / Quantiser(array).volts_per_step,
        _HISTORY,
        _TURNED,
        _LONG,
        _MOST * array.n_channels,
    )


def _sides(array: Array) -> NDArray[np.int64]:
    """Return the other sides (channels, others) of a channel's taxel, itself where it has none."""
    is_side = np.array(array.channel_kind) == "side"
    channels = np.arange(array.n_channels)
    same = (array.channel_taxel[:, np.newaxis] == array.channel_taxel) & is_side & is_side[:, np.newaxis]
    others = [np.flatnonzero(same[c] & (channels != c)) for c in channels]
    most = max(1, *(len(row) for row in others))
    return np.array([np.resize(row if len(row) else c, most) for c, row in enumerate(others)])

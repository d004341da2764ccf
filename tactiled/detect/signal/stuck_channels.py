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

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import Quantiser

_HISTORY, _TURNED = 128, 52  # 0.4 of all: 3.3 standard deviations above a last bit that flips
_LONG = 40  # 0.4^40 is 1e-16
_MOST = 1 / 3  # of the channels: where more rest, the noise has stopped
_PRESSED_OF_RANGE = 0.01  # where the array file has no pressure that ends a contact (0.15 of +-8 V)
_LEAST_SIDES = 3


class StuckChannelDetector:
    """Detect stuck channels in a stream of readings.

    Parameters
    ----------
    array : Array
    """

    def __init__(self, array: Array) -> None:
        pressed = (
            _PRESSED_OF_RANGE * (array.high - array.low) if array.contact is None else array.contact.below
        )
        self._pressed_steps = pressed / Quantiser(array).volts_per_step
        self.sign = array.sign.astype(np.float64)
        n = array.n_channels
        self.sides = _sides(array)
        """(channels, others): the other sides of a channel's taxel, itself where it has none."""
        self.judged = np.array([len({*row} - {c}) >= _LEAST_SIDES - 1 for c, row in enumerate(self.sides)])
        self._channels = np.arange(n)
        self._run = np.zeros(n, dtype=np.int64)  # repeats so far
        self._began: FloatArray = np.zeros(self.sides.shape)  # the other sides when the code began
        self._last = np.zeros(n)
        self._is_begun = False
        self._way = np.zeros((1, n))  # of the newest change
        self._turns = np.zeros((_HISTORY, n), dtype=np.bool_)  # a ring where compiled
        self._position = np.zeros(1, dtype=np.int64)
        self._n_turns = np.zeros(n, dtype=np.int64)
        self._noisy = np.zeros(n, dtype=np.bool_)  # before the code began to repeat
        self._stayed = np.zeros(n, dtype=np.bool_)  # in a press since the code began
        self._find: Callable[..., int] | None = None
        if (library := compiled.library()) is not None:
            self._find = compiled.bind(
                library.tactiled_stuck, n, self.sides.shape[1], _HISTORY, self.sign, self.sides,
                self.judged, self._pressed_steps, _TURNED, _LONG, _MOST * n, self._position, self._last,
                self._way, self._run, self._began, self._turns, self._n_turns, self._noisy, self._stayed,
            )  # fmt: skip

    def numbers(self) -> FloatArray:
        """Return the constants in the order of `struct readings_numbers`."""
        return np.array([self._pressed_steps, _TURNED, _LONG, _MOST * len(self.sign), _HISTORY])

    def process(self, steps: FloatArray) -> NDArray[np.bool_]:
        """Return which readings (n, channels) are stuck; the result does not depend on chunking."""
        n = len(steps)
        if not self._is_begun:
            self._is_begun = True
            self._last[:] = steps[0]
            self._began[:] = (steps[0] * self.sign)[self.sides]
        if self._find is not None:
            steps, found = compiled.dense(steps, np.float64), np.empty(steps.shape, dtype=np.bool_)
            self._find(n, compiled.address(steps), compiled.address(found))
            return found
        seen = np.concatenate([self._last[np.newaxis], steps])
        self._last[:] = seen[-1]
        way = np.concatenate([self._way, np.sign(seen[1:] - seen[:-1])])
        self._way = way[-1:]
        rows = np.arange(n)[:, np.newaxis]
        newest_change = np.maximum.accumulate(np.where(way[1:] != 0, rows, -1), axis=0)
        in_block = newest_change >= 0  # else before the block
        at = np.maximum(newest_change, 0)
        run = np.where(in_block, rows - newest_change, self._run + rows + 1)
        self._run = run[-1]

        turns = np.concatenate([self._turns, way[1:] * way[:-1] < 0])
        self._turns = turns[n:]
        n_turns = self._n_turns + np.cumsum(turns[_HISTORY:].astype(np.int64) - turns[:n], axis=0)
        self._n_turns = n_turns[-1]
        noisy = np.where(in_block, n_turns[at, self._channels] >= _TURNED, self._noisy)
        self._noisy = noisy[-1]
        resting = (run >= _LONG // 2).sum(axis=1, keepdims=True)
        stuck = noisy & (run >= _LONG) & (resting <= _MOST * run.shape[1])

        others = (steps * self.sign)[:, self.sides]  # (n, channels, others)
        began = np.where(in_block[..., np.newaxis], others[at, self._channels], self._began)
        self._began = began[-1]
        pressed = self.judged & self._pressed(others - began)
        newest_press = np.maximum.accumulate(np.where(pressed, rows, -1), axis=0)
        stayed = (newest_press >= at) | (~in_block & self._stayed)
        self._stayed = stayed[-1]
        return np.asarray(stuck | stayed)

    def _pressed(self, moved: FloatArray) -> NDArray[np.bool_]:
        up, down = moved >= self._pressed_steps, moved <= -self._pressed_steps
        return np.asarray(up.all(axis=-1) | down.all(axis=-1))


def _sides(array: Array) -> NDArray[np.int64]:
    is_side = np.array(array.channel_kind) == "side"
    channels = np.arange(array.n_channels)
    same = (array.channel_taxel[:, np.newaxis] == array.channel_taxel) & is_side & is_side[:, np.newaxis]
    others = [np.flatnonzero(same[c] & (channels != c)) for c in channels]
    most = max(1, *(len(row) for row in others))
    return np.array([np.resize(row if len(row) else c, most) for c, row in enumerate(others)])

"""Interpolation of stepped models, so that they are functions of time.

A source is advanced on the grid ``k * step_s`` in blocks that begin at multiples of the block length;
between grid points its rows are interpolated linearly. Therefore any chunking of the instants, and any
repetition, gives the same bits. Memory holds the newest blocks only; a request before them steps the source
again from the beginning.
"""

from collections import OrderedDict
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

_KEPT_STEPS = 4096  # some 10 s of the cheap models: more than a scan or a report looks back


class GridSource(Protocol):
    """Source of rows that can be advanced only."""

    def reset(self) -> None:
        """Return to step 0."""
        ...

    def advance(self, time_s: FloatArray) -> FloatArray:
        """Rows (n, width) at the coming n grid points, of which the first is time 0."""
        ...


class GridInterpolator:
    """Rows of a `GridSource` at any instants; `block` grid points are computed at once."""

    def __init__(self, source: GridSource, *, step_s: float, block: int) -> None:
        self._source = source
        self._step_s = step_s
        self._block = block
        self.reset()

    def reset(self) -> None:
        self._source.reset()
        self._blocks: OrderedDict[int, FloatArray] = OrderedDict()
        self._made = 0

    @property
    def made_s(self) -> float:
        """Instant up to which the source has been stepped."""
        return max(self._made * self._block - 1, 0) * self._step_s

    def at(self, time_s: FloatArray, columns: NDArray[np.int64]) -> FloatArray:
        """Return the columns (c,) of the source, each at its instants (n, c), or all at (n, 1).

        Before time 0 the rows are those of time 0.
        """
        if time_s.shape[1] != len(columns):
            time_s = np.broadcast_to(time_s, (len(time_s), len(columns)))
        place = np.maximum(time_s, 0.0) / self._step_s
        below = np.floor(place).astype(np.int64)
        part = place - below
        block = below // self._block
        if not block.size:
            return np.empty(time_s.shape)
        first = int(block.min())
        if first == block.max():
            return self._between(first, below, part, columns)
        out = np.empty(time_s.shape)
        for number in np.unique(block).tolist():
            index = np.nonzero(block == number)
            out[index] = self._between(number, below[index], part[index], columns[index[1]])
        return out

    def _between(
        self, number: int, below: NDArray[np.int64], part: FloatArray, column: NDArray[np.int64]
    ) -> FloatArray:
        """Interpolate columns between rows `below` of a block and those after them."""
        # One row more than the block: the last point's right neighbour.
        rows = np.concatenate([self._rows(number), self._rows(number + 1)[:1]])
        step = below - number * self._block
        low, high = rows[step, column], rows[step + 1, column]
        return np.asarray(low + part * (high - low))

    def _rows(self, number: int) -> FloatArray:
        if number < self._made and number not in self._blocks:
            self.reset()
        while self._made <= number:
            step = np.arange(self._made * self._block, (self._made + 1) * self._block)
            self._blocks[self._made] = self._source.advance(step * np.float64(self._step_s))
            self._made += 1
            if len(self._blocks) * self._block > max(_KEPT_STEPS, 4 * self._block):
                self._blocks.popitem(last=False)
        return self._blocks[number]

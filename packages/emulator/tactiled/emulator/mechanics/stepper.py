"""Interpolation of stepped models, so that they are functions of time.

A source is advanced on the grid ``k * step_s`` in blocks that begin at multiples of the block length;
between grid points its rows are interpolated linearly. Therefore any chunking of the instants, and any
repetition, gives the same bits. Memory holds the newest blocks only; a request before them steps the source
again from the beginning.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import HeldQuantity, TaxelForces, TaxelModel

_KEPT_STEPS = 4096  # some 10 s of the cheap models: more than a scan or a report looks back


class GridSource(Protocol):
    """Source of rows that can be advanced only."""

    def reset(self) -> None:
        """Return to step 0."""
        ...

    def advance(self, n: int) -> FloatArray:
        """Rows (n, width) of the coming n grid points; the first call begins at time 0."""
        ...


class GridInterpolator:
    """Rows of a `GridSource` at any instants.

    Parameters
    ----------
    source : GridSource
        Reset here.
    block : int
        Grid points computed at once; 1 for a source that reacts to input.
    """

    def __init__(self, source: GridSource, *, step_s: float, block: int = 64) -> None:
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

    def at(self, time_s: FloatArray, columns: NDArray[np.int64] | slice) -> FloatArray:
        """Interpolated rows.

        Parameters
        ----------
        time_s : (n, c) or (n,) float64
            Instants; before 0 the rows are those of time 0.
        columns : (c,) int64 or slice
            With instants (n, c), the column of each; with (n,), the columns of the result.

        Returns
        -------
        (n, c) float64
        """
        place = np.maximum(time_s, 0.0) / self._step_s
        below = np.floor(place).astype(np.int64)
        part = place - below
        block = below // self._block
        out = np.empty(time_s.shape) if time_s.ndim == 2 else None
        for number in np.unique(block):
            index = np.nonzero(block == number)
            step = below[index] - number * self._block
            # One row more than the block: the last point's right neighbour.
            rows = np.concatenate([self._rows(int(number)), self._rows(int(number) + 1)[:1]])
            if time_s.ndim == 2:
                column = np.asarray(columns)[index[1]]
                low, high = rows[step, column], rows[step + 1, column]
                weight = part[index]
            else:
                low, high = rows[step][:, columns], rows[step + 1][:, columns]
                weight = part[index][:, None]
            if out is None:
                out = np.empty((len(time_s), low.shape[1]))
            out[index] = low + weight * (high - low)
        return np.empty((0, 0)) if out is None else out

    def _rows(self, number: int) -> FloatArray:
        if number < self._made and number not in self._blocks:
            self.reset()
        while self._made <= number:
            self._blocks[self._made] = self._source.advance(self._block)
            self._made += 1
            if len(self._blocks) * self._block > max(_KEPT_STEPS, 4 * self._block):
                self._blocks.popitem(last=False)
        return self._blocks[number]


@runtime_checkable
class BlockTaxelModel(Protocol):
    """Contact model that does many steps at once."""

    def run(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """`TaxelModel.step` with a leading axis n of arguments and results."""
        ...


def play(
    model: TaxelModel, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float
) -> TaxelForces:
    """Step a model through ``value (n, t)`` and ``base_mm (n, t, 2)``; results have a leading axis n."""
    if isinstance(model, BlockTaxelModel):
        return model.run(held, value, base_mm, dt_s)
    return stacked([model.step(held, v, base, dt_s) for v, base in zip(value, base_mm, strict=True)])


def stacked(steps: Sequence[TaxelForces]) -> TaxelForces:
    """Stack steps along a leading axis."""
    return TaxelForces(**{name: np.stack([vars(step)[name] for step in steps]) for name in vars(steps[0])})

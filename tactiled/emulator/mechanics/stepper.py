"""Steps in, any instant out: what makes a rung with memory answer like a function of time.

A source is advanced on the grid ``k * step_s`` in blocks that begin at multiples of the block length,
whatever was asked for; between grid points its rows are interpolated linearly. So any chunking of the
instants gives the same bits, an instant asked for twice answers twice the same, and memory holds the newest
blocks only: who asks for an instant before them has the source played again from the beginning.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import HeldQuantity, Rung, TaxelForces

_KEPT_STEPS = 4096  # some 10 s of the cheap rungs: longer than a scan or a report looks back


class GridSource(Protocol):
    """Something that goes forward only."""

    def reset(self) -> None:
        """Back to step 0."""
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
    step_s : float
    block : int
        Grid points made at once; 1 for a source that reacts, so that nothing is made before it is asked for.
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
        """Instant up to which the source has been played."""
        return max(self._made * self._block - 1, 0) * self._step_s

    def at(self, time_s: FloatArray, columns: NDArray[np.int64] | slice) -> FloatArray:
        """Interpolated rows.

        Parameters
        ----------
        time_s : (n, c) or (n,) float64
            Instants; before 0 the rows are those of time 0.
        columns : (c,) int64 or slice
            With instants (n, c), the column that each is asked of; with (n,), the columns of the result.

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
class BlockRung(Protocol):
    """A rung that takes many steps at once."""

    def run(self, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
        """`Rung.step` with a leading axis n on arguments and results."""
        ...


def play(rung: Rung, held: HeldQuantity, value: FloatArray, base_mm: FloatArray, dt_s: float) -> TaxelForces:
    """Step a rung through ``value (n, t)`` and ``base_mm (n, t, 2)``; results have a leading axis n."""
    if isinstance(rung, BlockRung):
        return rung.run(held, value, base_mm, dt_s)
    return stacked([rung.step(held, v, base, dt_s) for v, base in zip(value, base_mm, strict=True)])


def stacked(steps: Sequence[TaxelForces]) -> TaxelForces:
    """Steps along a leading axis."""
    return TaxelForces(**{name: np.stack([vars(step)[name] for step in steps]) for name in vars(steps[0])})

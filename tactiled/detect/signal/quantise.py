"""Readings on an integer grid, so that sums do not depend on their order.

Floating-point sums round, and a matrix product rounds differently for one scan than for a thousand; a
threshold can then flip with the chunking. Integers below 2^53 do not round in float64. So each reading
becomes a whole number of steps of ``full_scale / 2^23`` (0.95 uV of 8 V: 800 times finer than the 12-bit
ADC of the 2019 paper), and every sum over readings that a detector takes in blocks uses whole weights.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled import compiled
from tactiled.array import Array, FloatArray
from tactiled.samples.block import ScanBlock

READING_BITS = 23  # with 24-bit filter coefficients, sums stay below 2^53: see `wavelet`


@dataclass(frozen=True, eq=False)
class HeldReadings:
    """Readings as whole steps; unusable readings repeat the channel's last good one.

    Attributes
    ----------
    steps : (n, channels) float64
        Whole numbers within +-2^23.
    ok : (n, channels) bool
        False where the reading was NaN, invalid or outside full scale and an older one stands in.
    all_ok : bool
    """

    steps: FloatArray
    ok: NDArray[np.bool_]
    all_ok: bool


class Quantiser:
    """Streaming rounding to the grid, holding the last good reading of each channel.

    A channel that never had a good reading is held at zero.

    Parameters
    ----------
    array : Array
    """

    def __init__(self, array: Array) -> None:
        self.full_scale_volts = 2.0 ** math.ceil(math.log2(array.full_scale))
        self.volts_per_step = self.full_scale_volts / 2**READING_BITS
        self._n_channels = array.n_channels
        self._last = np.zeros(self._n_channels)
        self._hold_all: Callable[..., int] | None = None
        if (library := compiled.library()) is not None:
            self._hold_all = compiled.bind(
                library.tactiled_hold,
                self._n_channels,
                self.full_scale_volts,
                1.0 / self.volts_per_step,
                self._last,
            )

    def reset(self) -> None:
        """Forget the held readings."""
        self._last[:] = 0.0

    def process(self, block: ScanBlock) -> HeldReadings:
        """Round a block; the result does not depend on chunking."""
        if self._hold_all is not None:
            volts, valid = compiled.dense(block.volts, np.float64), compiled.dense(block.valid, np.bool_)
            steps, ok = np.empty(volts.shape), np.empty(volts.shape, dtype=np.bool_)
            address = compiled.address
            none_is_held = self._hold_all(
                len(volts), address(volts), address(valid), address(steps), address(ok)
            )
            return HeldReadings(steps, ok, bool(none_is_held))
        ok = block.valid & (np.abs(block.volts) <= self.full_scale_volts)
        steps = self.round(block.volts)
        all_ok = bool(ok.all())
        if not all_ok:
            steps = self._hold(steps, ok)
        self._last[:] = steps[-1]
        return HeldReadings(steps, ok, all_ok)

    def round(self, volts: FloatArray) -> FloatArray:
        """Round readings to whole steps; NaN stays NaN, readings outside full scale are clipped."""
        limit = self.full_scale_volts
        steps: FloatArray = np.rint(np.clip(volts, -limit, limit) * (1.0 / self.volts_per_step))
        return steps

    def _hold(self, steps: FloatArray, ok: NDArray[np.bool_]) -> FloatArray:
        rows = np.arange(1, len(steps) + 1)[:, np.newaxis]
        newest_good = np.maximum.accumulate(np.where(ok, rows, 0), axis=0)
        source = np.concatenate([self._last[np.newaxis], steps])
        held: FloatArray = np.take_along_axis(source, newest_good, axis=0)
        return held

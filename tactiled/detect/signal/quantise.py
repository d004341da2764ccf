"""Readings on an integer grid, so that sums do not depend on their order.

Floating-point sums round, and a matrix product rounds differently for one scan than for a thousand; a
threshold can then flip with the chunking. Integers below 2^53 do not round in float64. So each reading
becomes a whole number of steps of ``full_scale / 2^23`` (0.95 uV of 8 V: 800 times finer than the 12-bit
ADC of the 2019 paper), and every sum over readings that a detector takes in blocks uses whole weights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.signal.fast import Hold
from tactiled.errors import ContractError
from tactiled.samples.block import ScanBlock


@dataclass(frozen=True, eq=False)
class HeldReadings:
    """Readings as whole steps; unusable readings repeat the channel's last good one.

    Attributes
    ----------
    steps : (n, channels) float64
        Whole numbers within +-2^23.
    ok : (n, channels) bool
        False where the reading was NaN, invalid or outside full scale and an older one stands in.
    """

    steps: FloatArray
    ok: NDArray[np.bool_]
    all_ok: bool


def flat(block: ScanBlock, n_channels: int) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Return the readings of a block, and which of them are valid, as the compiled path takes them."""
    if block.volts.shape[1] != n_channels:
        raise ContractError(f"a block of {block.volts.shape[1]} channels for an array of {n_channels}")
    return block.volts.ravel(), block.valid.ravel().view(np.uint8)


class Quantiser(Hold):
    """Streaming rounding to the grid, holding the last good reading of each channel.

    A channel that never had a good reading is held at zero.
    """

    def process(self, block: ScanBlock) -> HeldReadings:
        """Round a block; the result does not depend on chunking."""
        readings, valid = flat(block, self.n_channels)
        steps, ok = np.empty(block.volts.shape), np.empty(block.volts.shape, dtype=np.bool_)
        all_ok = self.take(len(steps), readings, valid, steps.reshape(-1), ok.reshape(-1).view(np.uint8))
        return HeldReadings(steps, ok, all_ok)

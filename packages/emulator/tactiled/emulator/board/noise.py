"""Noise that depends on the number of the scan only, not on how scans are chunked."""

import numpy as np
from numpy.typing import NDArray

_BLOCK = 256  # scans drawn at once: their cost is about that of setting up a generator


class ScanNoise:
    """Standard normal numbers for each scan and channel.

    Block b of scans is drawn from Philox, a counter-based generator, with the key (seed, b), so that no state
    is carried from block to block (Salmon et al., SC 2011).
    """

    def __init__(self, seed: int, channels: int) -> None:
        self._seed = seed
        self._channels = channels
        self._number = -1
        self._block = np.empty((_BLOCK, channels))

    def normal(self, first: int, n: int) -> NDArray[np.float64]:
        """``(n, channels)`` numbers of scans first, first + 1, ..."""
        out = np.empty((n, self._channels))
        done = 0
        while done < n:
            number, row = divmod(first + done, _BLOCK)
            take = min(_BLOCK - row, n - done)
            out[done : done + take] = self._drawn(number)[row : row + take]
            done += take
        return out

    def _drawn(self, number: int) -> NDArray[np.float64]:
        if number != self._number:
            key = np.array([self._seed, number], dtype=np.uint64)
            generator = np.random.Generator(np.random.Philox(key=key))
            self._block = generator.standard_normal((_BLOCK, self._channels))
            self._number = number
        return self._block

"""Zero from the first scans of the data."""

import numpy as np

from tactiled.array import FloatArray
from tactiled.samples.block import Gap, ScanBlock


class StartZero:
    """Hold back the first scans until their median is known as the zero.

    Parameters
    ----------
    first_s : float
        Duration of the data that gives the zero; 0 passes every item on at once.

    Attributes
    ----------
    zero : (channels,) float64 or None
        Median of the valid readings, 0 for a channel without any; None until it is known.
    known_s : float
        Instant of the scan that completed it. Nothing is reported of earlier scans before this one.
    """

    def __init__(self, first_s: float) -> None:
        self._first_s = first_s
        self._held: list[ScanBlock | Gap] = []
        self.zero: FloatArray | None = None
        self.known_s = -np.inf

    def process(self, item: ScanBlock | Gap) -> list[ScanBlock | Gap]:
        """Return the items that may go on; nothing while the zero is not known."""
        if self._first_s == 0 or self.zero is not None:
            return [item]
        self._held.append(item)
        blocks = [held for held in self._held if isinstance(held, ScanBlock)]
        if not blocks:
            return []
        n_wanted = max(1, round(self._first_s * blocks[0].rate_hz))
        if sum(map(len, blocks)) < n_wanted:
            return []
        readings = np.concatenate([block.volts for block in blocks])[:n_wanted]
        valid = np.concatenate([block.valid for block in blocks])[:n_wanted]
        zero = np.zeros(readings.shape[1])
        seen = valid.any(axis=0)
        zero[seen] = np.nanmedian(np.where(valid, readings, np.nan)[:, seen], axis=0)
        self.zero = zero
        self.known_s = float(np.concatenate([block.time_s for block in blocks])[n_wanted - 1])
        held, self._held = self._held, []
        return held

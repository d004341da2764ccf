"""Channels that jump while their contact rests: a spark beside the cable, a bit that sticks, a loose wire.

What moves a skin moves several taxels, and takes some scans. A reading that leaves the last one by far more
than those of most loaded taxels do, from one scan to the next, is a fault of its channel until it is back.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.contact.ordered_sums import sum_in_order

# From scan to scan: of the mean load of a taxel, below which a jump changes the total shear by less than the
# zero; standard deviations of noise; times the change of the median taxel, whose load may be a third.
_LEAST, _NOISES, _TIMES = 0.02, 10.0, 10.0
_LOADED = 0.1  # of the largest load: taxels with less need not move with the others
_FEWEST = 4  # loaded taxels, of which most are right
_MOST = 0.4  # of them that may jump at once: six neighbouring channels are of three taxels


class JumpGate:
    """Follow the readings of a contact and find those that jump.

    Parameters
    ----------
    taxel_channels : (taxels, channels) bool
        True where a channel is part of a taxel.
    """

    def __init__(self, taxel_channels: NDArray[np.bool_]) -> None:
        self._own = taxel_channels
        self._accepted = np.zeros(taxel_channels.shape[1])
        self._out = np.zeros(taxel_channels.shape[1], dtype=np.bool_)
        self._is_out = False

    def skip(self, volts: FloatArray) -> None:
        """Take the readings (channels,) of a scan at which jumps cannot be told."""
        self._accepted = volts
        self._is_out = False

    def take(self, volts: FloatArray, loads: FloatArray, channel_sd: FloatArray) -> NDArray[np.bool_] | None:
        """Return the channels (channels,) that jump or did so one scan before; None without any.

        Parameters
        ----------
        volts : (channels,) float64
        loads : (taxels,) float64
            Of the scan before.
        channel_sd : (channels,) float64
            Noise.
        """
        change = np.abs(volts - self._accepted)
        least = _LEAST * sum_in_order(loads) / len(loads)
        if not self._is_out and change.max() <= least:
            self._accepted = volts
            return None
        before = self._out if self._is_out else np.zeros_like(self._out)
        self._out = self._jumps(change, least, loads, channel_sd)
        self._is_out = bool(self._out.any())
        self._accepted = np.where(self._out, self._accepted, volts)
        found = self._out | before
        return found if found.any() else None

    @property
    def accepted(self) -> FloatArray:
        """Newest readings (channels,) that did not jump."""
        return self._accepted

    def _jumps(
        self, change: FloatArray, least: float, loads: FloatArray, channel_sd: FloatArray
    ) -> NDArray[np.bool_]:
        loaded = loads > _LOADED * loads.max()
        if np.count_nonzero(loaded) < _FEWEST:
            return np.zeros(len(change), dtype=np.bool_)
        of_taxels = np.where(self._own, change, 0.0).max(axis=1)[loaded]
        usual = float(np.median(of_taxels))
        jumps = change > np.maximum(max(least, _TIMES * usual), _NOISES * channel_sd)
        struck = (self._own[loaded] & jumps).any(axis=1)
        return jumps if np.count_nonzero(struck) <= _MOST * len(struck) else np.zeros_like(jumps)


def jump_numbers() -> FloatArray:
    """Return the constants of `JumpGate` in the order of `struct readings_numbers`."""
    return np.array([_LEAST, _NOISES, _TIMES, _LOADED, _FEWEST, _MOST])

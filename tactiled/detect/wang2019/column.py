"""The column of taxels that the published groove procedure samples, and through which resistor."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.wang2019.spectrum import Spectrum, spectrum
from tactiled.samples.block import ScanBlock

_MAX_BAD_PART = 0.01  # held readings that a spectrum does not notice


class Column:
    """Three taxels (or two) of a column.

    Parameters
    ----------
    array : Array
    number : int
        Which column, counted as `Array.columns` does; the last where there are fewer.
    low_pass_hz : float

    Attributes
    ----------
    y_mm : (taxels,) float64
        Where they are.
    resistors : list of (taxels,) int64
        Channels that measure the same in each: R1 of all, R2 of all, ... Empty for an array without a column.
    """

    def __init__(self, array: Array, number: int, low_pass_hz: float) -> None:
        columns = array.columns()
        taxels = columns[min(number, len(columns) - 1)][:3] if columns else []
        self.y_mm = array.y_mm[taxels]
        self.resistors = _resistors(array, taxels)
        self._grid = Quantiser(array)
        self.volts_per_step = self._grid.volts_per_step
        self._low_pass_hz = low_pass_hz

    def good(self, block: ScanBlock) -> NDArray[np.bool_]:
        """Readings to go by; NaN compares false."""
        return block.valid & (np.abs(block.volts) <= self._grid.full_scale_volts)

    def strongest(
        self, volts: FloatArray, good: NDArray[np.bool_], rate_hz: float
    ) -> tuple[NDArray[np.int64], FloatArray, Spectrum] | None:
        """Channels, signals (n, taxels) and spectrum of the resistor with the largest peak.

        None when every resistor is bad in some taxel. The few bad readings of the others are bridged by a
        line.
        """
        best = None
        scans = np.arange(len(volts))
        enough = good.mean(axis=0) >= 1 - _MAX_BAD_PART
        for channels in self.resistors:
            if not enough[channels].all():
                continue
            signals = np.stack(
                [np.interp(scans, scans[good[:, c]], volts[good[:, c], c]) for c in channels], axis=1
            )
            seen = spectrum(signals, rate_hz, self.volts_per_step, self._low_pass_hz)
            if best is None or _strength(seen) > _strength(best[2]):
                best = channels, signals, seen
        return best


def _strength(seen: Spectrum) -> tuple[bool, float]:
    # Beyond the band or not, a ripple that is there counts for more than a trend or nothing.
    return seen.status in ("ok", "aliased"), float((seen.amplitude_volts[seen.peak] ** 2).sum())


def _resistors(array: Array, taxels: list[int]) -> list[NDArray[np.int64]]:
    found: dict[tuple[str, float], list[int]] = {}
    for taxel in taxels:
        for channel in np.flatnonzero(array.channel_taxel == taxel).tolist():
            azimuth_deg = float(np.nan_to_num(array.azimuth_deg[channel]))
            found.setdefault((array.channel_kind[channel], azimuth_deg), []).append(channel)
    return [
        np.array(channels)
        for channels in found.values()
        if [int(array.channel_taxel[c]) for c in channels] == taxels
    ]

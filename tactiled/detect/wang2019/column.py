"""The column of taxels that the published groove procedure samples, and the resistor it reads."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.wang2019.spectrum import Spectrum, spectrum
from tactiled.samples.block import ScanBlock

# prior: part of the readings. A spectrum does not notice so few interpolated ones.
_MAX_BAD_PART = 0.01


class TaxelColumn:
    """Three taxels (or two) of one column.

    Parameters
    ----------
    number : int
        Number of the column, counted as in `Array.columns`; the last where there are fewer.

    Attributes
    ----------
    y_mm : (taxels,) float64
        Positions along the column.
    resistors : list of (taxels,) int64
        Channels that measure the same quantity in each taxel: all R1, all R2, ... Empty for an array without
        a column.
    """

    def __init__(self, array: Array, number: int, low_pass_hz: float) -> None:
        columns = array.columns()
        taxels = columns[min(number, len(columns) - 1)][:3] if columns else []
        self.y_mm = array.y_mm[taxels]
        self.resistors = _resistors(array, taxels)
        self._grid = Quantiser(array)
        self.volts_per_step = self._grid.volts_per_step
        self._low_pass_hz = low_pass_hz

    def usable(self, block: ScanBlock) -> NDArray[np.bool_]:
        """True for valid readings within full scale; NaN compares false: (n, channels)."""
        return block.valid & (np.abs(block.volts) <= self._grid.full_scale_volts)

    def strongest(
        self, volts: FloatArray, good: NDArray[np.bool_], rate_hz: float
    ) -> tuple[NDArray[np.int64], FloatArray, Spectrum] | None:
        """Channels, signals (n, taxels) and spectrum of the resistor with the largest peak.

        Few bad readings are interpolated linearly. None where each resistor is bad in some taxel.
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
    """Sort key: a ripple, inside the band or beyond it, ranks above a trend or noise."""
    return seen.status in ("ok", "aliased"), float((seen.amplitude_volts[seen.peak] ** 2).sum())


def _resistors(array: Array, taxels: list[int]) -> list[NDArray[np.int64]]:
    """Channels of equal kind and azimuth that are present in all taxels."""
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

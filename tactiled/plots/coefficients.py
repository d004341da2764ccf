"""Wavelet coefficients by which the published procedure decides, for a picture of the whole log."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import SwtBank
from tactiled.detect.wang2019.slip import SlipParams, level_at
from tactiled.plots.palette import CHANNELS, NEUTRAL
from tactiled.samples.block import ScanBlock


def draw_coefficients(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    blocks: list[ScanBlock],
    origin_s: float,
    slip: SlipParams,
) -> None:
    """Draw the coefficients of the channels of one taxel, with the threshold of the published procedure."""
    largest = slip.threshold_volts
    for block in blocks:
        level = level_at(block.rate_hz, slip)
        volts, usable = SwtBank(array, level).filter(Quantiser(array).process(block))
        shown = np.where(usable, volts, np.nan)[:, channels]
        for color, values in zip(CHANNELS, shown.T, strict=False):
            axis.plot(block.time_s - origin_s, values * 1e3, color=color, lw=0.8)
        if np.isfinite(shown).any():
            largest = max(largest, float(np.nanmax(np.abs(shown))))
        axis.set_ylabel(f"coif1 level {level} (mV)")
    for sign in (-1, 1):
        label = f"threshold {slip.threshold_volts * 1e3:g} mV" if sign > 0 else None
        axis.axhline(sign * slip.threshold_volts * 1e3, color=NEUTRAL, ls="--", lw=1, label=label)
    # Linear up to the threshold, logarithmic beyond: kinks of slip are a hundred times larger.
    axis.set_yscale("symlog", linthresh=slip.threshold_volts * 1e3)
    axis.set_ylim(-1.5e3 * largest, 1.5e3 * largest)
    axis.set_title("slip criterion of the published procedure: one taxel", fontsize=10)

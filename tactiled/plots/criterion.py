"""Quantity that the slip detector compares with its threshold, for a picture of the whole log."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import BankParams, SwtBank
from tactiled.detect.slip.filters import RampFilters
from tactiled.detect.slip.response import AXES, PRESSURE, ResponseModel, motion, responses
from tactiled.detect.suite import DetectParams
from tactiled.detect.wang2019.slip import level_at
from tactiled.plots.palette import CHANNELS, NEUTRAL
from tactiled.samples.block import ScanBlock

FloatArray = NDArray[np.float64]
_LEAST_PRESSURE = 0.1  # of the largest in the log; a press or a lift makes the ratio large below it
_AXIS_RATIO = 30.0  # range of the axis below and above the threshold
_PIECE_SCANS = 1024  # filtered at once, which bounds memory


@dataclass(frozen=True, eq=False)
class Criterion:
    """Quantity that a slip detector decides by.

    Attributes
    ----------
    time_s : (n,) float64
    values : (n,) float64
        NaN where the quantity is undefined.
    """

    time_s: FloatArray
    values: FloatArray


def shear_growth(array: Array, blocks: list[ScanBlock]) -> Criterion:
    """Compute the largest growth of shear over pressure along the ramps of `detect.slip.filters`.

    All taxels count, and of the tests of `detect.slip.evidence` only the size of the growth is shown.
    """
    model, quantiser = ResponseModel(array), Quantiser(array)
    weights = model.weights(np.ones(array.n_taxels, dtype=np.bool_))
    pressures = [responses(weights, quantiser.process(block).steps)[:, PRESSURE] for block in blocks]
    least = _LEAST_PRESSURE * max((float(part.max()) for part in pressures), default=0.0)
    quantiser.reset()
    values = [np.zeros(0)]
    for block in blocks:
        seen = responses(weights, quantiser.process(block).steps)
        shear, pressure = motion(seen), seen[:, PRESSURE]
        filters = RampFilters(block.rate_hz)
        padded = np.concatenate([np.repeat(shear[:1], filters.window - 1, axis=0), shear])
        growth = np.zeros(len(shear))
        for start in range(0, len(shear), _PIECE_SCANS):
            piece = padded[start : start + _PIECE_SCANS + filters.window - 1]
            rises = filters.apply(piece)[0][:, :AXES] * filters.rise_scale
            growth[start : start + _PIECE_SCANS] = np.sqrt((rises**2).sum(axis=1)).max(axis=1)
        values.append(np.where(pressure > max(least, 1.0), growth / np.maximum(pressure, 1.0), np.nan))
    times = [np.zeros(0), *(block.time_s for block in blocks)]
    return Criterion(np.concatenate(times), np.concatenate(values))


def draw_criterion(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    blocks: list[ScanBlock],
    origin_s: float,
    params: DetectParams,
) -> None:
    """Draw the criterion of the configured detector with its threshold."""
    if params.setting == "wang2019":
        _draw_coefficients(axis, array, channels, blocks, origin_s, params)
        return
    found = shear_growth(array, blocks)
    axis.plot(found.time_s - origin_s, found.values, color=CHANNELS[0], lw=0.9, label="growth of shear")
    label = f"required: {params.slip.shear:.2g} ({params.setting})"
    axis.axhline(params.slip.shear, color=NEUTRAL, ls="--", lw=1, label=label)
    axis.set_yscale("log")
    axis.set_ylim(params.slip.shear / _AXIS_RATIO, params.slip.shear * _AXIS_RATIO)
    axis.set_ylabel("growth of shear\nover pressure")
    axis.set_title(
        "slip criterion: growth of shear of the whole array; other tests exclude a press", fontsize=10
    )


def _draw_coefficients(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    blocks: list[ScanBlock],
    origin_s: float,
    params: DetectParams,
) -> None:
    """Draw the wavelet coefficients of one taxel, by which the published procedure decides."""
    slip = params.wang2019.slip
    largest = slip.threshold_volts
    for block in blocks:
        level = level_at(block.rate_hz, slip)
        found = SwtBank(array, BankParams(levels=(level,))).process(block)
        shown = np.where(found.usable[:, 0], found.volts[:, 0], np.nan)[:, channels]
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

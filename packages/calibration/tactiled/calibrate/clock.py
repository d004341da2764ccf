"""Offset between the clock of a log and that of a force sensor, from the records themselves."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from tactiled.array import Array, FloatArray
from tactiled.calibrate.data import AlignedReference, BinnedLog
from tactiled.calibrate.folds import correlation_bins
from tactiled.errors import DataError
from tactiled.force.calibration import AXES
from tactiled.force.model import bent, low_passed

WITHIN_S = 5.0
CREEP_S = (1.5, 20.0)  # low-passed copies: what a calibration of a minute can tell apart
_LEAST_FREE = 5  # bins without contact, whose median is the offset of the reference
_LEAST_ALWAYS = 0.4  # of the log: presses enough to tell offsets apart
_LEAST_COVERED_S = 5.0
_LEAST_CORRELATION = 0.5  # records of the same presses reach 0.9 and more, even with a curved sensor


def has_signs(array: Array) -> bool:
    """Return True where the signs of channels are physics, and not those of a magnet or a converter."""
    is_physical = "side" in array.channel_kind or array.unit in ("N", "kPa")
    return is_physical and bool(array.normal_weights().any())


def pressure(log: BinnedLog, array: Array) -> FloatArray:
    """Size of the response (n,), whose sign is compared with that of the normal force."""
    if has_signs(array):
        return np.asarray(log.readings @ array.normal_weights().sum(axis=0))
    scale = np.maximum(log.readings.std(axis=0), 1e-12)
    return np.asarray(np.sqrt(((log.readings / scale) ** 2).sum(axis=1)))


class Alignment(NamedTuple):
    """Offset of the clocks of a log and its reference."""

    late_s: float  # as `AlignedReference.means` takes it
    sd_s: float  # standard deviation; 0 where the clocks were said to be one
    # Of pressure and normal force: negative where the force falls when the array is pressed. Without a normal
    # force, 1
    correlation: float


Match = Callable[[float], tuple[float, FloatArray]]
"""Correlation of the records at an offset (NaN where too little is covered), and residuals (n, columns)."""


def align(
    log: BinnedLog,
    reference: AlignedReference,
    array: Array,
    starts_s: Sequence[float],
    unseen: NDArray[np.bool_],
    *,
    is_same_clock: bool = False,
) -> Alignment:
    """Find the offset of the clocks at which the records resemble each other most.

    `starts_s` are times from the first sample of the reference to the first scan of the log that may be about
    right: by their clocks, or 0 if both records began together. The true offset is searched within `WITHIN_S`
    of each; with `is_same_clock` the first is taken as it is. `unseen` (n,) is True for bins in which the
    reference says nothing, at about the true offset. `DataError` where the records do not resemble each
    other, or do not overlap.
    """
    if unseen.any() and not is_same_clock:  # at another offset, other bins are
        at_any = binary_dilation(unseen, iterations=max(1, round(WITHIN_S / log.step_s)))
        unseen = at_any if at_any.sum() < len(log) / 2 else unseen
    step_s = log.step_s / 2
    around_s = np.zeros(1) if is_same_clock else np.arange(-WITHIN_S, WITHIN_S + step_s, step_s)
    found: list[tuple[float, FloatArray, FloatArray, Match]] = []
    for start_s in starts_s:
        match = _match(log, reference, array, start_s, unseen)
        values = np.array([match(lag_s)[0] for lag_s in (start_s + around_s).tolist()])
        if np.isfinite(values).any():
            found.append((float(np.nanmax(values)), start_s + around_s, values, match))
    if not found:
        raise DataError(
            f"the reference does not overlap the log within {WITHIN_S:g} s: its first sample is at "
            f"{-starts_s[0]:.1f} s from the log's first scan; shift its time_s, or record both together"
        )
    _, lags_s, values, match = max(found, key=lambda one: one[0])
    best = int(np.nanargmax(values))
    if values[best] < _LEAST_CORRELATION:
        raise DataError(
            f"log and reference do not resemble each other (largest correlation {values[best]:.2f} within "
            f"{WITHIN_S:g} s): are they of the same presses? Press, and let go, at least three times"
        )
    late_s, sd_s = float(lags_s[best]), 0.0
    if not is_same_clock:
        rest = match(late_s)[1]
        sd_s = _sd_s(lags_s, values, len(rest) / max(correlation_bins(column) for column in rest.T))
    if 2 not in reference.outputs:
        return Alignment(late_s, sd_s, 1.0)
    inside = reference.inside(late_s, 0.0) & ~unseen
    normal = reference.means(late_s, 0.0)[:, 2]
    return Alignment(late_s, sd_s, correlation_of(pressure(log, array)[inside], normal[inside]))


def _match(
    log: BinnedLog, reference: AlignedReference, array: Array, start_s: float, unseen: NDArray[np.bool_]
) -> Match:
    """Return the match of offsets within `WITHIN_S` of one; by the bins that all of them cover, if many."""
    always = reference.inside(start_s - WITHIN_S, 0.0) & reference.inside(start_s + WITHIN_S, 0.0) & ~unseen
    if always.sum() > _LEAST_ALWAYS * len(log):
        return _explained(log, reference, always)
    return _of_same_size(log, reference, array, ~unseen)


def _sd_s(lags_s: FloatArray, correlations: FloatArray, n_independent: float) -> float:
    """Standard deviation of the offset of largest correlation r.

    The log likelihood of a linear regression is ``-n/2 log(1 - r^2)`` for n independent residuals; taken as
    weights of the offsets it has this standard deviation. What the grid of offsets rounds off comes on top.
    """
    step_s, known = float(lags_s[1] - lags_s[0]), np.isfinite(correlations)
    unlikely = n_independent / 2 * np.log(np.maximum(1 - correlations[known] ** 2, 1e-12))
    weights = np.exp(unlikely.min() - unlikely)
    lags_s = lags_s[known]
    mean_s = np.average(lags_s, weights=weights)
    variance = float(np.average((lags_s - mean_s) ** 2, weights=weights))
    return math.sqrt(variance + step_s**2 / 12)


def _explained(log: BinnedLog, reference: AlignedReference, rows: NDArray[np.bool_]) -> Match:
    """Part of the forces that regression on the features of the smooth model explains.

    `rows` are bins that every offset covers.
    """
    forces = [k for k in reference.outputs if k < len(AXES)]
    # Creep and a curve look like a delay: without them the offset would take them for one.
    curved = [bent(log.readings, curve, log.zero) for curve in log.curves]
    delayed = [low_passed(one, log.steps_s, time_s) for one in curved for time_s in CREEP_S]
    parts = [one[rows] / max(float(one.std()), 1e-300) for one in (*curved, log.readings**2, *delayed)]
    readings = np.concatenate(parts, axis=1)
    u, sizes, _ = np.linalg.svd(readings - readings.mean(axis=0), full_matrices=False)
    # One direction for ten bins, so that chance explains a tenth.
    most = max(len(readings) // 10, 1)
    basis = u[:, :most][:, sizes[:most] > 1e-9 * max(float(sizes[0]), 1e-300)]

    def match(late_s: float) -> tuple[float, FloatArray]:
        shown = reference.means(late_s, 0.0)[rows][:, forces]
        shown = shown - shown.mean(axis=0)
        total = (shown**2).sum(axis=0)
        along = basis.T @ shown
        if not total.any():
            return math.nan, shown
        part = (along**2).sum(axis=0)[total > 0] / total[total > 0]
        return float(np.sqrt(part.mean())), shown - basis @ along

    return match


def _of_same_size(
    log: BinnedLog, reference: AlignedReference, array: Array, seen: NDArray[np.bool_]
) -> Match:
    """Correlation of pressure and normal force, for records of which some offsets cover little."""
    pressed = pressure(log, array)
    least = min(0.5 * len(log), _LEAST_COVERED_S / log.step_s)

    def match(late_s: float) -> tuple[float, FloatArray]:
        inside = reference.inside(late_s, 0.0) & seen
        if inside.sum() < least:
            return math.nan, np.empty((0, 1))
        shown, felt = _size(reference, reference.means(late_s, 0.0))[inside], pressed[inside]
        rest = shown - np.polyval(np.polyfit(felt, shown, 1), felt)
        return abs(correlation_of(felt, shown)), rest[:, np.newaxis]

    return match


def _size(reference: AlignedReference, outputs: FloatArray) -> FloatArray:
    """Normal force if there is one, or else the size of the shear."""
    if 2 in reference.outputs:
        return np.asarray(outputs[:, 2])
    known = [k for k in (0, 1) if k in reference.outputs]
    centred = outputs[:, known] - np.median(outputs[:, known], axis=0)
    return np.asarray(np.sqrt((centred**2).sum(axis=1)))


def correlation_of(one: FloatArray, other: FloatArray) -> float:
    """Correlation of two columns (n,); 0 where one is constant."""
    a, b = one - one.mean(), other - other.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def quiet_bins(log: BinnedLog) -> NDArray[np.bool_]:
    """Bins (n,) in which nothing touches: every channel within five of its standard deviations of zero."""
    scale = np.quantile(np.abs(log.readings), 0.98, axis=0)
    limit = np.maximum(5 * log.noise, 0.005 * scale) + 1e-12
    return np.asarray((np.abs(log.readings) < limit).all(axis=1))


def free_level(outputs: FloatArray, quiet: NDArray[np.bool_]) -> FloatArray | None:
    """Outputs (6,) of the reference without a load; None where the array was hardly ever free."""
    return np.asarray(np.median(outputs[quiet], axis=0)) if quiet.sum() >= _LEAST_FREE else None

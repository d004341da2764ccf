"""Offset between the clock of a log and that of a force sensor, from the records themselves."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.calibrate.data import AlignedReference, BinnedLog
from tactiled.errors import DataError

WITHIN_S = 5.0
_LEAST_CORRELATION = 0.5  # records of the same presses reach 0.9 and more, even with a curved sensor


def has_signs(array: Array) -> bool:
    """Return True where the signs of channels are physics, and not those of a magnet or a converter."""
    is_physical = "side" in array.channel_kind or array.unit in ("N", "kPa")
    return is_physical and bool(array.normal_weights().any())


def pressure(log: BinnedLog, array: Array) -> FloatArray:
    """Size of the response (n,) by which the log is compared with the reference."""
    if has_signs(array):
        return np.asarray(log.readings @ array.normal_weights().sum(axis=0))
    scale = np.maximum(log.readings.std(axis=0), 1e-12)
    return np.asarray(np.sqrt(((log.readings / scale) ** 2).sum(axis=1)))


def align(log: BinnedLog, reference: AlignedReference, array: Array, between_s: float) -> tuple[float, float]:
    """Return the offset of the clocks and the correlation there.

    Parameters
    ----------
    between_s : float
        First scan of the log minus first sample of the reference, by their own clocks; the true offset is
        searched within `WITHIN_S` of it.

    Returns
    -------
    late_s : float
        As `AlignedReference.means` takes it.
    correlation : float
        Of the two records; negative where the reference falls when the array is pressed.

    Raises
    ------
    DataError
        The records do not resemble each other, or do not overlap.
    """
    felt = pressure(log, array)
    step_s = log.step_s / 2
    lags_s = np.arange(-WITHIN_S, WITHIN_S + step_s, step_s)
    best, best_s, signed = 0.0, 0.0, 0.0
    overlaps = False
    for lag_s in lags_s:
        inside = reference.inside(between_s + lag_s, 0.0)
        if inside.sum() < 0.5 * len(log) and inside.sum() * log.step_s < 5.0:
            continue
        overlaps = True
        shown = _size(reference, reference.means(between_s + lag_s, 0.0))
        value = _correlation(felt[inside], shown[inside])
        if abs(value) > best:
            best, best_s, signed = abs(value), float(lag_s), value
    if not overlaps:
        raise DataError(
            f"the reference does not overlap the log within {WITHIN_S:g} s: its first sample is at "
            f"{-between_s:.1f} s from the log's first scan; shift its time_s, or record both together"
        )
    if best < _LEAST_CORRELATION:
        raise DataError(
            f"log and reference do not resemble each other (largest correlation {best:.2f} within "
            f"{WITHIN_S:g} s): are they of the same presses? Press, and let go, at least three times"
        )
    return between_s + best_s, signed


def _size(reference: AlignedReference, outputs: FloatArray) -> FloatArray:
    """Normal force if there is one, or else the size of the shear."""
    if 2 in reference.outputs:
        return np.asarray(outputs[:, 2])
    known = [k for k in (0, 1) if k in reference.outputs]
    centred = outputs[:, known] - np.median(outputs[:, known], axis=0)
    return np.asarray(np.sqrt((centred**2).sum(axis=1)))


def _correlation(one: FloatArray, other: FloatArray) -> float:
    a, b = one - one.mean(), other - other.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def quiet_bins(log: BinnedLog) -> NDArray[np.bool_]:
    """Bins (n,) in which nothing touches: every channel within five of its standard deviations of zero."""
    scale = np.quantile(np.abs(log.readings), 0.98, axis=0)
    limit = np.maximum(5 * log.noise, 0.005 * scale) + 1e-12
    return np.asarray((np.abs(log.readings) < limit).all(axis=1))

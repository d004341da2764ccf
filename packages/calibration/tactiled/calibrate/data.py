"""Readings and reference of a calibration, averaged over common bins of time.

Both clocks tick differently: the reference is averaged over each bin through its integral, at any offset and
drift, so that a fit can move it by parts of a sample.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.calibrate.folds import segments
from tactiled.errors import DataError
from tactiled.force.calibration import OUTPUTS, Curve, PairsModelParams, SmoothModelParams
from tactiled.scan_log import start_zero

BIN_HZ = 25.0  # presses of a person rise in 0.2 s and more; shorter bins only add rows
# A curve is tried where no reading falls below so many standard deviations of the noise that the lowest ones
# have: nearer to 0 it bends by the noise. That of a resistor falls with its reading.
_LEAST_NOISES, _LOWEST = 10.0, 0.05  # the second: quantile of the readings
_LEAST_PART = 0.02  # of the reading without a load, in poses: no order of theirs shows noise
_MEDIAN_BEND = 0.6745 * 6**0.5  # median of |v[k] - 2 v[k + 1] + v[k + 2]| of white noise of unit variance
_LEAST_POSES = 20  # a response with squares has some ten unknowns for each axis
_LEAST_SCANS = 3  # second differences of fewer tell no noise
_TARE_SCANS = 50  # that the zero of a tare is the mean of
_PAUSE_SAMPLES = 5.0  # median steps of a reference: fewer are missing samples, over which a line will do
_USUAL = 0.9  # quantile of the steps beyond which a step is a pause: logs of others miss every tenth scan


@dataclass(frozen=True, eq=False)
class ReferenceTable:
    """Record of a force sensor."""

    time_s: FloatArray  # (m,): in its own clock, increasing
    values: FloatArray  # (m, 6): fx, fy, fz (N), tx, ty, tz (N mm); NaN for columns that it does not have
    unused: tuple[str, ...] = ()  # columns of its file that are neither a time nor one of these

    @property
    def outputs(self) -> list[int]:
        """Indices of the columns that it has."""
        return [k for k in range(len(OUTPUTS)) if not np.isnan(self.values[:, k]).all()]

    def noise(self) -> FloatArray:
        """Standard deviation (6,) of the white noise of a sample; NaN for columns that it does not have."""
        out = np.full(len(OUTPUTS), np.nan)
        out[self.outputs] = _white_noise(self.values[:, self.outputs])
        return out


@dataclass(frozen=True, eq=False)
class BinnedLog:
    """Readings averaged over bins."""

    # start_s, end_s: (n,): ends of each bin, from the log's first scan
    start_s: FloatArray
    end_s: FloatArray
    middle_s: FloatArray  # (n,): mean instant of the scans in it
    readings: FloatArray  # (n, channels): relative to zero, finite
    zero: FloatArray  # (channels,): readings without a load
    zero_sd: float  # standard deviation of the zero of a channel
    noise: FloatArray  # (channels,): standard deviation of a scan's white noise
    bin_scans: int  # scans in a bin
    are_poses: bool = False  # the bins are static poses in any order, one scan each: creep cannot be told

    def __len__(self) -> int:
        return len(self.readings)

    @property
    def steps_s(self) -> FloatArray:
        """Time (n,) from the bin before to each bin; of the first bin its length."""
        return np.diff(self.middle_s, prepend=self.middle_s[0] - (self.end_s[0] - self.start_s[0]))

    @property
    def curves(self) -> tuple[Curve, ...]:
        """Curves that the readings may be put through; a bent one needs readings well above 0."""
        whole = self.readings + self.zero
        if not (self.zero > 0).all():
            return ("linear",)
        least = _LEAST_PART * self.zero if self.are_poses else _LEAST_NOISES * _noise_of_lowest(whole)
        return ("linear", "log", "inverse") if (whole.min(axis=0) > least).all() else ("linear",)

    @property
    def step_s(self) -> float:
        """Median of the steps."""
        return float(np.median(self.steps_s))


@dataclass(frozen=True, eq=False)
class FitData:
    """What a model is fitted to, once the clocks are known."""

    array: Array
    log: BinnedLog
    outputs: FloatArray  # (n, 6): reference without its offset; 0 in columns that it does not have
    used: list[int]  # columns that it has
    rows: NDArray[np.bool_]  # (n,): bins that it covers

    @cached_property
    def shown(self) -> FloatArray:
        """Reference in the bins that it covers."""
        return np.asarray(self.outputs[self.rows])

    @cached_property
    def segment(self) -> NDArray[np.int64]:
        """Number of the segment of each of these bins."""
        return segments(self.shown, self.used, self.log.step_s)


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Fitted model of either kind, with its errors in the folds; n bins were used."""

    name: Literal["pairs", "smooth"]
    weights: FloatArray  # (3, features): of fx, fy, fz
    covariance: list[FloatArray]  # of the weights of fx, fy and fz; correlated bins count as one
    features: FloatArray  # (n, features)
    left_out: FloatArray  # (n, 6): reference minus model where the bin was left out of the fit
    moved: Callable[[FloatArray], FloatArray]  # features (n, features) where the zeros err by (channels,)
    table: PairsModelParams | SmoothModelParams  # entry of the file
    feature_units: FloatArray  # (features,): one of a feature here, in that of the file


def _white_noise(values: FloatArray) -> FloatArray:
    """Standard deviation (columns,) of the white noise of values (n, columns), from second differences.

    Their median leaves out those in which the values themselves bend.
    """
    second = np.diff(values, 2, axis=0) / np.sqrt(6)
    return np.asarray(1.4826 * np.nanmedian(np.abs(second), axis=0))


def _noise_of_lowest(readings: FloatArray) -> FloatArray:
    """Standard deviation (channels,) of the noise of the lowest readings (n, channels), rounding included.

    Infinite where these are all the same: they may stand at the end of the range.
    """
    inner = readings[1:-1]
    is_lowest = inner <= np.quantile(inner, _LOWEST, axis=0)
    bends = np.where(is_lowest, np.abs(np.diff(readings, n=2, axis=0)), np.nan)
    steps = np.abs(np.diff(np.sort(np.where(is_lowest, inner, np.nan), axis=0), axis=0))
    least_step = np.where(steps > 0, steps, np.inf).min(axis=0, initial=np.inf)
    noise = np.nanmedian(bends, axis=0) / _MEDIAN_BEND
    return np.asarray(np.maximum(noise, least_step / math.sqrt(12.0)))


def bin_log(time_s: FloatArray, readings: FloatArray, array: Array) -> BinnedLog:
    """Subtract the zero and average over bins; missing readings are interpolated in time.

    A bin holds so many neighbouring scans, whatever their spacing. A scan stands for the time to the middle
    between it and its neighbours, but not for a pause, and no bin has a pause in it. `readings` (n, channels)
    are as in the file, NaN where missing. `DataError` for a few scans.
    """
    if len(time_s) < _LEAST_SCANS:
        raise DataError(f"the log has {len(time_s)} scans; press for a minute")
    spacing_s = np.diff(time_s)
    longest_s = float(np.quantile(spacing_s, _USUAL))
    usual_s = np.minimum(spacing_s, longest_s)
    half_s = usual_s / 2
    zero = start_zero(time_s, readings, array)
    relative = _filled(time_s, readings - zero)
    noise = _white_noise(relative)
    first = int(np.searchsorted(time_s - time_s[0], array.zero_first_s))
    n_zero = max(first, 1) if array.zero_first_s else _TARE_SCANS
    mean_s = float(usual_s.mean())  # not the median: stamps of scans that come in bunches are near each other
    size = max(1, int(1 / (BIN_HZ * mean_s) + 1e-6))
    n = len(relative) // size
    blocks = relative[: n * size].reshape(n, size, array.n_channels)
    is_pause = np.append(spacing_s > max(2 * longest_s, size * mean_s), False)
    whole = ~is_pause[: n * size].reshape(n, size)[:, :-1].any(axis=1)
    starts_s = time_s - np.concatenate([half_s[:1], half_s]) - time_s[0]
    ends_s = time_s + np.concatenate([half_s, half_s[-1:]]) - time_s[0]
    return BinnedLog(
        start_s=starts_s[: n * size : size][whole],
        end_s=ends_s[size - 1 : n * size : size][whole],
        middle_s=(time_s[: n * size] - time_s[0]).reshape(n, size).mean(axis=1)[whole],
        readings=blocks.mean(axis=1)[whole],
        zero=zero,
        zero_sd=float(np.median(noise)) / math.sqrt(n_zero),
        noise=noise,
        bin_scans=size,
    )


def pose_log(readings: FloatArray, array: Array) -> BinnedLog:
    """Make a log of static poses (n, channels), a second each, of which no noise is known.

    `DataError` where the zero of the array is that of the beginning, which poses do not have, or a reading is
    missing.
    """
    if array.zero_first_s:
        raise DataError(
            f"array {array.name} takes its zero from the first {array.zero_first_s:g} s, and poses have no "
            "beginning: give zero = [...], one reading without a load for each channel"
        )
    if not np.isfinite(readings).all():
        raise DataError("a pose lacks a reading: leave its row out of the log and of the reference")
    middle_s = np.arange(len(readings), dtype=np.float64)
    return BinnedLog(
        start_s=middle_s - 0.5,
        end_s=middle_s + 0.5,
        middle_s=middle_s,
        readings=readings - array.zero,
        zero=array.zero,
        zero_sd=0.0,
        noise=np.zeros(array.n_channels),
        bin_scans=1,
        are_poses=True,
    )


def same_poses(time_s: FloatArray, table: ReferenceTable) -> tuple[NDArray[np.int64], ReferenceTable]:
    """Return the rows of a log whose pose is in the reference, too, and the reference of these poses.

    `DataError` where hardly any pose is in both.
    """
    _, log_rows, rows = np.intersect1d(time_s, table.time_s, return_indices=True)
    if len(rows) < _LEAST_POSES:
        raise DataError(
            f"{len(rows)} poses are in both files, of {len(time_s)} in the log and {len(table.time_s)} in "
            "the reference: time_s is the number of the pose in both (--rate 1 numbers a log from 0)"
        )
    return log_rows, ReferenceTable(table.time_s[rows], table.values[rows])


def _filled(time_s: FloatArray, readings: FloatArray) -> FloatArray:
    """Interpolate missing readings in time; a channel without any is 0."""
    known = np.isfinite(readings)
    if known.all():
        return readings
    out = readings.copy()
    for channel in np.flatnonzero(~known.all(axis=0)):
        have = known[:, channel]
        out[:, channel] = np.interp(time_s, time_s[have], readings[have, channel]) if have.any() else 0.0
    return out


class AlignedReference:
    """Reference averaged over the bins of a log, at any offset and drift of its clock.

    Between its samples the reference is a straight line.
    """

    def __init__(self, table: ReferenceTable, log: BinnedLog) -> None:
        self._log = log
        self._origin_s = float(table.time_s[0])
        self._time_s = table.time_s - self._origin_s
        spacing_s = np.diff(self._time_s)
        values = self._values = np.where(np.isfinite(table.values), table.values, 0.0)
        self._slopes = np.diff(values, axis=0) / spacing_s[:, np.newaxis]
        areas = (values[1:] + values[:-1]) / 2 * spacing_s[:, np.newaxis]
        self._integral = np.concatenate([np.zeros((1, len(OUTPUTS))), np.cumsum(areas, axis=0)])
        self._table = table
        self.outputs = table.outputs
        self.sample_s = float(np.median(spacing_s))
        self.noise = table.noise()

    def _ends_s(self, late_s: float, drift: float) -> tuple[FloatArray, FloatArray]:
        """Beginning and end of each bin in the reference's clock, from its first sample."""
        return self._log.start_s * (1 + drift) + late_s, self._log.end_s * (1 + drift) + late_s

    def means(self, late_s: float, drift: float) -> FloatArray:
        """Return the mean of the reference in each bin (n, 6); at its ends the nearest values hold on.

        `late_s` is the time from the reference's first sample to the log's first scan, in the reference's
        clock; `drift` the relative excess of the rate of that clock.
        """
        start, end = self._ends_s(late_s, drift)
        width = np.maximum(end - start, 1e-9)[:, np.newaxis]
        return (self._at(end) - self._at(start)) / width

    def inside(self, late_s: float, drift: float) -> NDArray[np.bool_]:
        """Return True (n,) for bins that the reference covers."""
        start, end = self._ends_s(late_s, drift)
        return np.asarray((start >= 0.0) & (end <= self._time_s[-1]))

    def pauses(self, late_s: float) -> NDArray[np.int64]:
        """Return the number (n,) of the pause of the reference in which the whole bin lies, or -1."""
        start, end = self._ends_s(late_s, 0.0)
        after = np.searchsorted(self._time_s, start)
        is_long = np.diff(self._time_s, prepend=0.0, append=np.inf) > _PAUSE_SAMPLES * self.sample_s
        return np.where(is_long[after] & (np.searchsorted(self._time_s, end) == after), after, -1)

    def _at(self, time_s: FloatArray) -> FloatArray:
        """Integral (n, 6) from the first sample on; beyond the ends with the first and the last value."""
        last = len(self._time_s) - 2
        sample = np.clip(np.searchsorted(self._time_s, time_s, side="right") - 1, 0, last)
        inside_s = np.clip(time_s, 0.0, self._time_s[-1])
        since_s = (inside_s - self._time_s[sample])[:, np.newaxis]
        integral = self._integral[sample] + since_s * (
            self._values[sample] + since_s / 2 * self._slopes[sample]
        )
        before, after = np.minimum(time_s, 0.0), np.maximum(time_s - self._time_s[-1], 0.0)
        beyond = before[:, np.newaxis] * self._values[0] + after[:, np.newaxis] * self._values[-1]
        return np.asarray(integral + beyond)


class PoseReference(AlignedReference):
    """Reference of poses: a row for each, whatever the clocks."""

    def __init__(self, table: ReferenceTable, log: BinnedLog) -> None:
        super().__init__(table, log)
        self.noise = np.where(np.isnan(self.noise), np.nan, 0.0)

    def means(self, late_s: float, drift: float) -> FloatArray:  # noqa: ARG002  poses have no clock
        """Return the forces and moments (n, 6) of the poses."""
        return np.nan_to_num(self._table.values)

    def pauses(self, late_s: float) -> NDArray[np.int64]:  # noqa: ARG002
        """Return -1 for every pose."""
        return np.full(len(self._table.values), -1)

    def inside(self, late_s: float, drift: float) -> NDArray[np.bool_]:  # noqa: ARG002
        """Return True for every pose."""
        return np.ones(len(self._table.values), dtype=np.bool_)

"""Spacing of the scans of a log: its period, the rows that repeat a scan, and the blocks between gaps.

A host that polls writes the newest reading again until the sensor has another. Such rows are no scans: the
noise looks smaller than it is, changes look like steps, and a ripple looks faster than the sensor can follow.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.errors import DataError
from tactiled.samples.block import Gap, ScanBlock

# Part of a stamp's deviation that the schedule of scans follows: a tenth averages jitter over some 20 scans,
# and follows a rate that is wrong by 4 % with a lag of 0.4 scans.
_FOLLOW = 0.1

# Quantile of the steps that is the longest usual one, and how much longer than the median it is in an uneven
# log: a regular log has fewer missing scans than a tenth, and jitters by less than half a period.
_USUAL, _UNEVEN = 0.9, 1.5
_SINGLE = 0.55  # of the median, by which single steps differ: stamps in ms may be 1 to 3 ms apart
_MULTIPLE = 0.05  # of the number of periods, by which stamps of missing scans differ from a whole one

# Rows after a stall, for each scan that seemed missing in it, by which a host has caught up if it reads twice
# as fast as the sensor scans.
_CATCH_UP = 2

_LEAST_AGREED = 0.8  # a rate that is given, over that of the stamps: waiting times would be wrong by as much

_FEWEST = 20  # changes, by which the rate of the sensor is known
# Quantile of the rows from change to change, which is 1 where the sensor is as fast as the log: coarse
# readings at rest repeat often, but change from row to row under a press. One reading in twenty may be early.
_LEAST = 0.05
# Smallest steps of its channels by which a scan of a noisy sensor differs from the one before, in three of
# four: readings that creep over one step after the other change as regularly, and are scans.
_STEPS, _FEW_STEPS = 2.0, 0.25
_REGULAR = 0.5  # of the median, which it reaches in a log that polls: changes by chance come at any distance
_PIECE_ROWS = 4096  # that are compared at once: a few copies of a whole log might not fit into memory
_LATE = 1.5  # periods after which a reading that stays counts anew, as the host may poll late


class Spacing(NamedTuple):
    """Spacing of the scans of a log."""

    period_s: float  # time from scan to scan
    longest_s: float  # longest usual step; a longer one has missing scans or is a pause
    rows: int = 1  # rows of a scan: more than 1 where the sensor is slower than its log, and rows repeat it


def spacing_of(time_s: FloatArray, readings: FloatArray | None = None) -> Spacing:
    """Describe the spacing of stamps (n,), two at least, of the scans among them if readings are given.

    A log whose steps are mostly even, or multiples of one, has the mean of the single ones as its period:
    longer steps are missing scans. Where a tenth of the steps or more is half as long again and no multiple,
    the log is uneven, as of a host that polls: its period is the mean of the usual steps, and none of these
    is a gap. So is a log with rows that repeat a scan.
    """
    rows = 1 if readings is None else rows_of_a_reading(readings)
    if readings is not None and rows > 1:
        time_s = time_s[scans_among(readings, rows)]
    steps_s = np.diff(time_s)
    median_s, usual_s = float(np.median(steps_s)), float(np.quantile(steps_s, _USUAL, method="higher"))
    periods = usual_s / median_s
    if rows > 1:
        longest_s = max(usual_s, _LATE * median_s)
        return Spacing(float(steps_s[steps_s <= longest_s].mean()), longest_s, rows)
    if periods < _UNEVEN or abs(periods - round(periods)) < _MULTIPLE * periods:
        is_single = np.abs(steps_s - median_s) < _SINGLE * median_s
        period_s = float(steps_s[is_single].mean())
        return Spacing(period_s, period_s)
    return Spacing(float(steps_s[steps_s < _UNEVEN * usual_s].mean()), usual_s)


def rows_of_a_reading(readings: FloatArray) -> int:
    """Return the rows for which the sensor's reading stays, the median; 1 of a sensor as fast as its log.

    Parameters
    ----------
    readings : (n, channels) float64
        NaN where one is missing.
    """
    is_change = _changes(readings)
    rows = np.diff(np.flatnonzero(is_change))
    if len(rows) < _FEWEST:
        return 1
    smallest = np.full(readings.shape[1], np.inf)
    for _, held in _pieces(readings):
        moved = np.abs(np.diff(held, axis=0))
        smallest = np.minimum(smallest, np.where(moved > 0, moved, np.inf).min(axis=0, initial=np.inf))
    steps = [(np.abs(np.diff(held, axis=0)) / smallest).sum(axis=1) for _, held in _pieces(readings)]
    if np.quantile(np.concatenate(steps)[is_change], _FEW_STEPS) <= _STEPS:
        return 1
    median, least = float(np.median(rows)), float(np.quantile(rows, _LEAST, method="lower"))
    return round(median) if least > 1 and least >= _REGULAR * median else 1


def scans_among(readings: FloatArray, period_rows: int) -> NDArray[np.bool_]:
    """Return which rows (n,) of readings (n, channels) are scans, of a sensor with a scan in so many rows.

    A reading that stays for longer than a period of the sensor is one scan a period: nothing moves.
    """
    is_scan = np.ones(len(readings), dtype=np.bool_)
    if period_rows == 1:
        return is_scan
    longest = round(_LATE * period_rows)
    age = longest - period_rows + 1  # the first row is a scan
    for row, changes in enumerate(_changes(readings).tolist(), start=1):
        age += 1
        is_scan[row] = changes or age > longest
        if is_scan[row]:
            age = 0 if changes else age - period_rows
    return is_scan


def _changes(readings: FloatArray) -> NDArray[np.bool_]:
    """Return which rows (n - 1,) differ from the one before, of readings (n, channels).

    A reading that is missing in one of two rows tells nothing, unless no channel is read in both.
    """
    changes = []
    for rows, held in _pieces(readings):
        is_pair = np.isfinite(rows[1:]) & np.isfinite(rows[:-1])
        moves = held[1:] != held[:-1]
        changes.append((moves & is_pair).any(axis=1) | (moves.any(axis=1) & ~is_pair.any(axis=1)))
    return np.concatenate(changes)


def _pieces(readings: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield readings (n, channels) piece by piece, as read and as held; the next begins with the last row."""
    held = _held(readings[:1])
    for start in range(0, len(readings), _PIECE_ROWS):
        rows = readings[start : start + _PIECE_ROWS + 1]
        held = _held(np.vstack([held[-1:], rows[1:]]))
        yield rows, held


def _held(rows: FloatArray) -> FloatArray:
    """Return readings (n, channels) with the last one in place of missing ones, 0 before the first."""
    newest = np.maximum.accumulate(np.where(np.isnan(rows), 0, np.arange(len(rows))[:, np.newaxis]), axis=0)
    return np.nan_to_num(np.take_along_axis(rows, newest, axis=0))


def to_blocks(
    time_s: FloatArray, volts: FloatArray, rate_hz: float | None, valid: NDArray[np.bool_]
) -> list[ScanBlock | Gap]:
    """Split a log into blocks at missing scans; rows that repeat a scan are left out.

    `DataError` if the rate is not that of the times.

    Parameters
    ----------
    time_s : (n,) float64
        Strictly increasing.
    volts : (n, channels) float64
    rate_hz : float or None
        Rate of the scans, or of the rows where these repeat them; None to use their times.
    valid : (n, channels) bool
        False for readings that are missing or saturated.
    """
    spacing = spacing_of(time_s, volts)
    scan_hz = 1 / spacing.period_s if rate_hz is None else rate_hz
    if rate_hz is not None and (rate_hz * spacing.period_s) ** 2 > spacing.rows:  # nearer to that of rows
        scan_hz = rate_hz / spacing.rows
    if not _LEAST_AGREED < scan_hz * spacing.period_s < 1 / _LEAST_AGREED:
        raise DataError(
            f"a rate of {rate_hz:g} Hz, but rows are {spacing.period_s / spacing.rows:g} s apart: "
            "omit the rate, or correct the times"
        )
    is_scan = scans_among(volts, spacing.rows)
    if not is_scan.all():
        time_s, volts, valid = time_s[is_scan], volts[is_scan], valid[is_scan]
    steps = _steps(time_s, scan_hz, spacing)
    index = np.cumsum(steps) - 1
    starts = [0, *np.flatnonzero(steps > 1).tolist()]
    items: list[ScanBlock | Gap] = []
    for start, end in zip(starts, [*starts[1:], len(time_s)], strict=True):
        if start:
            items.append(Gap(int(steps[start]) - 1, "missing", int(index[start])))
        items.append(
            ScanBlock(
                volts=np.ascontiguousarray(volts[start:end]),
                time_s=time_s[start:end],
                time_sd_s=np.zeros(end - start),
                index=index[start:end],
                valid=valid[start:end],
                rate_hz=scan_hz,
                channel_offset_s=np.zeros(volts.shape[1]),
                late=np.zeros(end - start, dtype=np.bool_),
            )
        )
    return items


def _steps(time_s: FloatArray, rate_hz: float, spacing: Spacing) -> NDArray[np.int64]:
    """Return the scan periods (n,) from the row before to each row, 1 where none is missing.

    Rows are compared with a schedule that follows their stamps slowly: a stamp that jitters by less than half
    a period is no missing scan, nor is there one where the stated rate is wrong by a few percent. Rows that
    come late, and then faster than the schedule, waited in the host and are not missing. In an uneven log,
    scans are missing where a step is half as long again as the longest usual one.
    """
    steps = np.ones(len(time_s), dtype=np.int64)
    if spacing.longest_s > spacing.period_s:
        steps_s = np.diff(time_s)
        missing = np.maximum(np.rint(steps_s * rate_hz).astype(np.int64) - 1, 1)
        steps[1:] += np.where(steps_s > _UNEVEN * spacing.longest_s, missing, 0)
        return steps
    spacing_s = 1 / rate_hz
    expected_s = float(time_s[0]) - spacing_s
    late_row = last_row = 0  # the newest one with missing scans before it, and the last that may have waited
    for row, stamp_s in enumerate(time_s.tolist()):
        expected_s += spacing_s
        n_missing = round((stamp_s - expected_s) * rate_hz)
        if n_missing > 0:
            late_row, last_row = row, row + _CATCH_UP * n_missing
        elif row <= last_row:
            n_missing = max(n_missing, 1 - int(steps[late_row]))
        else:
            n_missing = 0
        steps[late_row] += n_missing
        expected_s += n_missing * spacing_s
        expected_s += _FOLLOW * (stamp_s - expected_s)
    return steps

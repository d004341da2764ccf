"""Logs from other sources: CSV with a header, npz, or Parquet."""

from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import DataError
from tactiled.pipeline import RATES_HZ
from tactiled.recording.repeats import LATE, RepeatFilter, rows_of_a_reading
from tactiled.recording.rows import MOST_BYTES, SECONDS, FloatArray, TableOptions, TimeUnit, rows_of
from tactiled.samples.block import Gap, ScanBlock

TABLES = (".csv", ".npz", ".parquet")

# Part of a stamp's deviation that the schedule of scans follows: a tenth averages jitter over some 20 scans,
# and follows a rate that is wrong by 4 % with a lag of 0.4 scans.
_FOLLOW = 0.1

# Quantile of the steps that is the longest usual one, and how much longer than the median it is in an uneven
# log: a regular log has fewer missing scans than a tenth, and jitters by less than half a period.
_USUAL, _UNEVEN = 0.9, 1.5
_MULTIPLE = 0.05  # of the number of periods, by which stamps of missing scans differ from a whole one

# A log slower than this more likely gives its times in milliseconds (10 kHz then reads as 10 Hz) or as row
# numbers than that it was recorded so slowly.
_SLOWEST_LIKELY_HZ = 10.0

_LEAST_AGREED = 0.8  # a rate that is given, over that of the stamps: waiting times would be wrong by as much

# Rows whose median spacing is the scan period, read before the first event: 17 minutes at 100 Hz, and no more
# readings than 32 MB.
_AHEAD_ROWS = 100_000
_AHEAD_VALUES = 1 << 22

Checked = tuple[FloatArray, FloatArray, float]
"""Times in seconds (n,), readings (n, channels), and the share of the file that has been read."""


def read_table(
    path: Path,
    rate_hz: float | None = None,
    columns: Sequence[str] = (),
    time_unit: TimeUnit | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Read the times (n,) in seconds and the readings (n, channels) of a log.

    ``.csv``: a header, a column ``time_s``, then one column per channel in channel order, with commas,
    semicolons or tabs between; an empty cell or ``nan`` is a missing reading, and a row without any reading
    a missing scan. Without a column of times, `rate_hz` spaces the rows.
    ``.npz``: ``time_s (n,)`` and ``volts (n, channels)``, or one array (n, ...) of another name; optional
    ``valid`` of the shape of ``volts`` is True for valid readings.
    ``.parquet``: columns as of a CSV, or lists of numbers, one list for each scan; a column of instants is
    the time whatever its name.

    Parameters
    ----------
    rate_hz : float, optional
        Rate that the user gives. Without it, a log slower than 10 Hz is refused: its times may not be in
        seconds.
    columns : sequence of str
        Names of the columns of a CSV or Parquet file in channel order, ``*`` for several; all but the time if
        left out.
    time_unit : str, optional
        Unit of the times; their column or array may then be called ``time``, ``t`` or ``timestamp``.

    Raises
    ------
    DataError
        The file is not a valid log (the message names the line or the array), or too large to be held.
    OperatorError
        A library that the file needs is not installed.
    """
    times, readings = array("d"), array("d")  # they grow in place: a list of parts is held twice when joined
    stream = TableStream(path, TableOptions(rate_hz, columns, time_unit))
    for time_s, volts, _ in stream:
        times.frombytes(time_s.tobytes())
        readings.frombytes(volts.tobytes())
        if readings.itemsize * len(readings) > MOST_BYTES:
            raise DataError(f"{path}: has more than {MOST_BYTES / 1e9:g} GB of readings; split it")
    return np.frombuffer(times), np.frombuffer(readings).reshape(-1, stream.n_channels)


class TableStream:
    """Rows of a log in batches, checked; iterate once.

    The first rows are read at once, for the scan period and the number of channels.

    Attributes
    ----------
    spacing : Spacing
        Of the first 100,000 rows, fewer of arrays of many channels.

    Raises
    ------
    DataError
        The file is not a valid log; raised by the iteration, too.
    """

    def __init__(self, path: Path, options: TableOptions) -> None:
        self._path = path
        self._options = options
        self._n_rows = 0
        self._last_s = -np.inf
        self._rest = self._scans()
        self._ahead = self._read_ahead()
        if (n := _n_rows(self._ahead)) < 2:
            raise DataError(
                f"{path}: {n} scans (rows with a reading); at least two are needed to compute the rate"
            )
        self.n_channels = self._ahead[0][1].shape[1]
        time_s, readings = (np.concatenate(part) for part in list(zip(*self._ahead, strict=True))[:2])
        self.spacing = spacing_of(time_s, readings)
        if fault := _rate_fault(spacing_of(time_s).period_s, options):
            raise DataError(f"{path}: {fault}")

    def __iter__(self) -> Iterator[Checked]:
        """Yield times (n,), readings (n, channels) and the share of the file that has been read."""
        while self._ahead:
            yield self._ahead.pop(0)
        yield from self._rest

    def _read_ahead(self) -> list[Checked]:
        """Read the first rows, two at least if there are so many."""
        batches: list[Checked] = []
        n_values = 0
        for batch in self._rest:
            batches.append(batch)
            n_values += batch[1].size
            n_rows = _n_rows(batches)
            if n_rows >= _AHEAD_ROWS or (n_values >= _AHEAD_VALUES and n_rows > 1):
                break
        return batches

    def _scans(self) -> Iterator[Checked]:
        """Yield the rows that have a reading, with times in seconds and NaN for what is no number.

        The other rows are missing scans, which detectors bridge.
        """
        path, options = self._path, self._options
        unit_s = SECONDS[options.time_unit or "s"]
        for stamps, volts, share in rows_of(path, options):
            n, first = len(volts), self._n_rows
            if not n:
                continue
            if options.rate_hz is not None and np.isnan(stamps).all():
                stamps = np.arange(first, first + n) / options.rate_hz / unit_s
            time_s = stamps * unit_s
            if not np.all(np.isfinite(time_s)):
                row = first + int(np.argmin(np.isfinite(time_s))) + 1
                raise DataError(f"{path}: time_s is not a number in row {row}")
            backwards = np.flatnonzero(np.diff(time_s, prepend=self._last_s) <= 0)
            if backwards.size:
                at = int(backwards[0])
                before_s = time_s[at - 1] if at else self._last_s
                raise DataError(
                    f"{path}: time_s does not grow at row {first + at + 1} ({before_s} to {time_s[at]})"
                )
            self._n_rows, self._last_s = first + n, float(time_s[-1])
            is_number = np.isfinite(volts)
            if (is_scan := is_number.any(axis=1)).any():
                yield time_s[is_scan], np.where(is_number, volts, np.nan)[is_scan], share


def _n_rows(batches: Sequence[Checked]) -> int:
    return sum(len(time_s) for time_s, _, _ in batches)


def _rate_fault(spacing_s: float, options: TableOptions) -> str:
    """Describe an implausible time spacing and its remedy; empty where the times are probably seconds."""
    slowest, fastest = RATES_HZ
    rate_hz = 1 / spacing_s
    rows = f"rows are {spacing_s:g} s apart by time_s, {rate_hz:g} Hz"
    if rate_hz > fastest:
        return f"{rows}, and no board is faster than {fastest:g} Hz; give it in seconds or say --time-unit"
    is_known = options.rate_hz is not None or options.time_unit is not None
    if rate_hz >= (slowest if is_known else _SLOWEST_LIKELY_HZ):
        return ""
    unit_hz = rate_hz * SECONDS[options.time_unit or "s"]
    given = options.time_unit or "s"
    likely = [unit for unit in SECONDS if _SLOWEST_LIKELY_HZ <= unit_hz / SECONDS[unit] <= fastest]
    unit = next((unit for unit in likely if unit != given), "")
    other = f"if they are in {unit} say --time-unit {unit}, " if unit else ""
    slow = f"; if scans are so slow, give --rate {rate_hz:g}" if rate_hz >= slowest else ""
    return (
        f"{rows}; times are taken in {options.time_unit or 'seconds'}: {other}if they count rows divide by "
        f"the rate{slow}"
    )


class Spacing(NamedTuple):
    """Spacing of the scans of a log."""

    period_s: float  # time from scan to scan
    longest_s: float  # longest usual step; a longer one has missing scans or is a pause
    rows: int = 1  # rows of a scan: more than 1 where the sensor is slower than its log, and rows repeat it


def spacing_of(time_s: FloatArray, readings: FloatArray | None = None) -> Spacing:
    """Describe the spacing of stamps (n,), two at least, of the scans among them if readings are given.

    A log whose steps are mostly even, or multiples of one, has the median as its period: longer steps are
    missing scans. Where a tenth of the steps or more is half as long again and no multiple, the log is
    uneven, as of a host that polls: its period is the mean of the usual steps, and none of these is a gap.
    So is a log with rows that repeat a scan.
    """
    rows = 1 if readings is None else rows_of_a_reading(readings)
    if readings is not None and rows > 1:
        time_s = time_s[RepeatFilter(rows).take(readings)]
    steps_s = np.diff(time_s)
    median_s, usual_s = float(np.median(steps_s)), float(np.quantile(steps_s, _USUAL, method="higher"))
    periods = usual_s / median_s
    if rows > 1:
        longest_s = max(usual_s, LATE * median_s)
        return Spacing(float(steps_s[steps_s <= longest_s].mean()), longest_s, rows)
    if periods < _UNEVEN or abs(periods - round(periods)) < _MULTIPLE * periods:
        return Spacing(median_s, median_s)
    return Spacing(float(steps_s[steps_s < _UNEVEN * usual_s].mean()), usual_s)


class BlockSplitter:
    """Split a log into blocks at missing scans, batch by batch; batches do not change the blocks' scans.

    Rows are compared with a schedule that follows their stamps slowly: a stamp that jitters by less than half
    a period is no missing scan, nor is there one where the stated rate is wrong by a few percent. In an
    uneven log, scans are missing where a step is half as long again as the longest usual one.

    Parameters
    ----------
    rate_hz : float or None
        Rate of the scans, or of the rows where these repeat them; None to use their times.

    Attributes
    ----------
    n_repeats : int
        Rows that repeat the scan before, and are none.
    """

    def __init__(self, spacing: Spacing, rate_hz: float | None) -> None:
        self._rate_hz = 1 / spacing.period_s if rate_hz is None else rate_hz
        if rate_hz is not None and (rate_hz * spacing.period_s) ** 2 > spacing.rows:  # nearer to that of rows
            self._rate_hz = rate_hz / spacing.rows
        if not _LEAST_AGREED < self._rate_hz * spacing.period_s < 1 / _LEAST_AGREED:
            raise DataError(
                f"a rate of {rate_hz:g} Hz, but rows are {spacing.period_s / spacing.rows:g} s apart: "
                "omit the rate, or correct time_s"
            )
        self._repeats = RepeatFilter(spacing.rows)
        self.n_repeats = 0
        self._is_uneven = spacing.longest_s > spacing.period_s
        self._longest_s = spacing.longest_s
        self._expected_s: float | None = None
        self._index = -1

    def split(self, time_s: FloatArray, volts: FloatArray, valid: NDArray[np.bool_]) -> list[ScanBlock | Gap]:
        """Return the blocks and gaps of the next rows; parameters as of `to_blocks`."""
        is_scan = self._repeats.take(volts)
        if not is_scan.all():
            self.n_repeats += int((~is_scan).sum())
            time_s, volts, valid = time_s[is_scan], volts[is_scan], valid[is_scan]
        if not len(time_s):
            return []
        is_first = self._expected_s is None
        steps = self._steps(time_s)
        index = self._index + np.cumsum(steps)
        items: list[ScanBlock | Gap] = []
        holes = np.flatnonzero(steps > 1).tolist()
        ends = [*(hole for hole in holes if hole), len(time_s)]
        start = 0
        for end in ends:
            if steps[start] > 1 and not (is_first and start == 0):
                items.append(Gap(int(steps[start]) - 1, "missing", int(index[start])))
            part = slice(start, end)
            n = end - start
            items.append(
                ScanBlock(
                    volts=np.ascontiguousarray(volts[part]),
                    time_s=time_s[part],
                    time_sd_s=np.zeros(n),
                    index=index[part],
                    valid=valid[part],
                    rate_hz=self._rate_hz,
                    channel_offset_s=np.zeros(volts.shape[1]),
                    late=np.zeros(n, dtype=np.bool_),
                )
            )
            start = end
        self._index = int(index[-1])
        return items

    def _steps(self, time_s: FloatArray) -> NDArray[np.int64]:
        """Number of scan periods (n,) from the row before to each row, 1 where none is missing."""
        steps = np.ones(len(time_s), dtype=np.int64)
        spacing_s = 1 / self._rate_hz
        expected_s = self._expected_s
        for row, stamp_s in enumerate(time_s.tolist()):
            if expected_s is None:
                expected_s = stamp_s
                continue
            if self._is_uneven:  # no schedule: each step counts by itself
                steps[row] += self._missing(stamp_s - expected_s)
                expected_s = stamp_s
                continue
            expected_s += spacing_s
            missing = round((stamp_s - expected_s) * self._rate_hz)
            if missing > 0:
                steps[row] += missing
                expected_s += missing * spacing_s
            expected_s += _FOLLOW * (stamp_s - expected_s)
        self._expected_s = expected_s
        return steps

    def _missing(self, step_s: float) -> int:
        """Scans that an uneven log lacks in a step."""
        is_gap = step_s > _UNEVEN * self._longest_s
        return max(round(step_s * self._rate_hz) - 1, 1) if is_gap else 0


def to_blocks(
    time_s: FloatArray, volts: FloatArray, rate_hz: float | None, valid: NDArray[np.bool_]
) -> list[ScanBlock | Gap]:
    """Split a log into blocks at missing scans.

    Parameters
    ----------
    time_s : (n,) float64
        Strictly increasing.
    volts : (n, channels) float64
    valid : (n, channels) bool
        False for readings that are missing or saturated.
    """
    return BlockSplitter(spacing_of(time_s, volts), rate_hz).split(time_s, volts, valid)

"""Logs from other sources: CSV with a header, npz, or Parquet."""

import csv
import fnmatch
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError, DataError, OperatorError, install_command
from tactiled.pipeline import RATES_HZ
from tactiled.samples.block import Gap, ScanBlock

if TYPE_CHECKING:
    import pyarrow

FloatArray = NDArray[np.float64]

TABLES = (".csv", ".npz", ".parquet")
TimeUnit = Literal["s", "ms", "us", "ns"]
_SECONDS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

# Part of a stamp's deviation that the schedule of scans follows: a tenth averages jitter over some 20 scans,
# and follows a rate that is wrong by 4 % with a lag of 0.4 scans.
_FOLLOW = 0.1

# A log slower than this more likely gives its times in milliseconds (10 kHz then reads as 10 Hz) or as row
# numbers than that it was recorded so slowly.
_SLOWEST_LIKELY_HZ = 10.0


def read_table(
    path: Path,
    rate_hz: float | None = None,
    columns: Sequence[str] = (),
    time_unit: TimeUnit | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Read the times and readings of a log.

    Parameters
    ----------
    path : Path
        ``.csv``: a header, a column ``time_s``, then one column per channel in channel order, with commas,
        semicolons or tabs between; an empty cell or ``nan`` is a missing reading, and a row without any
        reading a missing scan. Without a column of times, `rate_hz` spaces the rows.
        ``.npz``: ``time_s (n,)`` and ``volts (n, channels)``, or one array (n, ...) of another name;
        optional ``valid`` of the shape of ``volts`` is True for valid readings.
        ``.parquet``: columns as of a CSV, or lists of numbers, one list for each scan; a column of instants
        is the time whatever its name.
    rate_hz : float, optional
        Rate that the user gives. Without it, a log slower than 10 Hz is refused: its times may not be in
        seconds.
    columns : sequence of str
        Names of the columns of a CSV or Parquet file in channel order, ``*`` for several; all but the time if
        left out.
    time_unit : str, optional
        Unit of the times: s, ms, us or ns; their column or array may then be called ``time``, ``t`` or
        ``timestamp``.

    Returns
    -------
    time_s : (n,) float64
    volts : (n, channels) float64

    Raises
    ------
    DataError
        The file is not a valid log; the message names the line or the array.
    OperatorError
        A library that the file needs is not installed.
    """
    if path.suffix == ".npz":
        if columns:
            raise ConfigError(
                "command line", ["--columns is for CSV and Parquet; an npz file has the array volts"]
            )
        time_s, volts = _read_npz(path, rate_hz, time_unit)
    elif path.suffix == ".parquet":
        time_s, volts = _read_parquet(path, rate_hz, columns, time_unit)
    else:
        time_s, volts = _read_csv(path, rate_hz, columns, time_unit)
    time_s = time_s * _SECONDS[time_unit or "s"]
    if len(time_s) < 2:
        raise DataError(f"{path}: {len(time_s)} scans; at least two are needed to compute the rate")
    if not np.all(np.isfinite(time_s)):
        raise DataError(f"{path}: time_s is not a number in row {int(np.argmin(np.isfinite(time_s))) + 1}")
    backwards = np.flatnonzero(np.diff(time_s) <= 0)
    if backwards.size:
        row = int(backwards[0]) + 2
        raise DataError(f"{path}: time_s does not grow at row {row} ({time_s[row - 2]} to {time_s[row - 1]})")
    is_known = rate_hz is not None or time_unit is not None
    if fault := _rate_fault(float(np.median(np.diff(time_s))), is_known=is_known):
        raise DataError(f"{path}: {fault}")
    volts = np.where(np.isfinite(volts), volts, np.nan)
    is_scan = np.isfinite(volts).any(axis=1)
    # Rows between scans are missing scans, which detectors bridge; those of a log without any scan stay.
    return (time_s[is_scan], volts[is_scan]) if is_scan.sum() > 1 else (time_s, volts)


def _rate_fault(spacing_s: float, *, is_known: bool) -> str:
    """Describe an implausible time spacing and its remedy; empty where the times are probably seconds."""
    slowest, fastest = RATES_HZ
    rate_hz = 1 / spacing_s
    rows = f"rows are {spacing_s:g} s apart by time_s, {rate_hz:g} Hz"
    if rate_hz > fastest:
        return f"{rows}, and no board is faster than {fastest:g} Hz; give it in seconds or say --time-unit"
    if rate_hz < (slowest if is_known else _SLOWEST_LIKELY_HZ):
        slow = f"; if scans are so slow, give --rate {rate_hz:g}" if rate_hz >= slowest else ""
        return (
            f"{rows}; time_s is in seconds: if these are milliseconds say --time-unit ms, if they count rows "
            f"divide by the rate{slow}"
        )
    return ""


def to_blocks(
    time_s: FloatArray, volts: FloatArray, rate_hz: float | None, valid: NDArray[np.bool_]
) -> list[ScanBlock | Gap]:
    """Split a log into blocks at missing scans.

    Parameters
    ----------
    time_s : (n,) float64
        Strictly increasing.
    volts : (n, channels) float64
    rate_hz : float or None
        Scan rate; None to use the median interval.
    valid : (n, channels) bool
        False for readings that are missing or saturated.
    """
    spacing_s = float(np.median(np.diff(time_s)))
    rate_hz = rate_hz or 1 / spacing_s
    if not 0.1 < rate_hz * spacing_s < 10:
        raise DataError(
            f"a rate of {rate_hz:g} Hz, but rows are {spacing_s:g} s apart: omit the rate, or correct time_s"
        )
    steps = _scans_between(time_s, rate_hz)
    index = np.concatenate([[0], np.cumsum(steps)])
    items: list[ScanBlock | Gap] = []
    ends = [*(np.flatnonzero(steps > 1) + 1).tolist(), len(time_s)]
    start = 0
    for end in ends:
        if start:
            missing = int(index[start] - index[start - 1] - 1)
            items.append(Gap(missing, "missing", int(index[start])))
        part = slice(start, end)
        n = end - start
        items.append(
            ScanBlock(
                volts=np.ascontiguousarray(volts[part]),
                time_s=time_s[part],
                time_sd_s=np.zeros(n),
                index=index[part],
                valid=valid[part],
                rate_hz=rate_hz,
                channel_offset_s=np.zeros(volts.shape[1]),
                late=np.zeros(n, dtype=np.bool_),
            )
        )
        start = end
    return items


def _scans_between(time_s: FloatArray, rate_hz: float) -> NDArray[np.int64]:
    """Number of scan periods (n - 1,) from each row to the next, 1 where none is missing.

    Rows are compared with a schedule that follows their stamps slowly: a stamp that jitters by less than half
    a period is no missing scan, nor is there one where the stated rate is wrong by a few percent.
    """
    steps = np.ones(len(time_s) - 1, dtype=np.int64)
    spacing_s = 1 / rate_hz
    expected_s = float(time_s[0])
    for row, stamp_s in enumerate(time_s[1:].tolist()):
        expected_s += spacing_s
        missing = round((stamp_s - expected_s) * rate_hz)
        if missing > 0:
            steps[row] += missing
            expected_s += missing * spacing_s
        expected_s += _FOLLOW * (stamp_s - expected_s)
    return steps


def _read_npz(path: Path, rate_hz: float | None, time_unit: TimeUnit | None) -> tuple[FloatArray, FloatArray]:
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise DataError(f"{path}: not a complete npz file; write one with numpy.savez")
            stream.seek(0)
            return _from_archive(path, stream, rate_hz, time_unit)
    except ValueError:  # numpy's message suggests unpickling, which is unsafe
        raise DataError(f"{path}: time_s and volts must be arrays of numbers") from None
    except (OSError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise DataError(f"{path}: cannot be read as npz: {error}") from None


def _from_archive(
    path: Path, stream: BinaryIO, rate_hz: float | None, time_unit: TimeUnit | None
) -> tuple[FloatArray, FloatArray]:
    with np.load(stream, allow_pickle=False) as archive:
        time_name = next((name for name in _time_names(time_unit) if name in archive), None)
        others = [name for name in archive.files if name not in (*_time_names("s"), time_name, "valid")]
        name = "volts" if "volts" in archive else others[0] if len(others) == 1 else None
        if (time_name is None and rate_hz is None) or name is None:
            missing = [
                *(["time_s"] if time_name is None and rate_hz is None else []),
                *(["volts"] if name is None else []),
            ]
            raise DataError(
                f"{path}: lacks the array {' and '.join(missing)}; it has {archive.files}; an array time, t "
                "or timestamp needs --time-unit, and a log without times needs --rate"
            )
        volts = archive[name].astype(np.float64, casting="same_kind")
        shape = volts.shape
        if volts.ndim > 1:  # rows and columns of taxels, and their axes: channel order is that of the array
            volts = volts.reshape(len(volts), -1)
        if time_name is None:
            assert rate_hz is not None
            time_s = np.arange(len(volts)) / rate_hz / _SECONDS[time_unit or "s"]
        else:
            time_s = archive[time_name].astype(np.float64, casting="same_kind")
        if time_s.ndim != 1 or volts.ndim != 2 or len(volts) != len(time_s):
            raise DataError(
                f"{path}: {time_name} {time_s.shape} and {name} {shape} should be (n,) and (n, channels)"
            )
        if "valid" in archive:  # written by tactiled export: invalid readings become NaN
            if archive["valid"].shape != shape:
                raise DataError(
                    f"{path}: valid {archive['valid'].shape} should have the shape of {name} {shape}"
                )
            volts = np.where(archive["valid"].reshape(volts.shape), volts, np.nan)
    return time_s, volts


def _read_csv(
    path: Path, rate_hz: float | None, columns: Sequence[str], time_unit: TimeUnit | None
) -> tuple[FloatArray, FloatArray]:
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            first_line = stream.readline()
            stream.seek(0)
            reader = csv.reader(stream, delimiter=max(",;\t", key=first_line.count))
            header = [name.strip() for name in next(reader, [])]
            time_column = _time_column(path, header, rate_hz, time_unit)
            chosen = _chosen(path, header, columns, time_column)
            needed = chosen if time_column is None else [time_column, *chosen]
            for cells in reader:
                if not cells:
                    continue
                if len(cells) != len(header):
                    raise DataError(
                        f"{path}: line {reader.line_num} has {len(cells)} cells, the header has {len(header)}"
                    )
                rows.append([_number(cells[column], path, reader.line_num) for column in needed])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(needed))
    if time_column is not None:
        return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1:])
    assert rate_hz is not None
    return np.arange(len(rows)) / rate_hz / _SECONDS[time_unit or "s"], table


def _read_parquet(
    path: Path, rate_hz: float | None, columns: Sequence[str], time_unit: TimeUnit | None
) -> tuple[FloatArray, FloatArray]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise OperatorError(f"{path}: Parquet needs pyarrow: {install_command('parquet')}") from None
    try:
        # As one file: pyarrow takes names of folders like "run=3" for columns.
        table = pyarrow.parquet.ParquetFile(path).read()
    except (OSError, pyarrow.ArrowException) as error:
        raise DataError(f"{path}: cannot be read as Parquet: {error}") from None
    # pandas stores the numbers of its rows as columns of this name.
    header = [name for name in table.column_names if not name.startswith("__index_level_")]
    instants = [
        k for k, name in enumerate(header) if pyarrow.types.is_timestamp(table.schema.field(name).type)
    ]
    time_column = instants[0] if instants else _time_column(path, header, rate_hz, time_unit)
    chosen = [header[k] for k in _chosen(path, header, columns, time_column)]
    parts = [_parquet_numbers(path, table, name) for name in chosen]
    readings = np.concatenate(parts, axis=1) if parts else np.zeros((table.num_rows, 0))
    if time_column is None:
        assert rate_hz is not None
        return np.arange(table.num_rows) / rate_hz / _SECONDS[time_unit or "s"], readings
    if not instants:
        return _parquet_numbers(path, table, header[time_column])[:, 0], readings
    instant = table.column(header[time_column]).cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
    time_s = instant.to_numpy(zero_copy_only=False) * 1e-9
    return time_s / _SECONDS[time_unit or "s"], readings


def _parquet_numbers(path: Path, table: "pyarrow.Table", name: str) -> FloatArray:
    """Return a column as numbers (n, 1), or a column of lists of equal length as (n, length)."""
    column = table.column(name)
    try:
        if hasattr(column.type, "value_type"):
            return np.array(column.to_pylist(), dtype=np.float64).reshape(table.num_rows, -1)
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)[:, None]
    except (TypeError, ValueError):
        raise DataError(
            f"{path}: column {name} holds {column.type}, not numbers or lists of one length; "
            "choose the channels with --columns"
        ) from None


def _time_column(
    path: Path, header: list[str], rate_hz: float | None, time_unit: TimeUnit | None
) -> int | None:
    """Return the number of the column of times; None where the rate stands for it."""
    for name in _time_names(time_unit):
        if name in header:
            return header.index(name)
    if rate_hz is not None:
        return None
    found = ", ".join(header[:6]) or "nothing"
    raise DataError(
        f"{path}: the header lacks the column time_s (found: {found}); "
        "a column time, t or timestamp needs --time-unit, and a log without times needs --rate"
    )


def _time_names(time_unit: TimeUnit | None) -> list[str]:
    """Return the names that a column of times may have."""
    return ["time_s"] if time_unit is None else ["time_s", f"time_{time_unit}", "time", "t", "timestamp"]


def _chosen(path: Path, header: list[str], columns: Sequence[str], time_column: int | None) -> list[int]:
    """Return the numbers of the columns of the channels, in channel order."""
    if not columns:
        return [number for number in range(len(header)) if number != time_column]
    chosen: list[int] = []
    for pattern in columns:
        matching = [
            k for k, name in enumerate(header) if fnmatch.fnmatchcase(name, pattern) and k != time_column
        ]
        if not matching:
            raise DataError(f"{path}: no column {pattern!r} of --columns; the header has {', '.join(header)}")
        chosen += matching
    return chosen


def _number(cell: str, path: Path, line: int) -> float:
    if not cell.strip():
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        raise DataError(f"{path}: line {line}: {cell!r} is not a number") from None

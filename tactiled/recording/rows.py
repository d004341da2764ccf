"""Rows of CSV, npz and Parquet files, a batch at a time: a file may be larger than the memory.

An array that an npz stores columns first is held as a whole, at most `MOST_BYTES`.
"""

import csv
import fnmatch
import io
import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError, DataError, OperatorError, install_command

if TYPE_CHECKING:
    import pyarrow

FloatArray = NDArray[np.float64]
TimeUnit = Literal["s", "ms", "us", "ns"]
SECONDS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
Batch = tuple[FloatArray, FloatArray, float]
"""Times (n,), NaN where the rate stands for them; readings (n, channels); share of the file, 0 to 1."""

# Declared size of an array in an npz, or of the lists in a Parquet file, as float64. These formats compress:
# 18 MB may claim 3.7 GB. It is 19 h of 36 channels at 100 Hz; CSV and plain Parquet columns have no limit.
MOST_BYTES = 2 * 10**9
# An array of 4096 taxels with four sides has them. A row of more is no scan, and one row is read at once.
MOST_CHANNELS = 4 * 4096
_MOST_HEADER_BYTES = 10_000  # of an array in an npz: a hundred are enough, and numpy would read 4 GB
_MOST_LINE = 4 * 2**20  # characters of a CSV: 12,000 channels have 300,000
_BATCH_ROWS = 1000  # ten seconds of the published board
_BATCH_VALUES = 1 << 20  # 8 MB, of arrays of many channels


@dataclass(frozen=True)
class TableOptions:
    """Options of `read_table`."""

    rate_hz: float | None = None
    columns: Sequence[str] = ()
    time_unit: TimeUnit | None = None


def rows_of(path: Path, options: TableOptions) -> Iterator[Batch]:
    """Yield the rows of a file as they stand in it; times in the unit of the file.

    Raises
    ------
    DataError
        The file is no table, or claims more than `MOST_BYTES`; found before anything of that size is made.
    """
    if path.suffix == ".npz":
        if options.columns:
            raise ConfigError(
                "command line", ["--columns is for CSV and Parquet; an npz file has the array volts"]
            )
        return _npz_rows(path, options)
    return _parquet_rows(path, options) if path.suffix == ".parquet" else _csv_rows(path, options)


def _batch_rows(n_channels: int) -> int:
    return max(1, min(_BATCH_ROWS, _BATCH_VALUES // max(n_channels, 1)))


def _no_times(n: int) -> FloatArray:
    return np.full(n, np.nan)


def _csv_rows(path: Path, options: TableOptions) -> Iterator[Batch]:
    try:
        size = max(path.stat().st_size, 1)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            first_line = stream.readline(_MOST_LINE)
            stream.seek(0)
            n_read = [0]
            lines = _bounded_lines(path, stream, n_read)
            reader = csv.reader(lines, delimiter=max(",;\t", key=first_line.count))
            header = [name.strip() for name in next(reader, [])]
            if header and all(map(_is_number, header)) and not _counts(header):
                raise DataError(
                    f"{path}: the first line has numbers only; write a line of names above it, or in its "
                    "place where it is the header"
                )
            time_column = _time_column(path, header, options)
            needed = _chosen(path, header, options.columns, time_column)
            most = _batch_rows(len(needed))
            times: list[float] = []
            rows: list[list[float]] = []
            for cells in reader:
                if not cells:
                    continue
                line = reader.line_num
                if len(cells) != len(header):
                    raise DataError(
                        f"{path}: line {line} has {len(cells)} cells, the header has {len(header)}"
                    )
                if time_column is not None:
                    times.append(_number(cells[time_column], path, line))
                rows.append([_number(cells[column], path, line) for column in needed])
                if len(rows) == most:
                    yield _csv_batch(times, rows, len(needed), n_read[0] / size)
                    times, rows = [], []
            yield _csv_batch(times, rows, len(needed), 1.0)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None


def _csv_batch(times: list[float], rows: list[list[float]], n_channels: int, share: float) -> Batch:
    time_s = np.array(times, dtype=np.float64) if times else _no_times(len(rows))
    return time_s, np.array(rows, dtype=np.float64).reshape(len(rows), n_channels), min(share, 1.0)


def _bounded_lines(path: Path, stream: TextIO, n_read: list[int]) -> Iterator[str]:
    """Yield the lines of a file, none beyond the limit; count the characters in `n_read`."""
    while line := stream.readline(_MOST_LINE):
        if len(line) == _MOST_LINE:
            raise DataError(f"{path}: a line has more than {_MOST_LINE} characters")
        n_read[0] += len(line)
        yield line


@dataclass(frozen=True)
class _Member:
    """Array in an npz, as its header describes it."""

    name: str
    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[np.generic]

    @property
    def row_bytes(self) -> int:
        return math.prod(self.shape[1:]) * self.dtype.itemsize


def _npz_rows(path: Path, options: TableOptions) -> Iterator[Batch]:
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise DataError(f"{path}: not a complete npz file; write one with numpy.savez")
            with zipfile.ZipFile(stream) as archive:
                yield from _archive_rows(path, archive, options)
    except ValueError:  # of numpy, on a header; its message may suggest unpickling, which is unsafe
        raise DataError(f"{path}: time_s and volts must be arrays of numbers") from None
    except (
        OSError,
        TypeError,
        EOFError,
        NotImplementedError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
        tokenize.TokenError,  # of numpy, on a header of brackets
    ) as error:
        raise DataError(f"{path}: cannot be read as npz: {error}") from None


def _archive_rows(path: Path, archive: zipfile.ZipFile, options: TableOptions) -> Iterator[Batch]:
    names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    time_name = next((name for name in _time_names(options.time_unit) if name in names), None)
    others = [name for name in names if name not in (*_time_names("s"), time_name, "valid")]
    name = "volts" if "volts" in names else others[0] if len(others) == 1 else None
    lacks_time = time_name is None and options.rate_hz is None
    if lacks_time or name is None:
        missing = [*(["time_s"] if lacks_time else []), *(["volts"] if name is None else [])]
        raise DataError(
            f"{path}: lacks the array {' and '.join(missing)}; it has {names}; an array time, t "
            "or timestamp needs --time-unit, and a log without times needs --rate"
        )
    readings = _member(path, archive, name)
    time = _member(path, archive, time_name) if time_name else None
    valid = _member(path, archive, "valid") if "valid" in names else None
    n_rows = readings.shape[0] if readings.shape else 0
    if len(readings.shape) < 2 or (time is not None and time.shape != (n_rows,)):
        raise DataError(
            f"{path}: {time_name} {time.shape if time else ''} and {name} {readings.shape} should be (n,) "
            "and (n, channels)"
        )
    if valid is not None and valid.shape != readings.shape:
        raise DataError(f"{path}: valid {valid.shape} should have the shape of {name} {readings.shape}")
    n_channels = math.prod(readings.shape[1:])
    if not 0 < n_channels <= MOST_CHANNELS:  # rows without a channel cost no bytes: there may be any number
        raise DataError(f"{path}: {name} has {n_channels} channels; 1 to {MOST_CHANNELS} are read")
    most = _batch_rows(n_channels)
    parts = [_parts(archive, member, most) for member in (time, readings, valid) if member is not None]
    n_done = 0
    for batch in zip(*parts, strict=True):
        rows = batch[0 if time is None else 1].astype(np.float64).reshape(-1, n_channels)
        if valid is not None:  # written by `calibrate --guide`: invalid readings become NaN
            rows = np.where(batch[-1].reshape(rows.shape), rows, np.nan)
        n_done += len(rows)
        yield _no_times(len(rows)) if time is None else batch[0].astype(np.float64), rows, n_done / n_rows


def _member(path: Path, archive: zipfile.ZipFile, name: str) -> _Member:
    """Read the header of an array, and refuse it where it claims too much."""
    if archive.getinfo(f"{name}.npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise DataError(f"{path}: {name} is compressed as numpy compresses nothing; write it by numpy.savez")
    with archive.open(f"{name}.npy") as stream:
        shape, is_fortran, dtype = _npy_header(stream)
    if not np.can_cast(dtype, np.float64, "same_kind") or any(length < 0 for length in shape):
        raise DataError(f"{path}: time_s and volts must be arrays of numbers")
    if (n_bytes := math.prod(shape) * max(8, dtype.itemsize)) > MOST_BYTES:
        raise DataError(
            f"{path}: {name} {shape} has {n_bytes / 1e9:.1f} GB, and at most {MOST_BYTES / 1e9:g} GB are "
            "read from an npz; split it, or write CSV or Parquet, which have no limit"
        )
    return _Member(name, shape, is_fortran, dtype)


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[np.generic]]:
    version = np.lib.format.read_magic(stream)
    is_first = version == (1, 0)
    length = stream.read(2 if is_first else 4)
    if (n_bytes := int.from_bytes(length, "little")) > _MOST_HEADER_BYTES:
        raise ValueError(f"the header of an array claims {n_bytes} bytes")
    header = io.BytesIO(length + stream.read(n_bytes))
    read = np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = read(header)
    return tuple(int(length) for length in shape), bool(is_fortran), dtype


def _parts(archive: zipfile.ZipFile, member: _Member, most: int) -> Iterator[NDArray[np.generic]]:
    """Yield the rows of an array, `most` at a time; columns first is read at once, within the limit."""
    with archive.open(f"{member.name}.npy") as stream:
        _npy_header(stream)
        shape = member.shape
        if member.is_fortran and len(shape) > 1:
            whole = np.empty(math.prod(shape), member.dtype)
            for at in range(0, whole.size, _BATCH_VALUES):  # zlib holds twice what it is asked for
                part = whole[at : at + _BATCH_VALUES]
                part[:] = _exactly(stream, part.nbytes, member.dtype)
            _check_end(stream)
            whole = whole.reshape(shape, order="F")
            yield from (whole[at : at + most] for at in range(0, shape[0], most))
            return
        for at in range(0, shape[0], most):
            n = min(most, shape[0] - at)
            yield _exactly(stream, n * member.row_bytes, member.dtype).reshape(n, *shape[1:])
        _check_end(stream)


def _check_end(stream: IO[bytes]) -> None:
    """Read the end of an array, at which zipfile compares the checksum."""
    if stream.read(1):
        raise zipfile.BadZipFile("an array has more bytes than the shape that it claims")


def _exactly(stream: IO[bytes], n_bytes: int, dtype: np.dtype[np.generic]) -> NDArray[np.generic]:
    data = stream.read(n_bytes)
    if len(data) < n_bytes:
        raise EOFError("an array ends before the shape that it claims")
    return np.frombuffer(data, dtype)


def _parquet_rows(path: Path, options: TableOptions) -> Iterator[Batch]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise OperatorError(f"{path}: Parquet needs pyarrow: {install_command('parquet')}") from None
    try:
        # As one file: pyarrow takes names of folders like "run=3" for columns.
        with pyarrow.parquet.ParquetFile(path, buffer_size=1 << 16) as file:
            yield from _parquet_batches(path, file, options)
    except (OSError, pyarrow.ArrowException) as error:
        raise DataError(f"{path}: cannot be read as Parquet: {error}") from None


def _parquet_batches(
    path: Path, file: "pyarrow.parquet.ParquetFile", options: TableOptions
) -> Iterator[Batch]:
    import pyarrow

    schema = file.schema_arrow
    # pandas stores the numbers of its rows as columns of this name.
    header = [name for name in schema.names if not name.startswith("__index_level_")]
    instants = [k for k, name in enumerate(header) if pyarrow.types.is_timestamp(schema.field(name).type)]
    time_column = instants[0] if instants else _time_column(path, header, options)
    chosen = [header[k] for k in _chosen(path, header, options.columns, time_column)]
    time_name = None if time_column is None else header[time_column]
    n_rows = file.metadata.num_rows
    _check_lists(path, file)
    n_done, n_channels = 0, 0
    names = [*chosen, *([] if time_name is None else [time_name])]
    for batch in file.iter_batches(batch_size=_batch_rows(len(chosen)), columns=names):
        n = batch.num_rows
        parts = [_parquet_numbers(path, batch, name) for name in chosen]
        readings = np.concatenate(parts, axis=1) if parts else np.zeros((n, 0))
        if n_done and readings.shape[1] != n_channels:
            raise DataError(f"{path}: the lists in row {n_done + 1} have another length than those before")
        n_channels = readings.shape[1]
        if time_name is None:
            time_s = _no_times(n)
        elif instants:
            stamps = batch.column(time_name).cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
            time_s = stamps.to_numpy(zero_copy_only=False) * 1e-9 / SECONDS[options.time_unit or "s"]
        else:
            time_s = _parquet_numbers(path, batch, time_name)[:, 0]
        n_done += n
        yield time_s, readings, n_done / n_rows


def _check_lists(path: Path, file: "pyarrow.parquet.ParquetFile") -> None:
    """Refuse lists that claim too much: a list of any length has one row."""
    metadata = file.metadata
    columns = range(metadata.num_columns)
    for k in columns:
        if "." in metadata.schema.column(k).path:
            n_values = sum(
                metadata.row_group(group).column(k).num_values for group in range(metadata.num_row_groups)
            )
            if n_values * 8 > MOST_BYTES:
                raise DataError(
                    f"{path}: the lists of column {metadata.schema.column(k).path.split('.')[0]} have "
                    f"{n_values * 8 / 1e9:.1f} GB; at most {MOST_BYTES / 1e9:g} GB are read: split the file"
                )


def _parquet_numbers(path: Path, batch: "pyarrow.RecordBatch", name: str) -> FloatArray:
    """Return a column as numbers (n, 1), or a column of lists of equal length as (n, length)."""
    column = batch.column(name)
    try:
        if hasattr(column.type, "value_type"):
            return np.array(column.to_pylist(), dtype=np.float64).reshape(batch.num_rows, -1)
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)[:, None]
    except (TypeError, ValueError):
        raise DataError(
            f"{path}: column {name} holds {column.type}, not numbers or lists of one length; "
            "choose the channels with --columns"
        ) from None


def _time_column(path: Path, header: list[str], options: TableOptions) -> int | None:
    """Return the number of the column of times; None where the rate stands for it."""
    for name in _time_names(options.time_unit):
        if name in header:
            return header.index(name)
    if options.rate_hz is not None:
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
        comma = "; write decimals with a point" if "," in cell else ""
        raise DataError(f"{path}: line {line}: {cell!r} is not a number{comma}") from None


def _counts(header: Sequence[str]) -> bool:
    """Return True for the numbers of columns, from 0 or from 1, which programs write in place of names."""
    return any(list(header) == [str(first + k) for k in range(len(header))] for first in (0, 1))


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True

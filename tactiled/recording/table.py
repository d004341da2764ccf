"""Tables of others, CSV with a header or npz, read as a whole: at most `MOST_BYTES`."""

import csv
import fnmatch
import io
import logging
import math
import re
import tokenize
import zipfile
import zlib
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import IO, Literal, NamedTuple, TextIO

import numpy as np

from tactiled.array import FloatArray
from tactiled.errors import ConfigError, DataError
from tactiled.outside import need_regular, shown
from tactiled.pipeline import RATES_HZ
from tactiled.recording.spacing import spacing_of

logger = logging.getLogger(__name__)

TABLES = (".csv", ".tsv", ".txt", ".npz")
TimeUnit = Literal["s", "ms", "us", "ns"]
SECONDS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

# Of the readings as float64: 14 h of 36 channels at 100 Hz. `detect` takes 3.5 times as much memory, which a
# host of 8 GB has. An npz of 18 MB may claim more than twice as much.
MOST_BYTES = 1_500_000_000
# An array of 4096 taxels with four sides has them.
MOST_CHANNELS = 4 * 4096
_MOST_HEADER_BYTES = 10_000  # of an array in an npz: a hundred are enough, and numpy would read 4 GB
_MOST_LINE = 4 * 2**20  # characters of a CSV: 12,000 channels have 300,000
_READ_VALUES = 1 << 16  # of an npz at once: zlib holds twice what it is asked for

# A log slower than this more likely gives its times in milliseconds (10 kHz then reads as 10 Hz) or as row
# numbers than that it was recorded so slowly.
_SLOWEST_LIKELY_HZ = 10.0
_TIME_NAMES = "time", "timestamp", "stamp"
# How names spell the units of times.
_UNIT_WORDS: dict[str, TimeUnit] = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), "ns"),
}
# Stamps of ROS 2 and ROS 1, and of C: whole seconds, and the rest.
_SPLIT_STAMPS = {"sec": ("nanosec", "nsec"), "secs": ("nsecs", "nsec")}
_TIME_ADVICE = "times named time, t, timestamp or stamp need a unit, as in stamp_ms"
_OPTION_ADVICE = " or by --time-unit, and a log without times needs --rate"


@dataclass(frozen=True)
class TableOptions:
    """Options for reading a table that the file itself does not answer."""

    # Rate of the rows. Without it, a log slower than 10 Hz is refused: its times may not be in seconds
    rate_hz: float | None = None
    # Names of the columns of a CSV in channel order, ``*`` for several; all but the time if left out
    columns: Sequence[str] = ()
    # Unit of the times, where the name of their column or array does not say it
    time_unit: TimeUnit | None = None


class _Times(NamedTuple):
    """Columns or arrays with the times of a log: none where a rate stands for them, two of a split stamp."""

    used: tuple[str, ...]
    units: tuple[TimeUnit, ...]  # of the used ones
    unused: tuple[str, ...]  # that have times, too

    @property
    def name(self) -> str:
        """Name for errors."""
        return " and ".join(self.used) or "--rate"

    def seconds(self, stamps: Sequence[FloatArray]) -> FloatArray:
        """Return the times of the used columns, one at least, (n,) each."""
        time_s = np.zeros(len(stamps[0]))
        for unit, stamp in zip(self.units, stamps, strict=True):
            time_s += SECONDS[unit] * stamp
        return time_s


def read_table(path: Path, options: TableOptions | None = None) -> tuple[FloatArray, FloatArray]:
    """Read the times (n,) in seconds and the readings (n, channels) of a log, NaN where missing.

    Text (``.csv``, ``.tsv``, ``.txt``): a header, a column ``time_s`` (or ``stamp_ms``, ``Time [ms]`` and the
    like, or ``sec`` and ``nanosec``, or dates under a name of times), then one column per channel in channel
    order, with commas, semicolons or tabs between; an empty cell or ``nan`` is a missing reading, and a row
    without any reading a missing scan, which is left out. A column without a name is no channel where others
    have names. Without a column of times, the rate spaces the rows. Further columns of times are left out
    with a warning, unless `columns` names the channels.
    ``.npz``: ``time_s (n,)`` and ``volts (n, channels)``, or one array (n, ...) of another name; optional
    ``valid`` of the shape of ``volts`` is True for valid readings.

    Raises
    ------
    DataError
        The file is not a valid log (the message names the line or the array), or too large to be held.
    """
    options = options or TableOptions()
    times, time_s, readings = (_read_npz if path.suffix == ".npz" else _read_csv)(path, options)
    if times.unused and not options.columns:
        logger.warning(
            "%s: times are those of %s; left out: %s (--columns keeps it as a channel)",
            path,
            times.name,
            ", ".join(times.unused),
        )
    if time_s is None:
        assert options.rate_hz is not None  # which stands for the times
        time_s = np.arange(len(readings)) / options.rate_hz
    if not (is_number := np.isfinite(time_s)).all():
        raise DataError(f"{path}: {times.name} is not a number in row {int(np.argmin(is_number)) + 1}")
    if (backwards := np.flatnonzero(np.diff(time_s) <= 0)).size:
        at = int(backwards[0])
        raise DataError(
            f"{path}: {times.name} does not grow at row {at + 2} ({time_s[at]} s to {time_s[at + 1]} s); if "
            "rows are evenly spaced, leave out the times and give --rate"
        )
    is_reading = np.isfinite(readings)
    readings[~is_reading] = np.nan
    if not (is_scan := is_reading.any(axis=1)).all():
        time_s, readings = time_s[is_scan], readings[is_scan]
    if len(time_s) < 2:
        raise DataError(
            f"{path}: {len(time_s)} scans (rows with a reading); at least two are needed to compute the rate"
        )
    if fault := _rate_fault(spacing_of(time_s).period_s, times, options):
        raise DataError(f"{path}: {fault}")
    return time_s, readings


def _rate_fault(spacing_s: float, times: _Times, options: TableOptions) -> str:
    """Describe an implausible time spacing and its remedy; empty where the times are probably seconds."""
    slowest, fastest = RATES_HZ
    rate_hz = 1 / spacing_s
    given = times.units[0] if times.units else "s"
    rows = f"rows are {spacing_s:g} s apart by {times.name}, {rate_hz:g} Hz"
    if rate_hz > fastest:
        return f"{rows}, and no board is faster than {fastest:g} Hz; give it in seconds or say --time-unit"
    is_known = options.rate_hz is not None or options.time_unit is not None or given != "s"
    if rate_hz >= (slowest if is_known else _SLOWEST_LIKELY_HZ):
        return ""
    unit_hz = rate_hz * SECONDS[given]
    likely = [unit for unit in SECONDS if _SLOWEST_LIKELY_HZ <= unit_hz / SECONDS[unit] <= fastest]
    unit = next((unit for unit in likely if unit != given), "")
    other = f"if they are in {unit} say --time-unit {unit}, " if unit else ""
    slow = f"; if scans are so slow, give --rate {rate_hz:g}" if rate_hz >= slowest else ""
    taken = "seconds" if given == "s" else given
    return f"{rows}; times are taken in {taken}: {other}if they count rows divide by the rate{slow}"


def _check_size(path: Path, n_bytes: int) -> None:
    if n_bytes > MOST_BYTES:
        raise DataError(f"{path}: has more than {MOST_BYTES / 1e9:g} GB of readings; split it")


def _find_times(
    path: Path, names: Sequence[str], options: TableOptions, dates: Sequence[str] = ()
) -> _Times | None:
    """Find the times among the names of columns or arrays; None without times or a rate.

    A name without a unit has that of the options, or seconds where it is among the `dates`. `time_s` comes
    first, then a stamp that is split into seconds and nanoseconds, then the first name with a unit.

    Raises
    ------
    DataError
        All times have another unit than that of the options.
    """
    given = options.time_unit
    found = {name: unit for name in names if (unit := _unit_of(name)) is not None}
    found |= dict.fromkeys((name for name in found if name in dates), "s")

    def times(used: Sequence[str], units: Sequence[TimeUnit]) -> _Times:
        return _Times(tuple(used), tuple(units), tuple(name for name in found if name not in used))

    if "time_s" in found:
        return times(["time_s"], [given or "s"])
    if given is None and (pair := _split_stamp(list(found))):
        return times(pair, ["s", "ns"])
    for name, unit in found.items():
        if unit and given in (None, unit):
            return times([name], [unit])
        if given is not None and not unit:
            return times([name], [given])
    if given is not None and found:
        raise DataError(f"{path}: --time-unit {given}, but the times are in {', '.join(found)}: which is it?")
    return None if options.rate_hz is None else times([], [])


def _unit_of(name: str) -> TimeUnit | Literal[""] | None:
    """Return the unit of the times that a column or array has by its name, "" unknown; None for no times."""
    *stem, last = _words(name) or [""]
    if name == "t" or last in _TIME_NAMES:
        return ""
    # s alone may be anything, sec is a unit.
    is_time = len(last) > len("ms") if not stem else stem[-1] in _TIME_NAMES or stem == ["t"]
    return _UNIT_WORDS.get(last) if is_time else None


def _words(name: str) -> list[str]:
    """Return the words of a name: time, ms of ``Time [ms]``; header, stamp, sec of ``header.stamp.sec``."""
    return re.findall("[a-z0-9]+", re.sub("[\u00b5\u03bc]", "u", name.lower()))


def _split_stamp(names: Sequence[str]) -> tuple[str, str] | None:
    """Return the names of a stamp's seconds and nanoseconds; None for no such stamp."""
    by_words = {tuple(_words(name)): name for name in names}
    for words, name in by_words.items():
        for last in _SPLIT_STAMPS.get(words[-1], ()):
            if (rest := by_words.get((*words[:-1], last))) is not None:
                return name, rest
    return None


# ---- CSV -----------------------------------------------------------------------------------------


def _read_csv(path: Path, options: TableOptions) -> tuple[_Times, FloatArray | None, FloatArray]:
    with _opened(path) as table:
        header = table.header
        if header and all(map(_is_number, header)) and not _counts(header):
            raise DataError(
                f"{path}: the first line has numbers only; write a line of names above it, or in its "
                "place where it is the header"
            )
        times = _times_of_header(table, options)
        stamps = [header.index(name) for name in times.used]
        if options.columns:
            needed = _chosen(path, header, options.columns, stamps)
        else:
            left_out = {*stamps, *(k for k, name in enumerate(header) if name in times.unused)}
            needed = [k for k in range(len(header)) if k not in left_out]
            # pandas writes the numbers of the rows into a column without a name.
            needed = [k for k in needed if header[k]] or needed
        time_s, readings = table.read(times, stamps, needed)
        return times, time_s if stamps else None, readings


def read_named(path: Path, names: Sequence[str]) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Read the times (n,) and the columns of these names (n, names) of a CSV; also return its other names.

    Times are found as by `read_table`, at any rate. NaN stands for an empty cell, and for each cell of a
    column that the file lacks; one at least must be there. Times need not grow.

    Raises
    ------
    DataError
        The file is no such table; the message names the line.
    """
    with _opened(path) as table:
        header = table.header
        if not (there := [name for name in names if name in header]):
            raise DataError(
                f"{path}: the header needs at least one of {', '.join(names)}; it has "
                f"{', '.join(map(shown, header[:8])) or 'nothing'}"
            )
        times = _times_of_header(table, None)
        time_s, values = table.read(
            times, [header.index(name) for name in times.used], [header.index(name) for name in there]
        )
    columns = np.full((len(values), len(names)), np.nan)
    columns[:, [names.index(name) for name in there]] = values
    others = (name for name in header if name and name not in (*names, *times.used))
    return time_s, columns, tuple(others)


class _CsvTable:
    """Header of an open CSV, and its rows."""

    def __init__(self, path: Path, stream: TextIO) -> None:
        self.path = path
        first_line = stream.readline(_MOST_LINE)
        stream.seek(0)
        self._reader = csv.reader(_bounded_lines(path, stream), delimiter=max(",;\t", key=first_line.count))
        self.header = [name.strip() for name in next(self._reader, [])]
        while len(self.header) > 1 and not self.header[-1]:  # lines end with a separator
            self.header.pop()
        self._rows = filter(None, self._reader)
        self.first = next(self._rows, [])
        """First row; empty without one."""

    def read(
        self, times: _Times, stamps: Sequence[int], needed: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Read the times (n,), of these columns, and other columns (n, needed) of all rows."""
        used = {self.header[column] for column in (*stamps, *needed)}
        if twins := sorted(name for name in used if name and self.header.count(name) > 1):
            raise DataError(f"{self.path}: two columns have the same name: {', '.join(twins)}; rename one")
        numbers = array("d")  # it grows in place
        for cells in chain([self.first] if self.first else [], self._rows):
            where = f"{self.path}: line {self._reader.line_num}"
            if any(map(str.strip, cells[len(self.header) :])) or len(cells) < len(self.header):
                raise DataError(f"{where} has {len(cells)} cells, the header has {len(self.header)}")
            numbers.extend([_time(cells[column], where) for column in stamps])
            numbers.extend([_number(cells[column], where) for column in needed])
            _check_size(self.path, numbers.itemsize * len(numbers))
        table = np.frombuffer(numbers).reshape(-1, max(len(stamps) + len(needed), 1))
        time_s = times.seconds([table[:, k] for k in range(len(stamps))]) if stamps else np.empty(0)
        return time_s, table[:, len(stamps) :]


@contextmanager
def _opened(path: Path) -> Iterator[_CsvTable]:
    try:
        need_regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            yield _CsvTable(path, stream)
    except UnicodeDecodeError:
        raise DataError(f"{path}: no text in UTF-8; save it in this encoding") from None
    except (OSError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None


def _bounded_lines(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a file, none beyond the limit."""
    while line := stream.readline(_MOST_LINE):
        if len(line) == _MOST_LINE:
            raise DataError(f"{path}: a line has more than {_MOST_LINE} characters")
        yield line


def _times_of_header(table: _CsvTable, options: TableOptions | None) -> _Times:
    """Return the columns of times; `DataError` without any and without a rate."""
    header = table.header
    dates = [name for name, cell in zip(header, table.first, strict=False) if _date_s(cell) is not None]
    if (times := _find_times(table.path, header, options or TableOptions(), dates)) is not None:
        return times
    found = ", ".join(header[:6]) or "nothing"
    advice = _TIME_ADVICE + (_OPTION_ADVICE if options is not None else "")
    if len(header) == 1:
        advice = "the first line names the columns, with commas, semicolons or tabs between"
    raise DataError(f"{table.path}: the header lacks the column time_s (found: {found}); {advice}")


def _chosen(path: Path, header: list[str], columns: Sequence[str], stamps: Sequence[int]) -> list[int]:
    """Return the numbers of the columns that are named as channels, in channel order; none of `stamps`."""
    chosen: list[int] = []
    for pattern in columns:
        matching = [
            k for k, name in enumerate(header) if fnmatch.fnmatchcase(name, pattern) and k not in stamps
        ]
        if not matching:
            raise DataError(f"{path}: no column {pattern!r} of --columns; the header has {', '.join(header)}")
        chosen += [k for k in matching if k not in chosen]
    return chosen


def _number(cell: str, where: str) -> float:
    if not cell.strip():
        return float("nan")
    try:
        return float(cell.replace("_", "x"))  # Python allows _ between digits
    except ValueError:
        advice = "write decimals with a point" if "," in cell else "columns of text must be left out"
        raise DataError(f"{where}: {shown(cell)} is not a number; {advice}") from None


def _time(cell: str, where: str) -> float:
    """Return a number, or the seconds of a date."""
    date_s = _date_s(cell)
    return _number(cell, where) if date_s is None else date_s


def _date_s(cell: str) -> float | None:
    """Return the epoch seconds of a date and time (ISO 8601), in UTC by default; None for anything else."""
    if ":" not in cell:  # 20250327 would be a date, too
        return None
    try:
        date = datetime.fromisoformat(cell.strip())
    except ValueError:
        return None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _counts(header: Sequence[str]) -> bool:
    """Return True for the numbers of columns, from 0 or from 1, which programs write in place of names."""
    return any(list(header) == [str(first + k) for k in range(len(header))] for first in (0, 1))


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".").replace("_", "x"))
    except ValueError:
        return False
    return True


# ---- npz -----------------------------------------------------------------------------------------


def _read_npz(path: Path, options: TableOptions) -> tuple[_Times, FloatArray | None, FloatArray]:
    if options.columns:
        raise ConfigError("command line", ["--columns is for CSV; an npz file has the array volts"])
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise DataError(f"{path}: not a complete npz file; write one with numpy.savez")
            with zipfile.ZipFile(stream) as archive:
                return _from_archive(path, archive, options)
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


def _from_archive(
    path: Path, archive: zipfile.ZipFile, options: TableOptions
) -> tuple[_Times, FloatArray | None, FloatArray]:
    names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    times = _find_times(path, names, options)
    others = [name for name in names if _unit_of(name) is None and name != "valid"]
    name = "volts" if "volts" in names else others[0] if len(others) == 1 else None
    if times is None or name is None:
        missing = [*(["time_s"] if times is None else []), *(["volts"] if name is None else [])]
        raise DataError(
            f"{path}: lacks the array {' and '.join(missing)}; it has {names}; {_TIME_ADVICE}{_OPTION_ADVICE}"
        )
    readings = _read_array(path, archive, name)
    n_channels = math.prod(readings.shape[1:])
    if not 0 < n_channels <= MOST_CHANNELS:  # rows without a channel cost no bytes: there may be any number
        raise DataError(f"{path}: {name} has {n_channels} channels; 1 to {MOST_CHANNELS} are read")
    stamps = [_read_array(path, archive, used) for used in times.used]
    if readings.ndim < 2 or any(stamp.shape != readings.shape[:1] for stamp in stamps):
        shapes = " and ".join(f"{used} {stamp.shape}" for used, stamp in zip(times.used, stamps, strict=True))
        raise DataError(
            f"{path}: {shapes}{' and ' if shapes else ''}{name} {readings.shape} should be (n,) "
            "and (n, channels)"
        )
    if "valid" in names:  # written by `calibrate --guide`: invalid readings become NaN
        valid = _read_array(path, archive, "valid")
        if valid.shape != readings.shape:
            raise DataError(f"{path}: valid {valid.shape} should have the shape of {name} {readings.shape}")
        readings[valid == 0] = np.nan
    return times, times.seconds(stamps) if stamps else None, readings.reshape(-1, n_channels)


def _read_array(path: Path, archive: zipfile.ZipFile, name: str) -> FloatArray:
    """Read an array of numbers; refuse it by its header where it claims too much."""
    if archive.getinfo(f"{name}.npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise DataError(f"{path}: {name} is compressed as numpy compresses nothing; write it by numpy.savez")
    with archive.open(f"{name}.npy") as stream:
        shape, is_fortran, dtype = _npy_header(stream)
        if not np.can_cast(dtype, np.float64, "same_kind") or any(length < 0 for length in shape):
            raise DataError(f"{path}: time_s and volts must be arrays of numbers")
        _check_size(path, math.prod(shape) * max(8, dtype.itemsize))
        whole = np.empty(math.prod(shape))
        for at in range(0, whole.size, _READ_VALUES):
            part = whole[at : at + _READ_VALUES]
            data = stream.read(part.size * dtype.itemsize)
            if len(data) < part.size * dtype.itemsize:
                raise EOFError("an array ends before the shape that it claims")
            part[:] = np.frombuffer(data, dtype)
        if stream.read(1):  # at the end, zipfile compares the checksum
            raise zipfile.BadZipFile("an array has more bytes than the shape that it claims")
    return whole.reshape(shape, order="F" if is_fortran else "C")


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

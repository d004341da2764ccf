"""Tables as text: a line with the names of the columns, then rows of numbers; comments may stand above."""

import csv
import fnmatch
import logging
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

import numpy as np

from tactiled.array import FloatArray
from tactiled.errors import DataError
from tactiled.outside import need_regular, shown
from tactiled.recording.table_times import (
    OPTION_ADVICE,
    TIME_ADVICE,
    TableOptions,
    Times,
    check_size,
    find_times,
)

logger = logging.getLogger(__name__)

_MOST_LINE = 4 * 2**20  # characters: 12,000 channels have 300,000
_SEPARATORS = ",;\t"  # spaces where a table has none of these
_COMMENTS = "#", "%"


def read_csv(path: Path, options: TableOptions) -> tuple[Times, FloatArray | None, FloatArray]:
    """Read the times, None where a rate stands for them, and the readings (n, channels); see `read_table`."""
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
            # pandas writes the numbers of the rows into a column without a name.
            needed = [k for k, name in enumerate(header) if k not in left_out and name]
            if unnamed := [k + 1 for k, name in enumerate(header) if not name]:
                logger.warning("%s: columns without a name are left out: %s", path, unnamed)
        if not needed:
            raise DataError(f"{path}: the header names no channel beside {times.name}")
        time_s, readings = table.read(times, stamps, needed, "--columns chooses the channels")
        return times, time_s if stamps else None, readings


def read_named(
    path: Path, names: Sequence[str], options: TableOptions
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Read the times (n,) and the columns of these names (n, names) of a CSV; also return its other names.

    Times are found as by `read_table`, at any rate; they need not grow. NaN stands for an empty cell, and for
    each cell of a column that the file lacks; one at least must be there. A `DataError` names the line where
    the file is no such table.
    """
    with _opened(path) as table:
        header = table.header
        if not (there := [name for name in names if name in header]):
            raise DataError(
                f"{path}: the header needs at least one of {', '.join(names)}; it has "
                f"{', '.join(map(shown, header[:8])) or 'nothing'}"
            )
        times = _times_of_header(table, options, "")
        stamps = [header.index(name) for name in times.used]
        time_s, values = table.read(times, stamps, [header.index(name) for name in there], "")
    if not stamps:
        assert options.rate_hz is not None  # which stands for the times
        time_s = np.arange(len(values)) / options.rate_hz
    columns = np.full((len(values), len(names)), np.nan)
    columns[:, [names.index(name) for name in there]] = values
    columns[~np.isfinite(columns)] = np.nan
    others = (name for name in header if name and name not in (*names, *times.used))
    return time_s, columns, tuple(others)


class _CsvTable:
    """Header of an open CSV, and its rows, which may all end with a separator.

    Attributes
    ----------
    header : list of str
        Names of the columns; without those at the end that have none.
    first : list of str
        First row; empty without one.
    """

    def __init__(self, path: Path, stream: TextIO) -> None:
        self.path = path
        lines = _bounded_lines(path, stream)
        top, self._n_comments = _header_and_row(lines)
        separator = _separator(top)
        rows = chain(top, map(_without_comment, lines))
        self._reader = csv.reader(rows, delimiter=separator, skipinitialspace=separator == " ")
        self._rows = self._filled_rows()
        self.header = [name.strip() for name in next(self._rows, [])]
        self._n_cells = len(self.header)
        while len(self.header) > 1 and not self.header[-1]:
            self.header.pop()
        self.first = next(self._rows, [])
        if len(self.first) >= len(self.header) and not any(map(str.strip, self.first[len(self.header) :])):
            self._n_cells = len(self.first)  # header and rows may differ in whether they end with a separator

    def _filled_rows(self) -> Iterator[list[str]]:
        """Yield the rows but for empty lines; each stands in one line."""
        line = 0
        for cells in self._reader:
            if self._reader.line_num > line + 1:
                at = self._n_comments + line + 1
                raise DataError(f"{self.path}: line {at}: a quotation mark has no other one in this line")
            line = self._reader.line_num
            if cells:
                yield cells

    def read(
        self, times: Times, stamps: Sequence[int], needed: Sequence[int], advice: str
    ) -> tuple[FloatArray, FloatArray]:
        """Read the times (n,), of these columns, and other columns (n, needed) of all rows.

        Errors give the advice where a cell of these columns is no number.
        """
        used = {self.header[column] for column in (*stamps, *needed)}
        if twins := sorted(name for name in used if name and self.header.count(name) > 1):
            raise DataError(f"{self.path}: two columns have the same name: {', '.join(twins)}; rename one")
        numbers = array("d")  # it grows in place
        read_time = _date if times.are_dates else _number
        for cells in chain([self.first] if self.first else [], self._rows):
            if stamps and not any(map(str.strip, cells)):
                continue  # a missing scan where a rate spaces the rows, but nothing where times do
            where = f"{self.path}: line {self._n_comments + self._reader.line_num}"
            if len(cells) != self._n_cells:
                raise DataError(f"{where} has {len(cells)} cells, the header has {self._n_cells}")
            if any(map(str.strip, cells[len(self.header) :])):
                raise DataError(f"{where}: the last cell has no name in the header")
            numbers.extend([read_time(cells[column], where, advice) for column in stamps])
            numbers.extend([_number(cells[column], where, advice) for column in needed])
            check_size(self.path, numbers.itemsize * len(numbers))
        table = np.frombuffer(numbers).reshape(-1, max(len(stamps) + len(needed), 1))
        time_s = (
            times.seconds(self.path, [table[:, k] for k in range(len(stamps))]) if stamps else np.empty(0)
        )
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


def _header_and_row(lines: Iterator[str]) -> tuple[list[str], int]:
    """Return the header with the line after it, and the number of comments above.

    numpy and ROS write the names of the columns as a comment, the last one above the rows. Some cells of
    a row may be text; it then has as many cells as the comment, and begins with a number or date.
    """
    n_comments, comment, line = 0, "", next(lines, "")
    while line.startswith(_COMMENTS) or line.isspace():
        n_comments, comment, line = n_comments + 1, comment if line.isspace() else line, next(lines, "")
    names, separator = comment.lstrip("".join(_COMMENTS)), _separator([line])
    cells = line.split(separator)
    is_row = cells[0].strip() and _is_value(cells[0]) and len(cells) == len(names.split(separator))
    if comment and (is_row or all(map(_is_value, cells))):
        return [names, line], n_comments - 1
    return [line, *map(_without_comment, islice(lines, 1))], n_comments


def _without_comment(line: str) -> str:
    """Return a line, or an empty one in place of a comment, so that lines are counted right."""
    return "\n" if line.startswith(_COMMENTS) else line


def _separator(lines: Sequence[str]) -> str:
    """Return the separator that the first line has most of; a space where no line has any.

    A row of one number has no separator: its name may have spaces.
    """
    has_any = any(one in line for one in _SEPARATORS for line in lines)
    is_single = len(lines) > 1 and len(lines[1].split()) == 1
    return max(_SEPARATORS, key=lines[0].count) if has_any or is_single else " "


def _bounded_lines(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a file, none beyond the limit."""
    while line := stream.readline(_MOST_LINE):
        if len(line) == _MOST_LINE:
            raise DataError(f"{path}: a line has more than {_MOST_LINE} characters")
        yield line


def _times_of_header(table: _CsvTable, options: TableOptions, advice: str = OPTION_ADVICE) -> Times:
    """Return the columns of times; `DataError` without any and without a rate."""
    header = table.header
    dates = [name for name, cell in zip(header, table.first, strict=False) if _date_s(cell) is not None]
    if (times := find_times(table.path, header, options, dates)) is not None:
        return times
    if len(header) < 2:
        advice = "the first line names the columns, with commas, semicolons, tabs or spaces between"
    else:
        advice = f"{TIME_ADVICE}{advice}; dates are read as 2026-11-29 08:15:00.123"
    found = ", ".join(header[:6]) or "nothing"
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


def _number(cell: str, where: str, advice: str) -> float:
    if not cell.strip():
        return float("nan")
    try:
        return float(cell.replace("_", "x"))  # Python allows _ between digits
    except ValueError:
        advice = "write decimals with a point" if "," in cell else advice
        fault = f"{where}: {shown(cell)} is not a number"
        raise DataError(f"{fault}; {advice}" if advice else fault) from None


def _date(cell: str, where: str, advice: str) -> float:
    """Return the seconds of a date, or else a number."""
    date_s = _date_s(cell)
    return _number(cell, where, advice) if date_s is None else date_s


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


def _is_value(cell: str) -> bool:
    return not cell.strip() or _is_number(cell) or _date_s(cell) is not None


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".").replace("_", "x"))
    except ValueError:
        return False
    return True

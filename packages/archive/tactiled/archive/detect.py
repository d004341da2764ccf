"""``tactiled detect 'runs/**/*.mcap' --to events.parquet``: many files, on the cores of this host."""

import contextlib
import dataclasses
import glob
import io
import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, get_args, get_origin

import pyarrow
import pyarrow.parquet

from tactiled.errors import DataError, OperatorError
from tactiled.events.codec import message_key
from tactiled.events.types import EVENT_TYPES
from tactiled.jobs import executor
from tactiled.offline import OFFLINE_TOPICS, Choices, detect_messages
from tactiled.progress import ProgressBar

# Events that are rows of Python before they are compressed: some 20 MB, 17 minutes of grip at 10 Hz.
_GROUP_EVENTS = 10_000
# Jobs for each process that run or wait for their turn in the table: their rows are in memory.
_JOBS_AHEAD = 2
# Value of `topic` in the row that stands for a whole file.
FILE_TOPIC = "file"
_PLAIN = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
_FILE_COLUMNS = [
    pyarrow.field("file", pyarrow.string(), nullable=False),
    pyarrow.field("topic", pyarrow.string(), nullable=False),
    pyarrow.field("board", pyarrow.string()),
    pyarrow.field("error", pyarrow.string()),
    pyarrow.field("summary", pyarrow.string()),
    pyarrow.field("seq", pyarrow.int64()),
    pyarrow.field("timestamp", pyarrow.float64()),
]


@dataclass(frozen=True)
class Outcome:
    """Result of a run over many files."""

    n_files: int
    n_events: int
    failed: tuple[tuple[str, str], ...]  # files that could not be analysed, and why

    def words(self, to: Path) -> str:
        """Describe the outcome in a line."""
        failed = f"; {len(self.failed)} files could not be analysed" if self.failed else ""
        return f"{to}: {self.n_events} events of {self.n_files} files{failed}"


def matching(patterns: Sequence[str]) -> list[str]:
    """Return the files of names and patterns (``*``, ``**``), sorted, each once, however it is spelled.

    `DataError` where a name or a pattern has no file.
    """
    found: dict[Path, str] = {}
    for pattern in patterns:
        names = [pattern] if Path(pattern).exists() else glob.glob(pattern, recursive=True)  # noqa: PTH207
        if not names:
            raise DataError(f"{pattern}: no such file, and no file matches")
        for name in sorted(names):
            found.setdefault(Path(name).resolve(), name)
    return sorted(found.values())


def analyse(file: str, array: str | None, rate_hz: float | None, choices: Choices) -> bytes:
    """Return the rows of one file as Parquet: events in groups, then the row of the file as the last group.

    A file that cannot be analysed is one row with its error.
    """
    try:
        if not Path(file).exists():
            return _failed(file, "no such file any more")
        return _analysed_events(file, array, rate_hz, choices)
    except OperatorError as error:
        return _failed(file, str(error))
    except OSError as error:
        return _failed(file, f"cannot be read: {error.strerror or error}")
    except MemoryError:
        return _failed(file, "its process has too little memory")
    except Exception as error:
        return _failed(file, f"bug: {type(error).__name__}: {error}")


def _analysed_events(file: str, array: str | None, rate_hz: float | None, choices: Choices) -> bytes:
    """Analyse a file, and compress its events as they come."""
    sink = io.BytesIO()
    log, messages = detect_messages(Path(file), array, rate_hz, choices)
    with pyarrow.parquet.ParquetWriter(sink, schema()) as writer:
        while group := list(itertools.islice(messages, _GROUP_EVENTS)):
            writer.write_table(event_rows(file, group))
        writer.write_table(file_row(file, "\n".join(choices.summary(log))))
    return sink.getvalue()


def detect_patterns(
    patterns: Sequence[str],
    to: Path,
    array: str | None,
    rate_hz: float | None,
    choices: Choices,
    n_workers: int | None,
) -> Outcome:
    """Analyse the files of names and patterns, as ``tactiled detect --to`` does, and write one table.

    It has its name once it is whole. `OperatorError` where it cannot be written, or a process ended; others
    as for `matching`.
    """
    choices.params()  # a fault of these is no fault of a file
    files = matching(patterns)
    rows_of = partial(analyse, array=array, rate_hz=rate_hz, choices=choices)
    n_ahead = _JOBS_AHEAD * (n_workers or os.cpu_count() or 1)
    n_done, n_events, failed = 0, 0, []
    try:
        with (
            _whole_file(to) as sink,
            pyarrow.parquet.ParquetWriter(sink, schema()) as writer,
            ProgressBar(f"detect {len(files)} files", len(files)) as progress,
            executor(n_workers) as workers,
        ):
            for file, rows in zip(files, in_order(workers, rows_of, files, n_ahead), strict=True):
                n_rows, error = _append(writer, rows)
                n_events += n_rows
                if error:
                    failed.append((file, error))
                n_done += 1
                progress.advance(file)
    except BrokenProcessPool:
        raise OperatorError(
            f"{files[n_done]}, or one after it: its process ended, out of memory? Fewer --jobs need less"
        ) from None
    except OSError as error:
        raise OperatorError(f"{to}: cannot be written: {error.strerror}") from None
    return Outcome(len(files), n_events, tuple(failed))


def in_order(
    workers: Executor, rows_of: Callable[[str], bytes], files: Iterable[str], n_ahead: int
) -> Iterator[bytes]:
    """Yield the rows of the files in their order; at most `n_ahead` files are begun ahead of it."""
    begun: deque[Future[bytes]] = deque()
    for file in files:
        begun.append(workers.submit(rows_of, file))
        if len(begun) == n_ahead:
            yield begun.popleft().result()
    while begun:
        yield begun.popleft().result()


@contextlib.contextmanager
def _whole_file(to: Path) -> Iterator[BinaryIO]:
    """Open a file that has its name once the block is done; an error leaves none.

    `OperatorError` where another run writes the file.
    """
    unfinished = to.with_name(f"{to.name}.unfinished")
    try:
        sink = unfinished.open("xb")
    except FileExistsError:
        raise OperatorError(
            f"{to}: another run writes it, as {unfinished} exists; if a killed run left that file, remove it"
        ) from None
    try:
        with sink:
            yield sink
        unfinished.replace(to)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def _append(writer: pyarrow.parquet.ParquetWriter, rows: bytes) -> tuple[int, str]:
    """Append the rows of a file to the table, that of the file first; return its events and its error."""
    with pyarrow.parquet.ParquetFile(io.BytesIO(rows)) as file:
        *groups, last = range(file.num_row_groups)
        head = file.read_row_group(last)
        writer.write_table(head)
        for group in groups:
            writer.write_table(file.read_row_group(group))
        return file.metadata.num_rows - 1, str(head["error"][0].as_py())


def schema() -> pyarrow.Schema:
    """Make the columns: those of every row, then the fields of all detected events.

    A field that two kinds of event have is one column. A column is null in rows of events without the field.
    """
    columns = {column.name: column for column in _FILE_COLUMNS}
    for topic in OFFLINE_TOPICS:
        kind = EVENT_TYPES[topic]
        for field in dataclasses.fields(kind):
            key = message_key(field.name)
            columns.setdefault(key, pyarrow.field(key, _arrow_type(field.type)))
    return pyarrow.schema(list(columns.values()))


def _arrow_type(kind: Any) -> pyarrow.DataType:
    if dataclasses.is_dataclass(kind):
        return pyarrow.struct([(part.name, _arrow_type(part.type)) for part in dataclasses.fields(kind)])
    if get_origin(kind) is tuple:
        return pyarrow.list_(_arrow_type(get_args(kind)[0]))
    return _PLAIN.get(kind, pyarrow.string())  # else a Literal of strings


def file_row(file: str, summary: str, error: str = "") -> pyarrow.Table:
    """Make the row of a file itself, with lines for people, and why it could not be analysed (else empty)."""
    return _to_table([{"file": file, "topic": FILE_TOPIC, "error": error, "summary": summary}])


def event_rows(file: str, messages: Iterable[Mapping[str, Any]]) -> pyarrow.Table:
    """Make a row for each message with `topic`, as `detect` prints it."""
    return _to_table([{**message, "file": file} for message in messages])


def _to_table(rows: Iterable[Mapping[str, Any]]) -> pyarrow.Table:
    known = schema()
    return pyarrow.Table.from_pylist(
        [{name: _as_unicode(row.get(name)) for name in known.names} for row in rows], known
    )


def _as_unicode(value: Any) -> Any:
    """Write bytes of a file name that are not UTF-8 as escapes; leave all else as it is."""
    if not isinstance(value, str):
        return value
    return value.encode(errors="surrogateescape").decode(errors="backslashreplace")


def _failed(file: str, error: str) -> bytes:
    """Return the only row of a file that could not be analysed."""
    sink = io.BytesIO()
    pyarrow.parquet.write_table(file_row(file, "", error), sink)
    return sink.getvalue()

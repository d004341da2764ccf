"""``tactiled detect 'runs/**/*.mcap' --to events.parquet``: many files, on many workers, resumable."""

import contextlib
import dataclasses
import fcntl
import glob
import hashlib
import io
import itertools
import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any, get_args, get_origin

import pyarrow
import pyarrow.parquet

from tactiled import resources, tomltext
from tactiled.errors import DataError, OperatorError
from tactiled.events.codec import message_key
from tactiled.events.types import EVENT_TYPES
from tactiled.jobs import executor
from tactiled.offline import OFFLINE_TOPICS, Choices, array_of_config, detect_messages
from tactiled.progress import ProgressBar
from tactiled.version import __version__

# Rows of a finished file, in the folder of parts; whatever else lies there is left alone.
_PART = ".part"
# Submitted to Dask at a time: more than the threads of any cluster, few enough to describe at once.
_MOST_ON_DASK = 10_000
# Events that are rows of Python before they are compressed: some 20 MB, 17 minutes of grip at 10 Hz.
_GROUP_EVENTS = 10_000
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
class FileJob:
    """Analysis of one file, in a form that any worker can do: with absolute paths (`for_any_worker`)."""

    file: str  # name in the table
    path: Path
    array: str | None
    rate_hz: float | None
    choices: Choices
    version: str = __version__  # of the tactiled that asks

    @classmethod
    def for_any_worker(
        cls, file: str, array: str | None, rate_hz: float | None, choices: Choices
    ) -> "FileJob":
        """Make the job of a file with absolute paths, because a worker may have another working directory."""
        absolute = replace(
            choices,
            config=choices.config and choices.config.absolute(),
            calibration=_absolute(choices.calibration),
            layout=_absolute(choices.layout),
        )
        return cls(file, Path(file).absolute(), _absolute(array), rate_hz, absolute)

    def key(self) -> str:
        """Digest of all that decides the result; the file itself by its size and time of change."""
        choices = self.choices
        parts: list[object] = [self.version, self.file, self.rate_hz, self.array]
        # A bag is a folder of files.
        for path in (self.path, *sorted(self.path.rglob("*"))) if self.path.is_dir() else (self.path,):
            with contextlib.suppress(OSError):  # it may be gone: then the row says so
                status = path.stat()
                parts += [str(path), status.st_size, status.st_mtime_ns]
        parts += [getattr(choices, field.name) for field in dataclasses.fields(choices)]
        array = self.array or array_of_config(choices.config)
        named = (
            (array, "config/arrays"),
            (choices.calibration, "config/calibration"),
            (choices.layout, "protocols"),
        )
        files = [choices.config, *(name and tomltext.locate(name, kind) for name, kind in named)]
        parts += [file.read_bytes() if file and file.is_file() else b"" for file in files]
        return hashlib.sha256(repr(parts).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """Result of a run over many files."""

    n_files: int  # in the table
    n_resumed: int  # those of them whose rows an earlier run had left
    n_events: int
    failed: tuple[tuple[str, str], ...]  # files that could not be analysed, and why

    def words(self, to: Path) -> str:
        """Describe the outcome in a line."""
        resumed = f", {self.n_resumed} of them analysed earlier" if self.n_resumed else ""
        failed = f"; {len(self.failed)} files could not be analysed" if self.failed else ""
        return f"{to}: {self.n_events} events of {self.n_files} files{resumed}{failed}"


def matching(patterns: Sequence[str]) -> list[str]:
    """Return the files of names and patterns (``*``, ``**``), sorted, each once.

    Raises
    ------
    DataError
        A name or a pattern has no file.
    """
    found: set[str] = set()
    for pattern in patterns:
        names = [pattern] if Path(pattern).exists() else glob.glob(pattern, recursive=True)  # noqa: PTH207
        if not names:
            raise DataError(f"{pattern}: no such file, and no file matches")
        found.update(names)
    return sorted(found)


def analyse(job: FileJob) -> bytes:
    """Return the rows of one file as Parquet: events in groups, then the row of the file as the last group.

    A file that cannot be analysed is one row with its error.
    """
    if job.version != __version__:
        raise OperatorError(f"a worker has tactiled {__version__}, not {job.version}: install the same")
    if not job.path.exists():
        return _failed(job.file, "no such file any more")
    try:
        return _analysed_events(job)
    except OperatorError as error:
        return _failed(job.file, str(error).replace(str(job.path), job.file))
    except MemoryError:
        return _failed(job.file, "its process has too little memory")
    except Exception as error:
        return _failed(job.file, f"bug: {type(error).__name__}: {error}")


def _analysed_events(job: FileJob) -> bytes:
    """Analyse a file, and compress its events as they come."""
    sink = io.BytesIO()
    log, messages = detect_messages(job.path, job.array, job.rate_hz, job.choices)
    with pyarrow.parquet.ParquetWriter(sink, schema()) as writer:
        while group := list(itertools.islice(messages, _GROUP_EVENTS)):
            writer.write_table(event_rows(job.file, group))
        writer.write_table(file_row(job.file, "\n".join(log.summary(job.choices))))
    return sink.getvalue()


def detect_files(jobs: Sequence[FileJob], to: Path, n_workers: int | None, dask: str | None) -> Outcome:
    """Analyse files and write one table, in the order of `jobs`.

    The rows of each finished file are kept in the folder ``TO.parts`` until the table is whole; a run with
    the same choices goes on from there. A file that ends its worker is tried once more alone, and is then a
    row with an error.

    Raises
    ------
    OperatorError
        The table cannot be written, no scheduler answers, or a worker has another version of tactiled.
    """
    if jobs:
        jobs[0].choices.params()  # a fault of these is no fault of a file
    parts = to.with_name(f"{to.name}.parts")
    try:
        keys = [job.key() for job in jobs]
        with alone_in(parts):
            missing = [k for k, key in enumerate(keys) if not _is_whole(parts / f"{key}{_PART}")]
            with ProgressBar(f"detect {len(jobs)} files", len(jobs)) as progress:
                progress.advance("", len(jobs) - len(missing))
                for index, rows in _analysed([(k, jobs[k]) for k in missing], n_workers, dask):
                    _write_whole(parts / f"{keys[index]}{_PART}", rows)
                    progress.advance(jobs[index].file)
            outcome = _merge(
                [(job.file, parts / f"{key}{_PART}") for job, key in zip(jobs, keys, strict=True)], to
            )
            for part in (*parts.glob(f"*{_PART}"), *parts.glob(f"*{_PART}.unfinished")):
                part.unlink()
    except OSError as error:
        raise OperatorError(f"{error.filename or to}: cannot be written: {error.strerror}") from None
    return Outcome(len(jobs), len(jobs) - len(missing), outcome[0], outcome[1])


def detect_patterns(
    patterns: Sequence[str],
    to: Path,
    array: str | None,
    rate_hz: float | None,
    choices: Choices,
    n_workers: int | None,
    dask: str | None,
) -> Outcome:
    """Analyse the files of names and patterns, as ``tactiled detect --to`` does; errors as for its parts."""
    jobs = [FileJob.for_any_worker(name, array, rate_hz, choices) for name in matching(patterns)]
    return detect_files(jobs, to, n_workers, dask)


@contextlib.contextmanager
def alone_in(parts: Path) -> Iterator[None]:
    """Make the folder of parts, keep other runs out of it, and remove it if it is empty at the end."""
    parts.mkdir(exist_ok=True)
    lock = parts / "lock"
    try:
        with lock.open("w") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OperatorError(f"{parts}: another run is writing this table; wait for its end") from None
            try:
                yield
            finally:
                lock.unlink()
    finally:
        with contextlib.suppress(OSError):  # it keeps parts of an unfinished run, or files of others
            parts.rmdir()


def _analysed(
    jobs: Sequence[tuple[int, FileJob]], n_workers: int | None, dask: str | None
) -> Iterator[tuple[int, bytes]]:
    """Yield the rows of each file as it is finished."""
    waiting = deque(jobs)
    # A process that ends breaks its pool, which does not say with which file: few are given to it at a time.
    most = _MOST_ON_DASK if dask else 1 + (n_workers or os.cpu_count() or 1)
    while waiting:
        suspects = []
        with executor(n_workers, dask) as workers:
            for index, job, rows in completed(workers, waiting, most):
                if rows is None:
                    suspects.append((index, job))
                else:
                    yield index, rows
        for index, job in suspects:
            with executor(1) as worker:
                ((_, _, rows),) = completed(worker, deque([(index, job)]), 1)
            yield index, rows or _failed(job.file, "its process ended: out of memory?")


def completed(
    workers: Executor, waiting: deque[tuple[int, FileJob]], most: int
) -> Iterator[tuple[int, FileJob, bytes | None]]:
    """Yield jobs with their rows; None where the process of the job ended.

    Jobs are taken from `waiting`, at most `most` at a time, and no more after a pool of processes broke.
    """
    at_work: dict[Future[bytes], tuple[int, FileJob]] = {}
    done: SimpleQueue[Future[bytes]] = SimpleQueue()
    is_broken = False
    while at_work or (waiting and not is_broken):
        while waiting and not is_broken and len(at_work) < most:
            try:
                future = workers.submit(analyse, waiting[0][1])
            except BrokenProcessPool:
                is_broken = True
                continue
            at_work[future] = waiting.popleft()
            future.add_done_callback(done.put)
        if not at_work:
            return
        future = done.get()
        index, job = at_work.pop(future)
        try:
            yield index, job, future.result()
        except BrokenProcessPool:
            is_broken = True
            yield index, job, None
        except OperatorError:
            raise
        except Exception as error:
            # `analyse` has rows for whatever happens to a file: this is a fault of the cluster.
            if type(error).__name__ != "KilledWorker":  # of Dask, which has tried several workers
                reason = f"{type(error).__name__}: {error}".rstrip(": ")
                raise OperatorError(
                    f"the workers failed ({reason}); the same command goes on with the files that are left"
                ) from None
            yield index, job, None


def _merge(parts: Sequence[tuple[str, Path]], to: Path) -> tuple[int, tuple[tuple[str, str], ...]]:
    """Join the rows of all files in one table; return the number of events and the files that failed."""
    n_events = 0
    failed = []
    unfinished = to.with_name(f"{to.name}.unfinished")
    with pyarrow.parquet.ParquetWriter(unfinished, schema()) as writer:
        for file, part in parts:
            with pyarrow.parquet.ParquetFile(part) as rows:
                *groups, last = range(rows.num_row_groups)
                head = rows.read_row_group(last)
                if error := head["error"][0].as_py():
                    failed.append((file, error))
                writer.write_table(head)
                for group in groups:
                    writer.write_table(rows.read_row_group(group))
                n_events += rows.metadata.num_rows - 1
    unfinished.replace(to)
    return n_events, tuple(failed)


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


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file that is never seen in part, whenever the program is stopped."""
    unfinished = path.with_name(f"{path.name}.unfinished")
    unfinished.write_bytes(data)
    unfinished.replace(path)


def _is_whole(part: Path) -> bool:
    """Return whether the rows of a file are there; a power failure may leave a file without its contents."""
    try:
        pyarrow.parquet.read_metadata(part)
    except (OSError, pyarrow.ArrowInvalid):
        return False
    return True


def _absolute(name_or_path: str | None) -> str | None:
    """Make a path absolute; the name of a shipped file means that of the worker."""
    if name_or_path is None or resources.is_name(name_or_path):
        return name_or_path
    return str(Path(name_or_path).absolute())

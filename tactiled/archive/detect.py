"""``tactiled detect 'runs/**/*.mcap' --to events.parquet``: many files, on many workers, resumable."""

import glob
import hashlib
import io
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from pathlib import Path

import pyarrow
import pyarrow.parquet

from tactiled import __version__, tomltext
from tactiled.archive.columns import schema, to_table
from tactiled.errors import DataError, OperatorError
from tactiled.jobs import executor
from tactiled.offline import Choices, detect_messages
from tactiled.progress import ProgressBar


@dataclass(frozen=True)
class FileJob:
    """Analysis of one file, in a form that any worker can do.

    Attributes
    ----------
    file : str
        Name in the table.
    path : Path
        Absolute, because a worker may have another working directory.
    array : str, optional
    rate_hz : float, optional
    choices : Choices
    version : str
        Of the tactiled that asks.
    """

    file: str
    path: Path
    array: str | None
    rate_hz: float | None
    choices: Choices
    version: str = __version__

    def key(self) -> str:
        """Digest of all that decides the result; the file itself by its size and time of change."""
        status = self.path.stat()
        parts = [self.version, self.file, status.st_size, status.st_mtime_ns, self.rate_hz]
        parts += [getattr(self.choices, field.name) for field in fields(self.choices)]
        parts += [_contents(self.choices.config), _contents(_named(self.array, "config/arrays"))]
        parts += [_contents(_named(self.choices.calibration, "config/calibration"))]
        return hashlib.sha256(repr(parts).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """Result of a run over many files.

    Attributes
    ----------
    n_files, n_resumed, n_events : int
        Files in the table, those of them whose rows an earlier run had left, and events.
    failed : tuple of (str, str)
        Files that could not be analysed, and why.
    """

    n_files: int
    n_resumed: int
    n_events: int
    failed: tuple[tuple[str, str], ...]

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
    """Return the rows of one file as Parquet; a file that cannot be analysed is one row with its error."""
    if job.version != __version__:
        raise OperatorError(f"a worker has tactiled {__version__}, not {job.version}: install the same")
    try:
        log, messages = detect_messages(job.path, job.array, job.rate_hz, job.choices)
        found = list(messages)
        table = to_table(job.file, found, "\n".join(log.summary(job.choices)))
    except OperatorError as error:
        table = to_table(job.file, [], "", str(error).replace(str(job.path), job.file))
    return _to_bytes(table)


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
        parts.mkdir(exist_ok=True)
        keys = [job.key() for job in jobs]
        missing = [k for k, key in enumerate(keys) if not (parts / key).exists()]
        with ProgressBar(f"detect {len(jobs)} files", len(jobs)) as progress:
            progress.advance("", len(jobs) - len(missing))
            for index, rows in _analysed([(k, jobs[k]) for k in missing], n_workers, dask):
                _write_whole(parts / keys[index], rows)
                progress.advance(jobs[index].file)
        outcome = _merge([(job.file, parts / key) for job, key in zip(jobs, keys, strict=True)], to)
        for part in parts.iterdir():
            part.unlink()
        parts.rmdir()
    except OSError as error:
        raise OperatorError(f"{error.filename or to}: cannot be written: {error.strerror}") from None
    return Outcome(len(jobs), len(jobs) - len(missing), outcome[0], outcome[1])


def _analysed(
    jobs: Sequence[tuple[int, FileJob]], n_workers: int | None, dask: str | None
) -> Iterator[tuple[int, bytes]]:
    """Yield the rows of each file as it is finished."""
    if not jobs:
        return
    suspects = []  # at work, or waiting, when a process ended
    with executor(n_workers, dask) as workers:
        for index, job, rows in _completed(workers, jobs):
            if rows is None:
                suspects.append((index, job))
            else:
                yield index, rows
    for index, job in suspects:
        with executor(1) as worker:
            ((_, _, rows),) = _completed(worker, [(index, job)])
        yield index, rows or _to_bytes(to_table(job.file, [], "", "its process ended: out of memory?"))


def _completed(
    workers: Executor, jobs: Sequence[tuple[int, FileJob]]
) -> Iterator[tuple[int, FileJob, bytes | None]]:
    """Yield jobs with their rows; None where the process of the job ended."""
    futures: dict[Future[bytes], tuple[int, FileJob]] = {
        workers.submit(analyse, job): (k, job) for k, job in jobs
    }
    for future in as_completed(futures):
        index, job = futures.pop(future)
        try:
            rows = future.result()
        except Exception as error:
            if isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker":  # of Dask
                yield index, job, None
                continue
            if isinstance(error, OperatorError):
                raise
            rows = _to_bytes(to_table(job.file, [], "", f"bug: {type(error).__name__}: {error}"))
        yield index, job, rows


def _merge(parts: Sequence[tuple[str, Path]], to: Path) -> tuple[int, tuple[tuple[str, str], ...]]:
    """Join the rows of all files in one table; return the number of events and the files that failed."""
    n_events = 0
    failed = []
    unfinished = to.with_name(f"{to.name}.unfinished")
    with pyarrow.parquet.ParquetWriter(unfinished, schema()) as writer:
        for file, part in parts:
            table = pyarrow.parquet.read_table(part)
            n_events += len(table) - 1
            if error := table["error"][0].as_py():
                failed.append((file, error))
            writer.write_table(table)
    unfinished.replace(to)
    return n_events, tuple(failed)


def _to_bytes(table: pyarrow.Table) -> bytes:
    sink = io.BytesIO()
    pyarrow.parquet.write_table(table, sink)
    return sink.getvalue()


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file that is never seen in part, whenever the program is stopped."""
    unfinished = path.with_name(f"{path.name}.unfinished")
    unfinished.write_bytes(data)
    unfinished.replace(path)


def _contents(path: Path | None) -> bytes:
    return b"" if path is None else path.read_bytes()


def _named(name_or_path: str | None, kind: str) -> Path | None:
    return None if name_or_path is None else tomltext.locate(name_or_path, kind)

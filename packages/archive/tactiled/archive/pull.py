"""``tactiled archive pull URL --to DIRECTORY``: recordings of a store, checked while they are fetched."""

import fnmatch
import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from fsspec import AbstractFileSystem

from tactiled.archive.push import Copy
from tactiled.archive.store import BLOCK_BYTES, StoredRecording, is_regular, reason_of
from tactiled.errors import DataError
from tactiled.outside import path_below
from tactiled.recording.rotation import free_mb

_MB = 1e6


def chosen(recordings: Sequence[StoredRecording], patterns: Sequence[str]) -> list[StoredRecording]:
    """Return the recordings whose names match a pattern (``*``); all without patterns.

    Raises
    ------
    DataError
        A pattern matches no recording.
    """
    for pattern in patterns:
        if not any(fnmatch.fnmatchcase(recording.name, pattern) for recording in recordings):
            raise DataError(f"{pattern}: no recording of this name; `tactiled archive list` prints the names")
    return [
        recording
        for recording in recordings
        if not patterns or any(fnmatch.fnmatchcase(recording.name, pattern) for pattern in patterns)
    ]


def pull(
    store: AbstractFileSystem,
    recordings: Sequence[StoredRecording],
    directory: Path,
    reached: Callable[[str, float], None] = lambda _name, _bytes: None,
) -> Iterator[Copy]:
    """Fetch recordings of a store, and yield the outcome of each.

    A recording gets its name here once its SHA-256 is the confirmed one. What is here is never replaced.

    Parameters
    ----------
    directory : Path
        Recordings keep their path below the folder of the store.
    reached : callable
        Called with the name of each recording that is done, and its size in bytes.
    """
    for recording in recordings:
        path = directory / "?"
        try:
            path = path_below(directory, recording.name)
            yield Copy(path, "copied" if _fetch(store, recording, path) else "there already")
        except DataError as error:
            yield Copy(path, "failed", str(error))
        except Exception as error:  # each kind of store has exceptions of its own
            yield Copy(path, "failed", reason_of(error))
        reached(path.name, recording.n_bytes)


def _fetch(store: AbstractFileSystem, recording: StoredRecording, path: Path) -> bool:
    """Fetch one recording; False where it is here already."""
    if not recording.sha256:
        raise DataError(f"{recording.remote} has no complete .sha256 beside it: push it again")
    if path.exists():
        with path.open("rb") as stream:
            if hashlib.file_digest(stream, "sha256").hexdigest() == recording.sha256:
                return False
        raise DataError(f"{path} exists with other content; move it away or name another directory")
    if not is_regular(store, recording.remote):
        raise DataError(f"{recording.remote} is not a regular file")
    path.parent.mkdir(parents=True, exist_ok=True)
    room_mb = free_mb(path.parent)
    if recording.n_bytes / _MB > room_mb:
        raise DataError(
            f"{recording.remote} has {recording.n_bytes / _MB:.0f} MB, and {path.parent} has room for "
            f"{room_mb:.0f} MB"
        )
    unfinished = path.with_name(f"{path.name}.unfinished")
    try:
        found = _download(store, recording, unfinished)
        if found != recording.sha256:
            raise DataError(f"{recording.remote} was read with SHA-256 {found}, not {recording.sha256}")
        unfinished.rename(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return True


def _download(store: AbstractFileSystem, recording: StoredRecording, to: Path) -> str:
    """Write a stored file to disk, at most the size that the store states, and return its SHA-256."""
    found = hashlib.sha256()
    n_bytes = 0
    with (
        store.open(recording.remote, "rb", block_size=BLOCK_BYTES, cache_type="none") as stream,
        to.open("wb") as target,
    ):
        while block := stream.read(BLOCK_BYTES):
            n_bytes += len(block)
            if n_bytes > recording.n_bytes:
                raise DataError(f"{recording.remote} is longer than the {recording.n_bytes} bytes stated")
            found.update(block)
            target.write(block)
        target.flush()
        os.fsync(target.fileno())
    return found.hexdigest()

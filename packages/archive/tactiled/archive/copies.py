"""``tactiled archive push`` and ``pull``: recordings into a store and back, confirmed by their SHA-256."""

import fnmatch
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fsspec import AbstractFileSystem
from fsspec.implementations.local import LocalFileSystem

from tactiled.archive.store import (
    BLOCK_BYTES,
    SIDECAR,
    StoredRecording,
    confirmed_digest,
    digest_of,
    is_regular,
    reason_of,
)
from tactiled.errors import DataError
from tactiled.outside import path_below
from tactiled.recording.rotation import free_mb

_MB = 1e6
State = Literal["copied", "there already", "repaired", "failed"]


@dataclass(frozen=True)
class Copy:
    """Outcome for one recording."""

    path: Path
    n_bytes: int
    # All but "failed" are confirmed: the store had these bytes when they were read. "there already" was read
    # back by a push only where the recording is to be removed here; "repaired": a damaged copy was made anew.
    state: State
    reason: str = ""  # why it failed; else empty


def recordings(directory: Path) -> list[Path]:
    """List the finished recordings in a directory and in those below it, sorted.

    Raises
    ------
    DataError
        It is no directory.
    """
    if not directory.is_dir():
        raise DataError(f"{directory}: no such directory")
    # One that is being written ends in .mcap.active.
    return sorted(path for path in directory.rglob("*.mcap") if path.is_file())


def size_of(path: Path) -> int:
    """Return the size of a recording in bytes; 0 if the daemon has removed it meanwhile."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def push(directory: Path, store: AbstractFileSystem, folder: str, *, remove: bool = False) -> Iterator[Copy]:
    """Copy every finished recording that the store does not have, and yield the outcome of each.

    Recordings keep their path below `directory`. A copy is read back. Where its SHA-256 is that of the file,
    ``NAME.sha256`` is written beside it, which says that the copy is whole; a copy without one is unfinished,
    and is made anew. A confirmed recording of other content under the same name is never replaced. With
    `remove` a recording is removed here once its copy was read back in this call, however old the copy is.
    """
    for path in recordings(directory):
        n_bytes = size_of(path)
        try:
            before = path.stat()
            remote = f"{folder}/{path.relative_to(directory).as_posix()}"
            state = _copy(path, store, remote, must_read_back=remove)
            if remove:
                _remove(path, before)
            yield Copy(path, n_bytes, state)
        except DataError as error:
            yield Copy(path, n_bytes, "failed", str(error))
        except Exception as error:  # each kind of store has exceptions of its own
            yield Copy(path, n_bytes, "failed", reason_of(error))


def _remove(path: Path, confirmed: os.stat_result) -> None:
    """Remove a recording, unless it has changed since the state that was confirmed."""
    now = path.stat()
    if (now.st_size, now.st_mtime_ns) != (confirmed.st_size, confirmed.st_mtime_ns):
        raise DataError(f"{path} has changed while it was copied")
    path.unlink()


def _copy(path: Path, store: AbstractFileSystem, remote: str, *, must_read_back: bool) -> State:
    """Copy one recording and confirm it."""
    if isinstance(store, LocalFileSystem) and os.path.exists(remote) and os.path.samefile(path, remote):  # noqa: PTH110, PTH121
        raise DataError(f"{path} is in this store itself: there is no other copy")
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    store.invalidate_cache()
    is_confirmed = False
    if store.exists(remote + SIDECAR):
        confirmed = confirmed_digest(store, remote)
        if confirmed and confirmed != digest:
            raise DataError(
                f"{remote} is another recording of the same name; give each board or host a folder of its own"
            )
        is_confirmed = confirmed == digest
        is_there = is_confirmed and store.exists(remote) and store.size(remote) == path.stat().st_size
        if is_there and not (must_read_back and _read_back(store, remote) != digest):
            return "there already"
        store.rm_file(remote + SIDECAR)  # the copy is none until it is made anew and confirmed
    store.makedirs(remote.rsplit("/", 1)[0], exist_ok=True)
    store.put_file(str(path), remote)
    if (found := _read_back(store, remote)) != digest:
        raise DataError(f"{remote} was read back with SHA-256 {found}, not {digest}")
    store.pipe_file(remote + SIDECAR, f"{digest}  {path.name}\n".encode())
    return "repaired" if is_confirmed else "copied"


def _read_back(store: AbstractFileSystem, remote: str) -> str:
    """Return the SHA-256 of a copy as its disk has it, not as it stands in this host's memory."""
    if isinstance(store, LocalFileSystem) and is_regular(store, remote):
        descriptor = os.open(remote, os.O_RDONLY)
        try:
            os.fsync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        finally:
            os.close(descriptor)
    return digest_of(store, remote)


def chosen(found: Sequence[StoredRecording], patterns: Sequence[str]) -> list[StoredRecording]:
    """Return the recordings whose names match a pattern (``*``); all without patterns.

    Raises
    ------
    DataError
        A pattern matches no recording.
    """
    names: set[str] = set()
    for pattern in patterns:
        matching = {one.name for one in found if fnmatch.fnmatchcase(one.name, pattern)}
        if not matching:
            raise DataError(f"{pattern}: no recording of this name; `tactiled archive list` prints the names")
        names |= matching
    return [one for one in found if not patterns or one.name in names]


def pull(store: AbstractFileSystem, wanted: Sequence[StoredRecording], directory: Path) -> Iterator[Copy]:
    """Fetch recordings of a store, and yield the outcome of each.

    Recordings keep their path below the folder of the store. A recording gets its name here once its SHA-256
    is the confirmed one. What is here is never replaced.
    """
    for recording in wanted:
        path = directory / "?"
        try:
            path = path_below(directory, recording.name)
            state: State = "copied" if _fetch(store, recording, path) else "there already"
            yield Copy(path, recording.n_bytes, state)
        except DataError as error:
            yield Copy(path, recording.n_bytes, "failed", str(error))
        except Exception as error:  # each kind of store has exceptions of its own
            yield Copy(path, recording.n_bytes, "failed", reason_of(error))


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

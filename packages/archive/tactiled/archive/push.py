"""``tactiled archive push DIRECTORY --to URL``: copies of recordings, confirmed by reading them back."""

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fsspec import AbstractFileSystem
from fsspec.implementations.local import LocalFileSystem

from tactiled.archive.store import SIDECAR, confirmed_digest, digest_of, is_regular, reason_of
from tactiled.errors import DataError

State = Literal["copied", "there already", "repaired", "failed"]


@dataclass(frozen=True)
class Copy:
    """Outcome for one recording."""

    path: Path
    # All but the last are confirmed: the store had these bytes when they were read back. "there already" was
    # read back now only where the recording is to be removed here; "repaired" is a damaged copy that was made
    # anew
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


def push(
    directory: Path,
    store: AbstractFileSystem,
    folder: str,
    remove: bool = False,
    reached: Callable[[str, float], None] = lambda _name, _bytes: None,
) -> Iterator[Copy]:
    """Copy every finished recording that the store does not have, and yield the outcome of each.

    A copy is read back. Where its SHA-256 is that of the file, ``NAME.sha256`` is written beside it, which
    says that the copy is whole; a copy without one is unfinished, and is made anew. A confirmed recording of
    other content under the same name is never replaced.

    Parameters
    ----------
    folder : str
        Folder in the store; recordings keep their path below `directory`.
    remove : bool
        Remove each recording here once its copy was read back in this call, however old the copy is.
    reached : callable
        Called with the name of each recording that is done, and its size in bytes.
    """
    for path in recordings(directory):
        n_bytes = size_of(path)
        try:
            before = path.stat()
            remote = f"{folder}/{path.relative_to(directory).as_posix()}"
            state = _copy(path, store, remote, must_read_back=remove)
            if remove:
                _remove(path, before)
            yield Copy(path, state)
        except DataError as error:
            yield Copy(path, "failed", str(error))
        except Exception as error:  # each kind of store has exceptions of its own
            yield Copy(path, "failed", reason_of(error))
        reached(path.name, n_bytes)


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

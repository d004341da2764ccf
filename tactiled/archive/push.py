"""``tactiled archive push DIRECTORY --to URL``: copies of recordings, confirmed by reading them back."""

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import fsspec
from fsspec import AbstractFileSystem
from fsspec.implementations.local import LocalFileSystem

from tactiled.errors import DataError, OperatorError

_BLOCK_BYTES = 1 << 22  # few requests, little memory
_SIDECAR = ".sha256"  # as `sha256sum` writes and checks
_HEX_DIGITS = "0123456789abcdef"

State = Literal["copied", "there already", "failed"]


@dataclass(frozen=True)
class Copy:
    """Outcome for one recording.

    Attributes
    ----------
    path : Path
    state : {"copied", "there already", "failed"}
        The first two are confirmed: the store has these bytes.
    reason : str
        Why it failed; else empty.
    """

    path: Path
    state: State
    reason: str = ""


def open_store(url: str) -> tuple[AbstractFileSystem, str]:
    """Return the file system of a URL (``s3://BUCKET/FOLDER``, ``file:///FOLDER``, ...), and its folder.

    Credentials and the address of an S3 server come from the environment or the user's own files, as for
    every program that uses fsspec (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ``~/.aws``).

    Raises
    ------
    OperatorError
        The kind of store is unknown, or its library is not installed.
    """
    try:
        store, folder = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise OperatorError(f"--to {url}: {error}") from None
    if not folder:
        raise OperatorError(f"--to {url}: name a bucket or a folder")
    return store, folder.rstrip("/")


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
    directory : Path
    store : AbstractFileSystem
    folder : str
        Folder in the store; recordings keep their path below `directory`.
    remove : bool
        Remove each recording here once its copy is confirmed.
    reached : callable
        Called with the name of each recording that is done, and its size in bytes.
    """
    for path in recordings(directory):
        n_bytes = size_of(path)
        try:
            before = path.stat()
            state = _copy(path, store, f"{folder}/{path.relative_to(directory).as_posix()}")
            if remove:
                _remove(path, before)
            yield Copy(path, state)
        except DataError as error:
            yield Copy(path, "failed", str(error))
        except Exception as error:  # each kind of store has exceptions of its own
            yield Copy(path, "failed", f"{type(error).__name__}: {error}".rstrip(": "))
        reached(path.name, n_bytes)


def _remove(path: Path, confirmed: os.stat_result) -> None:
    """Remove a recording, unless it has changed since the state that was confirmed."""
    now = path.stat()
    if (now.st_size, now.st_mtime_ns) != (confirmed.st_size, confirmed.st_mtime_ns):
        raise DataError(f"{path} has changed while it was copied")
    path.unlink()


def _copy(path: Path, store: AbstractFileSystem, remote: str) -> State:
    """Copy one recording and confirm it."""
    if isinstance(store, LocalFileSystem) and os.path.exists(remote) and os.path.samefile(path, remote):  # noqa: PTH110, PTH121
        raise DataError(f"{path} is in this store itself: there is no other copy")
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    store.invalidate_cache()
    if store.exists(remote + _SIDECAR):
        confirmed = store.cat_file(remote + _SIDECAR).decode(errors="replace")[: len(digest)]
        # One that was cut when the store was full or lost power confirms nothing.
        if confirmed != digest and len(confirmed) == len(digest) and not confirmed.strip(_HEX_DIGITS):
            raise DataError(
                f"{remote} is another recording of the same name; give each board or host a folder of its own"
            )
        if confirmed == digest and store.exists(remote) and store.size(remote) == path.stat().st_size:
            return "there already"
    store.makedirs(remote.rsplit("/", 1)[0], exist_ok=True)
    store.put_file(str(path), remote)
    if (found := _digest(store, remote)) != digest:
        raise DataError(f"{remote} was read back with SHA-256 {found}, not {digest}")
    store.pipe_file(remote + _SIDECAR, f"{digest}  {path.name}\n".encode())
    return "copied"


def _digest(store: AbstractFileSystem, remote: str) -> str:
    """Read a file of the store, and return its SHA-256."""
    found = hashlib.sha256()
    store.invalidate_cache()
    with store.open(remote, "rb", block_size=_BLOCK_BYTES, cache_type="none") as stream:
        while block := stream.read(_BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()

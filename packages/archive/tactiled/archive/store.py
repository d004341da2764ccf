"""Store of recordings: its files, and the digests that say which copies are whole."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import fsspec
from fsspec import AbstractFileSystem

from tactiled.errors import DataError, OperatorError, UnavailableError

BLOCK_BYTES = 1 << 22  # few requests, little memory
SIDECAR = ".sha256"  # as `sha256sum` writes and checks
DIGEST_CHARACTERS = 64
_HEX_DIGITS = "0123456789abcdef"
_LOCAL = frozenset({"file", "local"})
_BUCKETS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "az"})  # their paths begin with a bucket
# Kinds of store whose files are there after this process; `memory` and the caches among others lose theirs.
LASTING = _LOCAL | _BUCKETS | {"sftp", "ssh", "ftp", "smb", "hdfs", "webhdfs"}

Health = Literal["whole", "damaged", "unconfirmed", "unreadable"]


@dataclass(frozen=True)
class StoredRecording:
    """Recording in a store."""

    name: str  # path below the folder, as the store gives it: unchecked
    remote: str  # path in the store
    n_bytes: int  # size that the store states
    sha256: str  # digest that was confirmed when the copy was made; empty where none is


def open_store(url: str, option: str = "--to", *, must_last: bool = False) -> tuple[AbstractFileSystem, str]:
    """Return the file system of a URL (``s3://BUCKET/FOLDER``, ``file:///FOLDER``, ...), and its folder.

    Credentials and the address of an S3 server come from the environment or the user's own files, as for
    every program that uses fsspec (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ``~/.aws``). With `must_last`
    the store has to outlive this process: its copies are to be the only ones.

    Raises
    ------
    OperatorError
        It is no URL, has no bucket or folder, the kind of store is unknown or may not last, or its library is
        not installed; `option` is named.
    UnavailableError
        The store cannot be opened, e.g. because its server does not answer.
    """
    if "://" not in url:
        raise OperatorError(f"{option} {url}: give a URL, e.g. s3://BUCKET/FOLDER or file:///FOLDER")
    for link in url.split("::"):
        kind, _, path = link.partition("://")
        if kind in _BUCKETS and path.startswith("/"):
            raise OperatorError(f"{option} {url}: name the bucket first: {kind}://BUCKET/FOLDER")
    if must_last and (reason := _fault_of_short_life(url)):
        raise OperatorError(
            f"{option} {url}: {reason}; push without --remove, or to one of: {', '.join(sorted(LASTING))}"
        )
    try:
        store, folder = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise OperatorError(f"{option} {url}: {error}") from None
    except Exception as error:  # each kind of store has exceptions of its own
        raise UnavailableError(f"{option} {url}: cannot be opened: {reason_of(error)}") from None
    if not folder:
        raise OperatorError(f"{option} {url}: name a bucket or a folder")
    return store, folder.rstrip("/")


def _fault_of_short_life(url: str) -> str:
    """Return why a store may not outlive this process; empty where it does."""
    kind = url.partition("://")[0]
    if "::" in url:
        return "a chained URL (::) may keep its files in a cache or in memory"
    return "" if kind in LASTING else f"a store of the kind {kind!r} is not known to outlive this command"


def check_apart(directory: Path, url: str) -> None:
    """Refuse a folder of this host that is inside `directory`, or holds it: copies would be copied again.

    Raises
    ------
    OperatorError
        One is inside the other, under whatever path.
    """
    link = url.split("::")[-1]  # in a chain, the last one has the files
    if link.partition("://")[0] not in _LOCAL:
        return
    here, there = directory.resolve(), Path(fsspec.core.strip_protocol(link)).resolve()
    if there.is_relative_to(here):
        raise OperatorError(f"--to {url}: is inside {directory} itself; name a folder outside of it")
    if here.is_relative_to(there):
        raise OperatorError(
            f"--to {url}: {directory} is inside this store; name a folder that does not hold it"
        )


def stored_recordings(store: AbstractFileSystem, folder: str) -> list[StoredRecording]:
    """List the recordings below a folder of a store, sorted by name.

    Raises
    ------
    DataError
        There is none: the URL is probably another one.
    UnavailableError
        The store cannot be listed.
    """
    try:
        store.invalidate_cache()
        sizes = {name: int(entry["size"] or 0) for name, entry in store.find(folder, detail=True).items()}
        found = [
            StoredRecording(
                remote.removeprefix(folder).lstrip("/"),
                remote,
                size,
                confirmed_digest(store, remote) if remote + SIDECAR in sizes else "",
            )
            for remote, size in sorted(sizes.items())
            if remote.endswith(".mcap")
        ]
    except Exception as error:  # each kind of store has exceptions of its own
        raise UnavailableError(f"{folder}: cannot be listed: {reason_of(error)}") from None
    if not found:
        raise DataError(f"{folder}: no recordings (*.mcap) there; compare the URL with that of the push")
    return found


def examine(store: AbstractFileSystem, recording: StoredRecording) -> tuple[Health, str]:
    """Read a stored recording back, and compare it with the digest that was confirmed; say what is wrong."""
    try:
        if not is_regular(store, recording.remote):
            return "unreadable", "skipped: not a regular file"
        if not recording.sha256:
            return "unconfirmed", "no complete .sha256 beside it: push it again"
        found = digest_of(store, recording.remote)
    except Exception as error:  # each kind of store has exceptions of its own
        return "unreadable", reason_of(error)
    if found != recording.sha256:
        return "damaged", f"was read back with SHA-256 {found}, not {recording.sha256}"
    return "whole", ""


def is_regular(store: AbstractFileSystem, remote: str) -> bool:
    """Say whether a name in the store, or what it links to, is a file: to open a FIFO would wait for ever."""
    return bool(store.info(remote)["type"] == "file")


def confirmed_digest(store: AbstractFileSystem, remote: str) -> str:
    """Return the digest beside a copy; empty where it was cut when the store was full or lost power."""
    if not is_regular(store, remote + SIDECAR):
        return ""
    with store.open(remote + SIDECAR, "rb", cache_type="none") as stream:
        text: str = stream.read(DIGEST_CHARACTERS).decode(errors="replace")
    return text if len(text) == DIGEST_CHARACTERS and not text.strip(_HEX_DIGITS) else ""


def digest_of(store: AbstractFileSystem, remote: str) -> str:
    """Read a file of the store, and return its SHA-256."""
    found = hashlib.sha256()
    store.invalidate_cache()
    if not is_regular(store, remote):
        raise DataError(f"{remote} is not a regular file")
    with store.open(remote, "rb", block_size=BLOCK_BYTES, cache_type="none") as stream:
        while block := stream.read(BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def reason_of(error: Exception) -> str:
    """Describe the exception of a store in a line."""
    return f"{type(error).__name__}: {error}".rstrip(": ")

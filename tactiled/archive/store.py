"""Store of recordings: its files, and the digests that say which copies are whole."""

import hashlib
from dataclasses import dataclass
from typing import Literal

import fsspec
from fsspec import AbstractFileSystem

from tactiled.errors import DataError, OperatorError, UnavailableError

BLOCK_BYTES = 1 << 22  # few requests, little memory
SIDECAR = ".sha256"  # as `sha256sum` writes and checks
DIGEST_CHARACTERS = 64
_HEX_DIGITS = "0123456789abcdef"

Health = Literal["whole", "damaged", "unconfirmed", "unreadable"]


@dataclass(frozen=True)
class StoredRecording:
    """Recording in a store.

    Attributes
    ----------
    name : str
        Path below the folder, as the store gives it: unchecked.
    remote : str
        Path in the store.
    n_bytes : int
        Size that the store states.
    sha256 : str
        Digest that was confirmed when the copy was made; empty where none is.
    """

    name: str
    remote: str
    n_bytes: int
    sha256: str


@dataclass(frozen=True)
class Examined:
    """Outcome of reading a stored recording back.

    Attributes
    ----------
    recording : StoredRecording
    health : {"whole", "damaged", "unconfirmed", "unreadable"}
    reason : str
        Why the copy is not whole; else empty.
    """

    recording: StoredRecording
    health: Health
    reason: str = ""


def open_store(url: str, option: str = "--to") -> tuple[AbstractFileSystem, str]:
    """Return the file system of a URL (``s3://BUCKET/FOLDER``, ``file:///FOLDER``, ...), and its folder.

    Credentials and the address of an S3 server come from the environment or the user's own files, as for
    every program that uses fsspec (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ``~/.aws``).

    Raises
    ------
    OperatorError
        It is no URL, the kind of store is unknown, or its library is not installed; `option` is named.
    """
    if "://" not in url:
        raise OperatorError(f"{option} {url}: give a URL, e.g. s3://BUCKET/FOLDER or file:///FOLDER")
    try:
        store, folder = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise OperatorError(f"{option} {url}: {error}") from None
    if not folder:
        raise OperatorError(f"{option} {url}: name a bucket or a folder")
    return store, folder.rstrip("/")


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


def examine(store: AbstractFileSystem, recording: StoredRecording) -> Examined:
    """Read a stored recording back, and compare it with the digest that was confirmed."""
    if not recording.sha256:
        return Examined(recording, "unconfirmed", "no complete .sha256 beside it: push it again")
    try:
        found = digest_of(store, recording.remote)
    except Exception as error:  # each kind of store has exceptions of its own
        return Examined(recording, "unreadable", reason_of(error))
    if found != recording.sha256:
        return Examined(recording, "damaged", f"was read back with SHA-256 {found}, not {recording.sha256}")
    return Examined(recording, "whole")


def confirmed_digest(store: AbstractFileSystem, remote: str) -> str:
    """Return the digest beside a copy; empty where it was cut when the store was full or lost power."""
    with store.open(remote + SIDECAR, "rb", cache_type="none") as stream:
        text: str = stream.read(DIGEST_CHARACTERS).decode(errors="replace")
    return text if len(text) == DIGEST_CHARACTERS and not text.strip(_HEX_DIGITS) else ""


def digest_of(store: AbstractFileSystem, remote: str) -> str:
    """Read a file of the store, and return its SHA-256."""
    found = hashlib.sha256()
    store.invalidate_cache()
    with store.open(remote, "rb", block_size=BLOCK_BYTES, cache_type="none") as stream:
        while block := stream.read(BLOCK_BYTES):
            found.update(block)
    return found.hexdigest()


def reason_of(error: Exception) -> str:
    """Describe the exception of a store in a line."""
    return f"{type(error).__name__}: {error}".rstrip(": ")

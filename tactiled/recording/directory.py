"""The record directory: names of the recordings in it, which are finished, and which must go.

Only names that `new_name` makes are looked at: other files in the directory belong to somebody else.
"""

import contextlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tactiled.recording.writer import ACTIVE, is_being_written

_FINISHED = re.compile(r"tactile-\d{8}T\d{6}\.\d{3}Z(\.\d{3,})?\.mcap")
_MB = 1e6
_DAY_S = 86400.0


@dataclass(frozen=True)
class Finished:
    """A finished recording.

    Attributes
    ----------
    path : Path
    size_mb : float
        10^6 bytes.
    ended_unix_s : float
        When it was last written to.
    """

    path: Path
    size_mb: float
    ended_unix_s: float


def new_name(instant: datetime) -> str:
    """Name of a recording that begins at `instant` (UTC)."""
    return f"tactile-{instant.strftime('%Y%m%dT%H%M%S.%f')[:-3]}Z.mcap"


def finished(directory: Path) -> list[Finished]:
    """Finished recordings in a directory; `OSError` when it cannot be read."""
    found = []
    for path in directory.iterdir():
        if _FINISHED.fullmatch(path.name):
            with contextlib.suppress(FileNotFoundError):  # somebody has just removed it
                status = path.stat()
                found.append(Finished(path, status.st_size / _MB, status.st_mtime))
    return found


def unfinished(directory: Path) -> list[Path]:
    """``.active`` files in a directory that no recorder is writing; `OSError` when it cannot be read."""
    names = (path for path in directory.iterdir() if path.name.endswith(ACTIVE))
    return sorted(
        path
        for path in names
        if _FINISHED.fullmatch(path.name.removesuffix(ACTIVE)) and not is_being_written(path)
    )


def surplus(
    files: Iterable[Finished], keep_mb: float | None, keep_days: float | None, now_unix_s: float
) -> list[Finished]:
    """Files to remove, oldest first, so that the rest is within both limits; never the newest file.

    Parameters
    ----------
    files : iterable of Finished
    keep_mb, keep_days : float, optional
        Limits of total size (10^6 bytes) and of age; None is no limit.
    now_unix_s : float
    """
    in_order = sorted(files, key=lambda file: (file.ended_unix_s, file.path.name))
    total_mb = sum(file.size_mb for file in in_order)
    removed = []
    for file in in_order[:-1]:
        too_many = keep_mb is not None and total_mb > keep_mb
        too_old = keep_days is not None and now_unix_s - file.ended_unix_s > keep_days * _DAY_S
        if too_many or too_old:
            removed.append(file)
            total_mb -= file.size_mb
    return removed


def retain(
    directory: Path, keep_mb: float | None, keep_days: float | None, now_unix_s: float
) -> list[Finished]:
    """Remove the `surplus` of a directory; gives what was removed.

    Raises
    ------
    OSError
        The directory cannot be read, or a file in it cannot be removed.
    """
    removed = surplus(finished(directory), keep_mb, keep_days, now_unix_s)
    for file in removed:
        file.path.unlink(missing_ok=True)
    return removed

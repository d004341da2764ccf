"""Record directory: names of recordings, finished and unfinished files, and removal of old ones.

Only files named by `new_name` are considered; all other files in the directory are left alone.
"""

import contextlib
import re
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tactiled.recording.writer import ACTIVE, DAMAGED, is_being_written

_FINISHED = re.compile(r"tactile-\d{8}T\d{6}\.\d{3}Z(\.\d{3,})?\.mcap")
_MB = 1e6


@dataclass(frozen=True)
class Finished:
    """Finished recording, or the original of one that was recovered from a damaged file."""

    path: Path
    size_mb: float  # 10^6 bytes
    ended_unix_s: float  # time of the last write


def new_name(instant: datetime) -> str:
    """Name of a recording that begins at `instant` (UTC)."""
    return f"tactile-{instant.strftime('%Y%m%dT%H%M%S.%f')[:-3]}Z.mcap"


def finished(directory: Path) -> list[Finished]:
    """List the finished recordings in a directory; `OSError` when it cannot be read."""
    found = []
    for path in directory.iterdir():
        if _FINISHED.fullmatch(path.name.removesuffix(ACTIVE + DAMAGED)):
            with contextlib.suppress(FileNotFoundError):  # removed by another process meanwhile
                status = path.stat()
                if stat.S_ISREG(status.st_mode):
                    found.append(Finished(path, status.st_size / _MB, status.st_mtime))
    return found


def unfinished(directory: Path) -> list[Path]:
    """List ``.active`` files that no recorder is writing; `OSError` when it cannot be read."""
    names = (path for path in directory.iterdir() if path.name.endswith(ACTIVE))
    return sorted(
        path
        for path in names
        if _FINISHED.fullmatch(path.name.removesuffix(ACTIVE)) and not is_being_written(path)
    )


def surplus(files: Iterable[Finished], keep_mb: float, now_unix_s: float) -> list[Finished]:
    """Select the files to remove, oldest first, so that the others are no larger together than `keep_mb`.

    The newest file is always kept. Dates after now are those of a clock that was wrong, then or now: such
    files are taken for the oldest, so that they do not stand in the way of what is recorded from now on.
    """
    in_order = sorted(
        files, key=lambda one: (one.ended_unix_s <= now_unix_s, one.ended_unix_s, one.path.name)
    )
    total_mb = sum(file.size_mb for file in in_order)
    removed = []
    for file in in_order[:-1]:
        if total_mb <= keep_mb:
            break
        removed.append(file)
        total_mb -= file.size_mb
    return removed


def remove_surplus(directory: Path, keep_mb: float, now_unix_s: float) -> list[Finished]:
    """Remove the `surplus` of a directory; `OSError` when it cannot be read, or a file not be removed.

    A file that cannot be removed does not keep the others from being removed.
    """
    removed = surplus(finished(directory), keep_mb, now_unix_s)
    fault: OSError | None = None
    for file in removed:
        try:
            file.path.unlink(missing_ok=True)
        except OSError as error:
            fault = fault or error
    if fault is not None:
        raise fault
    return removed

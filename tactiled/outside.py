"""Checks of what comes from outside, each with its bound: files of others, names, strings of devices.

Whatever enters from a USB descriptor, a store, a file that somebody else made, a socket or the environment
passes one of these before it is written, allocated, deleted or logged. Messages have their own check in
`events.incoming`, frames in `wire`.
"""

import stat
from pathlib import Path

from tactiled.errors import DataError

# A text file of ours (configuration, array, layout, calibration) has at most some hundred kilobytes.
TEXT_LIMIT_BYTES = 4 * 2**20
SHOWN_CHARACTERS = 60  # of a text from outside, in an error or a log line


def shown(text: str) -> str:
    """Return a text from outside as it may stand in an error or a log line: printable, short, quoted."""
    return ascii(text[:SHOWN_CHARACTERS]) + ("..." if len(text) > SHOWN_CHARACTERS else "")


def read_text(path: Path, limit_bytes: int = TEXT_LIMIT_BYTES) -> str:
    """Read a text file that somebody else may have made.

    Parameters
    ----------
    path : Path
        A regular file: a device, a FIFO or a folder is refused before it is read.
    limit_bytes : int
        Size beyond which the file is refused.

    Raises
    ------
    DataError
        Not a regular file, too large, or not UTF-8.
    OSError
        The file cannot be opened.
    """
    kind = path.stat().st_mode
    if not stat.S_ISREG(kind):
        raise DataError(f"{path}: is not a regular file")
    with path.open("rb") as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise DataError(f"{path}: has more than {limit_bytes} bytes")
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is not UTF-8 text ({error.reason} at byte {error.start})") from None

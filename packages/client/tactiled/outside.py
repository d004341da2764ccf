"""Checks of what comes from outside, each with its bound: files of others, names, strings of devices.

Whatever enters from a USB descriptor, a store, a file that somebody else made, a socket or the environment
passes one of these before it is written, allocated, deleted or logged. Messages have their own check in
`events.incoming`, frames in `wire`.
"""

import json
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path

from tactiled.errors import ConfigError, DataError

# A text file of ours (configuration, array, layout, calibration) has at most some hundred kilobytes.
TEXT_LIMIT_BYTES = 4 * 2**20
# A key file of ours has 200 bytes, a configuration of zenoh with certificates 10 kB.
SECRET_LIMIT_BYTES = 64 * 1024
SHOWN_CHARACTERS = 60  # of a text from outside, in an error or a log line
# Of a USB string descriptor: 255 bytes at most, two of them its head, the rest UTF-16.
USB_CHARACTERS = 126
# Longer names leave no room for the rest of a file name (255 bytes) or of a socket's path (107 bytes).
NAME_CHARACTERS = 64
# No quote, blank, comma, glob (* ? [ ] |) or substitution ($ %): none of these ends a value of a rule, or
# makes it match what it does not say.
_IN_A_RULE = re.compile(rf"[A-Za-z0-9_.:-]{{1,{USB_CHARACTERS}}}")
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{NAME_CHARACTERS - 1}}}")


def shown(text: str) -> str:
    """Return a text from outside as it may stand in an error or a log line: printable, short, quoted."""
    return ascii(text[:SHOWN_CHARACTERS]) + ("..." if len(text) > SHOWN_CHARACTERS else "")


def name_of(text: str) -> str:
    """Return a name that may stand in paths, units and rules.

    `DataError` where it has other characters than letters, digits, ``-``, ``_`` and ``.``, begins with none
    of the first two, or is too long.
    """
    if not _NAME.fullmatch(text):
        words = f"at most {NAME_CHARACTERS} letters, digits, '-', '_' and '.', as in left-hand"
        raise DataError(f"{shown(text)}: is no name: {words}")
    return text


def rule_value(text: str) -> str:
    """Return a text of a USB device as it may stand in a udev rule, and as udev itself sees it.

    udev cuts blanks at both ends and makes one ``_`` of those between; it drops or rewrites most of what is
    refused here, so that a rule with the text as it is would match nothing, or another device. `DataError`
    where it is empty, too long, or has other characters than letters, digits and ``-_.:``.
    """
    value = re.sub(" +", "_", text.strip(" "))
    if not _IN_A_RULE.fullmatch(value):
        words = f"1 to {USB_CHARACTERS} letters, digits, '-', '_', '.' and ':'"
        raise DataError(f"{shown(text)}: may not stand in a udev rule: only {words}")
    return value


def read_text(path: Path, limit_bytes: int = TEXT_LIMIT_BYTES) -> str:
    """Read a text file that somebody else may have made.

    `DataError` where it is not a regular file, larger than the limit, or not UTF-8; `OSError` where it cannot
    be opened.
    """
    need_regular(path)
    with path.open("rb") as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise DataError(f"{path}: has more than {limit_bytes} bytes")
    try:
        return data.decode("utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is not UTF-8 text ({error.reason} at byte {error.start})") from None


def need_regular(path: Path) -> None:
    """Refuse with a DataError a device, a FIFO or a folder, which may have no end or never answer."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise DataError(f"{path}: is not a regular file")


def json_of(text: str) -> object:
    """Return the value of a JSON text, of any kind.

    `DataError` where it is no JSON, is nested too deeply, or has a number that no program reads.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        words = "is nested too deeply" if isinstance(error, RecursionError) else f"is no JSON: {error}"
        raise DataError(words) from None


def read_secret(path: Path, what: str = "secret key", environ: Mapping[str, str] = os.environ) -> str:
    """Read a text file with a key or a token (`what`), which only its owner may be able to read.

    A credential of systemd, in ``CREDENTIALS_DIRECTORY`` of the environment, is accepted with any mode: its
    access list shows as group permissions. `ConfigError` where others can read the file; other errors as for
    `read_text`.
    """
    mode = path.stat().st_mode
    credentials = environ.get("CREDENTIALS_DIRECTORY")
    is_credential = bool(credentials) and path.parent == Path(str(credentials))
    if stat.S_ISREG(mode) and mode & 0o077 and not is_credential:
        raise ConfigError(str(path), [f"others can read the {what}: chmod 600 {path}"])
    return read_text(path, SECRET_LIMIT_BYTES)

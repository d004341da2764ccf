"""Logging to stderr: with ``<N>`` priorities for the journal, with times for a terminal.

See sd-daemon(3) for the prefixes and systemd.exec(5) for ``JOURNAL_STREAM`` (device:inode of the stream).
"""

import logging
import os
import sys
from collections.abc import Mapping
from typing import TextIO

# Python's levels as syslog's: error 3, warning 4, informational 6, debug 7.
_PRIORITIES = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))


class JournalFormatter(logging.Formatter):
    """Put the priority before each line, because the journal makes one entry of each line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the message with ``<N>`` before each of its lines."""
        priority = next((p for level, p in _PRIORITIES if record.levelno >= level), 7)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def journal_listens(stream: TextIO, environ: Mapping[str, str] = os.environ) -> bool:
    """Return True when `stream` is the pipe to the journal, and was not redirected since."""
    device, _, inode = environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        stat = os.fstat(stream.fileno())
    except (OSError, ValueError):  # a stream without a descriptor, or a closed one
        return False
    return (device, inode) == (str(stat.st_dev), str(stat.st_ino))


def set_up(level: int = logging.INFO, stream: TextIO | None = None) -> logging.Handler:
    """Send log records of tactiled to `stream` (default: stderr); replaces the handler of an earlier call."""
    stream = sys.stderr if stream is None else stream
    handler = logging.StreamHandler(stream)
    if journal_listens(stream):
        handler.setFormatter(JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%H:%M:%S"))
    logger = logging.getLogger("tactiled")
    logger.handlers = [handler]
    logger.setLevel(level)
    return handler

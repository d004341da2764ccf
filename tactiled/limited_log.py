"""Log lines at a bounded rate: a condition that repeats is logged once, then counted."""

import logging
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tactiled.outside import shown

PERIOD_S = 10.0  # from a line to the count of its repetitions, and between two counts
_NAMED = 8  # conditions logged in one period: a noisy one does not hide the others, and the disk cannot fill


class _Repeated(NamedTuple):
    times: int
    reason: str
    level: int


class RateLimitedLog:
    """Log each condition at once; count what repeats within `PERIOD_S` and log the count then.

    Counts are logged in the order of the last occurrences, so that the last line of a condition that comes
    and goes says how things are now. `what` begins each line, e.g. ``"request refused"``.
    """

    def __init__(self, logger: logging.Logger, what: str = "") -> None:
        self.count = 0
        self._logger = logger
        self._prefix = f"{what}: " if what else ""
        self._recent: dict[str, _Repeated] = {}
        self._others = 0
        self._end_s = float("-inf")

    def add(self, reason: str, now_s: float, level: int = logging.WARNING, kind: str = "") -> None:
        """Count one occurrence; log it now if its condition is new in this period.

        `kind` says which condition it is where `reason` contains measured values.
        """
        self.count += 1
        self.write_counts(now_s)
        kind = kind or reason
        if (known := self._recent.pop(kind, None)) is not None:
            self._recent[kind] = _Repeated(known.times + 1, reason, level)
        elif len(self._recent) < _NAMED:
            if not self._recent:
                self._end_s = now_s + PERIOD_S
            self._recent[kind] = _Repeated(0, reason, level)
            self._logger.log(level, "%s%s", self._prefix, reason)
        else:
            self._others += 1

    def write_counts(self, now_s: float) -> None:
        """Log the counts if the period is over; call it about once a second."""
        if not self._recent or now_s < self._end_s:
            return
        repeated = {kind: entry for kind, entry in self._recent.items() if entry.times}
        for times, reason, level in repeated.values():
            more = f" ({times} times)" if times > 1 else ""
            self._logger.log(level, "%s%s%s", self._prefix, reason, more)
        if self._others:
            self._logger.warning("%sand %d more, for other reasons", self._prefix, self._others)
        self._recent = {kind: entry._replace(times=0) for kind, entry in repeated.items()}
        self._others, self._end_s = 0, now_s + PERIOD_S


@contextmanager
def limit_rate_of(names: tuple[str, ...], log: RateLimitedLog) -> Iterator[None]:
    """Send lines of loggers of libraries through `log` meanwhile, each as one line without a traceback."""

    def redirect(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.WARNING:
            log.add(_one_line(record), time.monotonic(), record.levelno, kind=str(record.msg))
        return False

    loggers = [logging.getLogger(name) for name in names]
    for logger in loggers:
        logger.addFilter(redirect)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(redirect)


def _one_line(record: logging.LogRecord) -> str:
    """First line of a record; for an exception also its type, its words and where it was raised."""
    text = record.getMessage().partition("\n")[0]
    error = record.exc_info[1] if record.exc_info else None
    if error is None:
        return text
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{text}: {type(error).__name__}: {shown(str(error))}{where}"

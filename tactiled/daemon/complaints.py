"""Log lines at a bounded rate: whoever provokes them must not be able to fill the disk with them."""

import logging

PERIOD_S = 10.0


class Complaints:
    """Says the first at once, and then every `PERIOD_S` how many there were and what the last was.

    Parameters
    ----------
    logger : Logger
    what : str
        Begins each line, e.g. ``"request refused"``.
    """

    def __init__(self, logger: logging.Logger, what: str) -> None:
        self.count = 0
        self._logger = logger
        self._what = what
        self._said = 0
        self._next_s = float("-inf")

    def add(self, reason: str, now_s: float) -> None:
        """Count one, and say it unless one was said just now."""
        self.count += 1
        if now_s < self._next_s:
            return
        more = self.count - self._said - 1
        self._logger.warning("%s: %s%s", self._what, reason, f" (and {more} more since)" if more else "")
        self._said, self._next_s = self.count, now_s + PERIOD_S

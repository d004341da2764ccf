"""Log lines at a bounded rate: whoever provokes them must not be able to fill the disk with them."""

import logging
from collections import Counter

PERIOD_S = 10.0
_NAMED = 8  # different reasons a period: one who is noisy does not hide the others, and the disk is safe


class Complaints:
    """Says the first at once; what came within `PERIOD_S` of it is told then, each reason with its count.

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
        self._untold: Counter[str] = Counter()
        self._others = 0
        self._next_s = float("-inf")

    def add(self, reason: str, now_s: float) -> None:
        """Count one, and say it unless one was said just now."""
        self.count += 1
        if reason in self._untold or len(self._untold) < _NAMED:
            self._untold[reason] += 1
        else:
            self._others += 1
        self.tell(now_s)

    def tell(self, now_s: float) -> None:
        """Say what waits to be said, if it is time; to be called now and then."""
        if not self._untold or now_s < self._next_s:
            return
        for reason, times in self._untold.items():
            self._logger.warning("%s: %s%s", self._what, reason, f" ({times} times)" if times > 1 else "")
        if self._others:
            self._logger.warning("%s: and %d more, for other reasons", self._what, self._others)
        self._untold.clear()
        self._others, self._next_s = 0, now_s + PERIOD_S

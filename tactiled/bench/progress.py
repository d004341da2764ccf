"""How far a long bench is: one line that a terminal renews, or a line at every tenth where there is none."""

import sys
import time
from collections.abc import Callable
from typing import TextIO

_WIDTH = 30  # of the bar, characters
_LINES = 10  # without a terminal


class Progress:
    """A bar with the time that is left, by how long the work done so far took.

    Parameters
    ----------
    say : callable
        Takes a line of progress where there is no terminal.
    total : float
        Work to come, in any unit that takes about the same time everywhere.
    terminal : TextIO, optional
        Where the bar is drawn if it is a terminal; standard error if not given.
    clock : callable
        Seconds.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        total: float,
        *,
        terminal: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say, self._total = say, total
        self._terminal = terminal or sys.stderr
        self._is_terminal = self._terminal.isatty()
        self._clock = clock
        self._began_s = clock()
        self._done = 0.0
        self._lines = 0
        self._drawn = 0  # characters of the line on the terminal

    def advance(self, what: str, work: float = 1.0) -> None:
        """So much more is done, of what."""
        self._done = min(self._done + work, self._total)
        words = f"{100 * self._done / self._total:3.0f} %  {what}{self._left()}"
        if self._is_terminal:
            full = round(_WIDTH * self._done / self._total)
            self._draw(f"[{'#' * full}{'.' * (_WIDTH - full)}] {words}")
        elif int(_LINES * self._done / self._total) > self._lines:
            self._lines = int(_LINES * self._done / self._total)
            self._say(words.strip())

    def close(self) -> None:
        """Leave the terminal an empty line."""
        if self._is_terminal:
            self._draw("")
            self._terminal.write("\r")
            self._terminal.flush()

    def _left(self) -> str:
        if not 0 < self._done < self._total:
            return ""
        left_s = (self._clock() - self._began_s) * (self._total / self._done - 1)
        minutes, seconds = divmod(round(left_s), 60)
        return f", {minutes} min {seconds:02d} s left" if minutes else f", {seconds} s left"

    def _draw(self, line: str) -> None:
        self._terminal.write("\r" + line.ljust(self._drawn))
        self._terminal.flush()
        self._drawn = len(line)

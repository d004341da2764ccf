"""Progress bar and text that a command shows people on standard error.

The bar is shown if that is a terminal; else there is one line at the start.
"""

import os
import sys
from collections.abc import Callable
from functools import partial
from textwrap import fill
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress


class ProgressBar:
    """Context manager that shows a progress bar, and removes it at the end.

    Parameters
    ----------
    title : str
        Name of the work, e.g. ``replay slide.mcap``.
    total : float, optional
        Amount of work, in any unit; without it the bar shows only that the command is running.
    writes_lines : bool
        The command prints to standard output meanwhile. Where that is a terminal too, there is no bar, which
        would be drawn into those lines.
    """

    def __init__(
        self,
        title: str,
        total: float | None = 1.0,
        *,
        writes_lines: bool = False,
        terminal: TextIO | None = None,
    ) -> None:
        self._title, self._total = title, total
        self._stream = sys.stderr if terminal is None else terminal
        self._has_bar = self._stream.isatty() and not (writes_lines and sys.stdout.isatty())
        self._bar: RichProgress | None = None
        self._update: Callable[..., None] = lambda **_: None

    def __enter__(self) -> Self:
        if not self._has_bar:
            print(f"{self._title} ...", file=self._stream, flush=True)
            return self
        # Imported only where a bar is drawn: it takes long.
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as RichProgress

        self._bar = RichProgress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(compact=True),
            console=Console(file=self._stream),
            refresh_per_second=4,
            transient=True,
            redirect_stdout=False,  # which rich would print to standard error
        )
        self._bar.start()
        self._update = partial(self._bar.update, self._bar.add_task(self._title, total=self._total))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def begin(self, total: float) -> None:
        """Set the amount of work, once it is known."""
        self._update(total=total)

    def advance(self, what: str, work: float = 1.0) -> None:
        """Add finished work; `what` is shown beside the title."""
        self._update(advance=work, description=f"{self._title}: {what}")

    def reach(self, done: float) -> None:
        """Set the total amount of finished work."""
        self._update(completed=done)

    def note(self, what: str) -> None:
        """Show `what` beside the title as the present work."""
        self.advance(what, 0.0)


def tell(words: str) -> None:
    """Print text for people; in a terminal, long lines are wrapped between words."""
    if sys.stderr.isatty():
        width = os.get_terminal_size(sys.stderr.fileno()).columns or 80  # 0 where nobody has set it
        words = "\n".join(
            fill(line, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
            for line in words.split("\n")
        )
    print(words, file=sys.stderr, flush=True)

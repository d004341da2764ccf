"""``tactiled top``: subscription, keys and screen."""

import os
import select
import shutil
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from tactiled.array import Array
from tactiled.client import Commander, Subscription
from tactiled.errors import OperatorError
from tactiled.top.boards import BoardView, BoardViews
from tactiled.top.draw import draw

_DRAW_S = 0.1  # ten pictures a second: numbers that change faster cannot be read
_COMMANDS: dict[str, tuple[str, dict[str, Any]]] = {
    "t": ("tare", {}),
    "i": ("inhibit", {"duration_s": 0.5}),
    "e": ("expect-load-change", {"duration_s": 0.5}),
    "m": ("mark", {"text": "mark from tactiled top"}),
}
_FOOTER = " q quit  b board  t tare  i inhibit  e expect  m mark  r record"


def run_top(endpoint: str, array: Array | None, keys: Path | None) -> None:
    """Show the boards of a daemon until q or Ctrl-C."""
    if not sys.stdin.isatty() or not sys.stdout.isatty():
        raise OperatorError("tactiled top needs a terminal: use tactiled listen here")
    with Subscription(endpoint, keys=keys) as subscription:
        _live(subscription, BoardViews(array), endpoint, keys)


def _receive(subscription: Subscription, views: BoardViews, until_s: float) -> None:
    while (item := subscription.next_item(until_s)) is not None:
        views.take(item)
        if time.monotonic() >= until_s:
            return


def _live(subscription: Subscription, views: BoardViews, endpoint: str, keys: Path | None) -> None:
    chosen, footer, footer_until_s = 0, _FOOTER, 0.0

    def command(do: str, board: BoardView, **fields: Any) -> str:
        try:
            with Commander(endpoint, "tactiled top", keys=keys) as daemon:
                reply = daemon.send(do, timeout_s=2.0, board=board.name, **fields)
        except OperatorError as error:
            return f" {do}: {error}"
        return f" {do}: done" if reply.ok else f" {do}: refused: {reply.reason}"

    def act(key: str, board: BoardView) -> str:
        """Carry out the command of a key; return what became of it, "" where the key has none."""
        if key == "r":
            return command("record", board, on=board.newest.get("recording", {}).get("state", "off") == "off")
        return command(_COMMANDS[key][0], board, **_COMMANDS[key][1]) if key in _COMMANDS else ""

    with _terminal() as (show, next_key):
        while True:
            _receive(subscription, views, time.monotonic() + _DRAW_S)
            boards = list(views.boards.values()) or [BoardView("")]
            board = boards[chosen % len(boards)]
            key = next_key()
            if key in ("q", "\x03"):
                return
            if key == "b":
                chosen += 1
            elif words := act(key, board):
                footer, footer_until_s = words, time.monotonic() + 3.0
            if time.monotonic() > footer_until_s:
                footer = _FOOTER
            width, height = shutil.get_terminal_size((80, 24))
            others = [other for other in boards if other is not board]
            lines = draw(board, time.time(), width, height, footer, views.notice, others)
            show([_painted(line, width) for line in lines])


@contextmanager
def _terminal() -> Iterator[tuple[Callable[[list[str]], None], Callable[[], str]]]:
    """Take over the terminal: a function that shows lines, and one that returns a pressed key or ""."""
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    shown: list[str] = []

    def show(lines: list[str]) -> None:
        """Write only the lines that have changed, in one piece: nothing flickers."""
        if len(lines) != len(shown):
            shown[:] = [""] * len(lines)
            sys.stdout.write("\x1b[2J")
        changed = [(n, line) for n, line in enumerate(lines) if line != shown[n]]
        sys.stdout.write("".join(f"\x1b[{n + 1};1H{line}\x1b[0m\x1b[K" for n, line in changed))
        sys.stdout.flush()
        shown[:] = lines

    def next_key() -> str:
        ready, _, _ = select.select([descriptor], [], [], 0.0)
        return os.read(descriptor, 1).decode(errors="replace") if ready else ""

    try:
        tty.setcbreak(descriptor)
        sys.stdout.write("\x1b[?1049h\x1b[?25l")
        yield show, next_key
    except KeyboardInterrupt:
        pass
    finally:
        sys.stdout.write("\x1b[?25h\x1b[?1049l")
        sys.stdout.flush()
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _painted(line: Text, width: int) -> str:
    """Line with the colour codes of this terminal; without any where NO_COLOR is set or it is no terminal."""
    out = StringIO()
    colours = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    console = Console(
        file=out, width=width, force_terminal=colours, color_system="truecolor" if colours else None
    )
    console.print(line, end="", no_wrap=True, overflow="crop", highlight=False)
    return out.getvalue()

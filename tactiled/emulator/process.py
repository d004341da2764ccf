"""The emulator as a process: it runs until a signal ends it."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.control import control_link
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.line.links import make_link
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.shell import Emulator, Report
from tactiled.wire.layout import Layout


def run_emulator(
    scene: Scene,
    layout: Layout,
    *,
    link: Path | None = None,
    tcp: str | None = None,
    board: EmulatedBoardParams | None = None,
    faults: FaultParams | None = None,
    seed: int = 0,
    report: Report,
    with_scans: bool = False,
    control: str | None = None,
) -> None:
    """Run an `Emulator` until SIGTERM or SIGINT; its pty appears as `link`, or it listens on `tcp`.

    `control` is ``unix:///PATH`` or ``tcp://HOST:PORT``, where a controller moves the grip.

    Raises
    ------
    ConfigError
        What was asked for does not fit together, or the link cannot be made.
    """
    emulator = Emulator(
        scene,
        layout,
        make_link(link, tcp),
        board=board,
        faults=faults,
        seed=seed,
        report=report,
        with_scans=with_scans,
        control=None if control is None else control_link(control),
    )
    with _stopped_by_signals(emulator.stop):
        emulator.run()


def words_for_people(what: dict[str, Any]) -> str:
    """What a person must know of a report of `Emulator`; empty for most reports."""
    if what["what"] == "preparing":
        stage = f"table {what['solved'] + 1} of {what['tables']}" if what["tables"] else "finding its tables"
        return f"solving the contact before the scene can start: {stage} (the board answers start with busy)"
    if what["what"] == "prepared":
        return f"prepared after {what['took_s']:.1f} s"
    if what["what"] == "overrun":
        held = f"; the scene has stood still for {what['held_s']:.2f} s in all" if what["held_s"] else ""
        return (
            f"overrun: this host is too slow for the scene: {what['missed']} scan instants missed so far, "
            f"flagged as a board flags them{held}"
        )
    return ""


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """SIGTERM and SIGINT call `stop` meanwhile; handlers can only be set in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGTERM, signal.SIGINT)
    before = [signal.signal(number, lambda *_: stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)

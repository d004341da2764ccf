"""The whole daemon with emulated boards on a real pty, in real time, and a subscriber.

`DaemonOnPty` is the service, its port, its socket and a client in one event loop; boards run in threads.
`TamperedLink` changes the bytes of a board in transit, for faults that the emulator does not have.
"""

import asyncio
import threading
import time
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from daemons import no_recorder
from patience import PATIENCE_S

from tactiled.array import load_array
from tactiled.client import Client, Message
from tactiled.daemon.board.session import SessionParams
from tactiled.daemon.runner import ServedBoard, ServiceParams
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import Service
from tactiled.daemon.zmq.params import PublishParams
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.line.links import PtyLink
from tactiled.emulator.realtime import Emulator
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.errors import TactiledError
from tactiled.pipeline import Pipeline
from tactiled.wire.layout import Layout, load_layout

SERIAL = "TS0001"
RATE_HZ = 90.0  # not the board's default of 100: it must be set again after each reboot
STALL_S = 0.5  # as users of CDC adapters report
UNPLUG_S = 2.0  # long enough for another board in between, on a busy host and with ports tried each 0.5 s
LAYOUT = load_layout("board-v1")

Damage = Callable[[bytes], bytes]


class TamperedLink(PtyLink):
    """Pty whose bytes from the board go through `damage`, while it is set."""

    damage: Damage | None = None

    def write(self, data: bytes) -> int:
        """Send the bytes as changed by `damage`, and return the number of given bytes."""
        if self.damage is None:
            return super().write(data)
        super().write(self.damage(data))
        return len(data)


class BoardInThread:
    """Emulated board on a pty under `path`; without a scene, nothing touches it.

    Attributes
    ----------
    plugged_s : list of float
        Instants at which the board was plugged in.
    """

    def __init__(
        self, path: Path, board: EmulatedBoardParams, layout: Layout = LAYOUT, scene: Scene | None = None
    ) -> None:
        self.link = TamperedLink(path)
        self.plugged_s: list[float] = []
        self._ready = threading.Event()
        self.emulator = Emulator(
            scene or load_scene("rest"),
            layout,
            self.link,
            board=board,
            faults=FaultParams(stall_s=STALL_S, unplug_s=UNPLUG_S),
            report=self._reported,
        )
        self._thread = threading.Thread(target=self.emulator.run, name=f"board at {path.name}")

    def __enter__(self) -> Self:
        """Power up and plug in."""
        self._thread.start()
        self._ready.wait(PATIENCE_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.emulator.stop()
        self._thread.join()

    def _reported(self, what: dict[str, Any]) -> None:
        if what["what"] == "plugged":
            self.plugged_s.append(what["time_s"])
        elif what["what"] == "ready":
            self._ready.set()


@dataclass(frozen=True)
class ReceivedMessage:
    """Scan or status at the subscriber: its instant, the time of reception, and its fields."""

    time_s: float
    received_s: float
    data: dict[str, Any]


class DaemonOnPty:
    """Daemon, board and subscriber, as an async context manager.

    Parameters
    ----------
    folder : Path
        For the port's name and the sockets.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "board"
        self.board = BoardInThread(self.path, EmulatedBoardParams(board_serial=SERIAL))
        self._endpoint = f"ipc://{folder}/events.ipc"
        self.scans: list[ReceivedMessage] = []
        self.statuses: list[ReceivedMessage] = []
        self._changed = asyncio.Event()

    async def __aenter__(self) -> Self:
        self.board.__enter__()
        self._offset_s = time.time() - time.monotonic()
        array = load_array("wang2019-3x3")
        params = ServiceParams(
            port=PortParams(url=str(self.path)),
            session=SessionParams(rate_hz=RATE_HZ, board_serial=SERIAL),
            publish=PublishParams(endpoints=(self._endpoint,)),
        )
        self._service = Service([ServedBoard(params, Pipeline(LAYOUT, array), no_recorder())])
        self._serving = asyncio.create_task(self._service.run())
        self._listening = asyncio.create_task(self._listen())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._service.stop()
        self._listening.cancel()
        await asyncio.gather(self._serving, self._listening, return_exceptions=True)
        await asyncio.to_thread(self.board.__exit__)

    async def until(self, reached: Callable[[], bool], what: str) -> None:
        """Wait for something that the subscriber receives, or raise TactiledError with its name."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not reached():
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            last = [status.data["state"] for status in self.statuses[-1:]]
            raise TactiledError(f"not within {PATIENCE_S:g} s: {what}; state {last}") from None

    async def until_status(self, state: str, reason: str = "") -> None:
        """Wait for a new status in this state with these words in its reason."""
        n = len(self.statuses)
        await self.until(
            lambda: any(s.data["state"] == state and reason in s.data["reason"] for s in self.statuses[n:]),
            f"{state} {reason}",
        )

    async def until_fresh_scan(self, from_s: float) -> ReceivedMessage:
        """Wait for the first scan that was taken at `from_s` or later, and is not late."""
        await self.until(lambda: self._fresh_from(from_s) is not None, "a fresh scan")
        found = self._fresh_from(from_s)
        assert found is not None
        return found

    def _fresh_from(self, from_s: float) -> ReceivedMessage | None:
        first = bisect_left(self.scans, from_s, key=lambda scan: scan.received_s)
        return next((s for s in self.scans[first:] if s.time_s >= from_s and not s.data["late"]), None)

    async def _listen(self) -> None:
        async with Client(self._endpoint, topics=("scan", "status")) as client:
            async for item in client:
                if not isinstance(item, Message):
                    continue
                received = ReceivedMessage(item.timestamp - self._offset_s, item.received_s, item.data)
                (self.scans if item.topic == "scan" else self.statuses).append(received)
                self._changed.set()

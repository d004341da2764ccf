"""Whole daemon in this process, with its published messages, and a check for leaks at the end."""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgpack
import zmq
import zmq.asyncio
from boards import LAYOUT, descriptors, until_ports_are_tried
from patience import PATIENCE_S

from tactiled.array import load_array
from tactiled.daemon.board.session import SessionParams
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.runner import ServedBoard, ServiceParams
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import Service
from tactiled.daemon.zmq.params import PublishParams
from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Header, load_board
from tactiled.recording.session import RecordParams

ARRAY = load_array("wang2019-3x3")
Row = dict[str, Any]


def no_recorder() -> Recorder:
    """Return a recorder without a place to record."""
    return Recorder(RecordParams(), Header(load_board("board-v1", "wang2019-3x3")))


class Daemon:
    """A service with what it published, newest last, by topic."""

    def __init__(self, tmp_path: Path, **session: Any) -> None:
        self.link = tmp_path / "board"
        self.endpoint = f"ipc://{tmp_path}/events.ipc"
        self.params = ServiceParams(
            port=PortParams(url=str(self.link)),
            session=SessionParams(**session),
            publish=PublishParams(endpoints=(self.endpoint,)),
        )
        self.pipeline = Pipeline(LAYOUT, ARRAY)
        self.heard: dict[str, list[Row]] = {}
        self._changed = asyncio.Event()

    def served(self, recorder: Recorder | None = None) -> ServedBoard:
        return ServedBoard(self.params, self.pipeline, recorder or no_recorder())

    def rows(self, topic: str) -> list[Row]:
        return self.heard.get(topic, [])

    @property
    def status(self) -> Row:
        return self.rows("status")[-1]

    async def listen(self) -> None:
        context = zmq.asyncio.Context()
        sub = context.socket(zmq.SUB)
        sub.subscribe("")
        sub.connect(self.endpoint)
        try:
            while True:
                topic, payload = await sub.recv_multipart()
                self.heard.setdefault(topic.decode().rsplit("/", 1)[-1], []).append(msgpack.unpackb(payload))
                self._changed.set()
        finally:
            sub.close(0)
            context.term()

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not condition():
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise AssertionError(f"never: {what}; last status {self.rows('status')[-1:]}") from None

    async def until_state(self, state: str, words: str = "") -> None:
        """Wait for this state, now or later; one that has passed again counts: statuses may come together."""
        first = max(0, len(self.rows("status")) - 1)
        await self.until(
            lambda: any(
                row["state"] == state and words in row["reason"] for row in self.rows("status")[first:]
            ),
            f"{state} {words}",
        )

    async def until_ended(self, n_boards: int = 1) -> None:
        """Wait for the last statuses: they may still be on their way when the service has ended."""

        def has_ended() -> bool:
            newest = {row["board"] if n_boards > 1 else "": row["state"] for row in self.rows("status")}
            return [*newest.values()].count("no-device") >= min(n_boards, len(newest))

        await self.until(has_ended, "the last status")

    async def until_scans(self, n: int = 3) -> None:
        goal = len(self.rows("scan")) + n
        await self.until(lambda: len(self.rows("scan")) >= goal, f"{n} scans")


def play(
    daemon: Daemon, story: Callable[[Service], Awaitable[None]], recorder: Recorder | None = None
) -> None:
    """Run the service beside a story; nothing may be left over."""

    async def main() -> None:
        service = Service([daemon.served(recorder)])
        listening = asyncio.create_task(daemon.listen())
        serving = asyncio.create_task(service.run())
        try:
            await asyncio.sleep(0)
            telling = asyncio.ensure_future(story(service))
            await asyncio.wait([telling, serving], return_when=asyncio.FIRST_COMPLETED)
            if serving.done() and not telling.done():
                telling.cancel()
                await serving
            await telling
        finally:
            service.stop()
            await serving
            await daemon.until_ended()
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    before = descriptors()
    threads = set(threading.enumerate())
    asyncio.run(main())
    until_ports_are_tried()
    assert descriptors() == before
    assert not [t for t in set(threading.enumerate()) - threads if t.is_alive()]

"""Sockets of the daemon in this process, without boards behind them."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from boards import descriptors
from patience import PATIENCE_S

from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.requests import CommandRequest, Requester
from tactiled.events.types import ContactEvent

CONTACT = ContactEvent(time_s=1.0, state="loading", previous="none", taxels=(1, 2), valid=True)


class NetworkAlone:
    """A `Network` with one board, and the commands that reached it, which `finish` answers."""

    serial = "b"

    def __init__(self, finish: Callable[[], str] = lambda: "", **params: Any) -> None:
        self._descriptors = descriptors()
        self._finish = finish
        self.done: list[CommandRequest] = []
        self.requesters: list[Requester] = []
        self.network = Network(PublishParams(**params), [self])

    def settings(self, _: float) -> dict[str, Any]:
        return {"speed_mm_s": 0.0}

    def do(self, request: CommandRequest, requester: Requester, _: float) -> str:
        self.done.append(request)
        self.requesters.append(requester)
        return self._finish()

    def send(self, n: int = 1) -> None:
        for _ in range(n):
            self.network.publisher.send(CONTACT, board="b", unix_offset_s=0.0)

    def run(self, story: Callable[[], Awaitable[None]], patience_s: float = PATIENCE_S) -> None:
        """Play a story beside it; nothing may be left over."""

        async def main() -> None:
            serving = asyncio.create_task(self.network.run())
            try:
                async with asyncio.timeout(patience_s):
                    await story()
                assert not serving.done()
            finally:
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
                self.network.close()
            assert asyncio.all_tasks() == {asyncio.current_task()}

        asyncio.run(main())
        assert descriptors() == self._descriptors

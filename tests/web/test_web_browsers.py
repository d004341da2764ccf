"""Queues of slow browsers."""

import asyncio
from typing import Any

from tactiled.web.browsers import Browser
from tactiled.web.feed import Frames


class SlowSocket:
    """Socket that needs a turn of the loop for each frame, in which three more frames come."""

    closed = False

    def __init__(self) -> None:
        self.browser: Browser | None = None
        self.sent = 0

    async def send_str(self, text: str) -> None:  # noqa: ARG002  the signature of aiohttp
        self.sent += 1
        assert self.sent < 10_000, "never given up"
        assert self.browser is not None
        for _ in range(3):
            self.browser.offer(Frames("event", "scan"))
        await asyncio.sleep(0)


def test_a_browser_that_reads_too_slowly_for_ever_is_given_up() -> None:
    socket: Any = SlowSocket()
    socket.browser = Browser(socket)
    socket.browser.offer(Frames("event", None))
    asyncio.run(socket.browser.send_all())
    assert 400 < socket.sent < 600  # two more wait after each: 1000 of them after 500

"""Connected browsers, each with a bounded queue: a slow one loses frames and delays nobody."""

import asyncio
from collections import deque
from contextlib import suppress

from aiohttp import web

from tactiled.web.feed import Frames

FRAMES_PER_S = 30.0
_LIVE_FRAMES = 15  # half a second: what waits longer would be shown as stale
_KEPT_FRAMES = 1000  # events of minutes; a browser that is further behind connects again and gets the history
_STUCK_S = 10.0  # a laptop that was closed does not read; its connection must not stay for ever


class Browser:
    """Frames that wait for one browser.

    Parameters
    ----------
    socket : web.WebSocketResponse
        Prepared WebSocket.
    """

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self._socket = socket
        self._live: deque[str] = deque()
        self._kept: deque[str] = deque()
        self._filled = asyncio.Event()
        self._dropped = 0

    def offer(self, frames: Frames) -> None:
        """Queue frames; the oldest live frames are dropped where the browser is too slow."""
        if frames.kept is not None:
            self._kept.append(frames.kept)
        if frames.live is not None:
            self._live.append(frames.live)
            if len(self._live) > _LIVE_FRAMES:
                self._live.popleft()
                self._dropped += 1
        self._filled.set()

    async def send_all(self) -> None:
        """Send queued frames until the connection ends or the browser is hopelessly behind."""
        with suppress(ConnectionError, TimeoutError):
            while not self._socket.closed and len(self._kept) <= _KEPT_FRAMES:
                await self._filled.wait()
                self._filled.clear()
                while (self._kept or self._live) and len(self._kept) <= _KEPT_FRAMES:
                    text = self._kept.popleft() if self._kept else self._live.popleft()
                    async with asyncio.timeout(_STUCK_S):
                        await self._socket.send_str(text)
                if self._dropped:
                    async with asyncio.timeout(_STUCK_S):
                        await self._socket.send_str(f'{{"dropped":{self._dropped}}}')
                    self._dropped = 0

"""Connected browsers, each with a bounded queue: a slow one loses frames and delays nobody.

A browser says now and then how many frames it has taken. Live frames are sent while fewer than `_IN_FLIGHT`
are on their way: the buffers of the system would hold seconds of old frames for a slow link otherwise.
"""

import asyncio
from collections import deque
from contextlib import suppress

import msgpack
from aiohttp import web

from tactiled.web.feed import Frames

TURNS_PER_S = 25.0  # a verdict waits 20 ms on average: most of what the server costs is to be woken
TURNS_PER_FRAME = 3  # of a turn without a verdict: a page that draws faster is no easier to read
_LIVE_FRAMES = 2  # 240 ms: what waits longer would be shown as stale
_IN_FLIGHT = 3  # frames of 360 ms, the way to a browser and back
_KEPT_FRAMES = 1000  # events of minutes; a browser that is further behind connects again and gets the history
_STUCK_S = 10.0  # a laptop that was closed does not read; its connection must not stay for ever


class Browser:
    """Frames that wait for one browser."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self.socket = socket
        self._live: deque[bytes] = deque()
        self._kept: deque[bytes] = deque()
        self._sent = self._taken = 0  # frames after the history
        self._filled = asyncio.Event()
        self._dropped = 0

    def forget(self) -> None:
        """Drop the frames that wait: the history, which the browser gets now, has what is in them."""
        self._kept.clear()
        self._live.clear()
        self._dropped = 0

    def offer(self, frames: Frames) -> None:
        """Queue frames; the oldest live frames are dropped where the browser is too slow.

        One that keeps up gets what there is in one frame.
        """
        keeps_up = not self._kept and not self._live and self._in_flight() < _IN_FLIGHT
        is_one = frames.both is not None and keeps_up
        kept = frames.both if is_one else frames.kept
        if kept is not None:
            self._kept.append(kept)
        if frames.live is not None and not is_one:
            self._live.append(frames.live)
            if len(self._live) > _LIVE_FRAMES:
                self._live.popleft()
                self._dropped += 1
        self._wake()

    def answered(self, taken: object) -> None:
        """Note how many frames the browser says it has taken in all; what is no number counts for nothing."""
        if isinstance(taken, str) and taken.isdecimal():
            self._taken = max(self._taken, min(int(taken), self._sent))
            self._wake()

    def _in_flight(self) -> int:
        return self._sent - self._taken

    def _wake(self) -> None:
        """Let `send_all` go on where there is something to send: to wake a task for nothing costs, too."""
        if self._kept or self._live:
            self._filled.set()

    async def send_all(self) -> None:
        """Send queued frames until the connection ends or the browser is hopelessly behind."""
        with suppress(ConnectionError, TimeoutError):
            while not self.socket.closed and len(self._kept) <= _KEPT_FRAMES:
                await self._filled.wait()
                self._filled.clear()
                while len(self._kept) <= _KEPT_FRAMES and (frame := self._next()) is not None:
                    self._sent += 1
                    async with asyncio.timeout(_STUCK_S):
                        await self.socket.send_bytes(frame)

    def _next(self) -> bytes | None:
        """Return the frame to be sent next: events first, then live frames for which there is room."""
        if self._kept:
            return self._kept.popleft()
        if not self._live or self._in_flight() >= _IN_FLIGHT:
            return None
        if self._dropped:
            dropped: bytes = msgpack.packb({"dropped": self._dropped})
            self._dropped = 0
            return dropped
        return self._live.popleft()

"""Bounded number of connections to the page: idle ones make room, and none can use up the descriptors."""

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import cast

from aiohttp import web

# 64 browsers, each with its WebSocket and two requests at once, and room for programs. With what the kernel
# hands over at once (asyncio accepts up to `BACKLOG` before it looks here) this is below the 1024 descriptors
# that a process has by default.
MOST_CONNECTIONS = 256
BACKLOG = 128
IDLE_S = 30.0
"""Longest time without a complete request, and longest time in which a client takes nothing of its answer."""


class Connections:
    """Connections of one server, those without a request under way first to be closed.

    Where `MOST_CONNECTIONS` are open, a new one takes the place of the one whose last request is longest ago,
    so that connections that are held open shut nobody out. It is refused where every connection has a request
    under way. `refused` is called with the address of the client that lost.
    """

    def __init__(self, refused: Callable[[str], None]) -> None:
        self._refused = refused
        self._idle: dict[asyncio.BaseTransport, None] = {}  # in order of their last request
        self._busy: set[asyncio.BaseTransport] = set()

    def protocols(self, make: Callable[[], asyncio.Protocol]) -> Callable[[], asyncio.Protocol]:
        """Return a factory of protocols, for `loop.create_server`, whose connections are counted here."""
        return lambda: _Counted(make(), self)

    def open(self, transport: asyncio.Transport) -> bool:
        """Count a new connection; False where there is no room for it."""
        while len(self._idle) + len(self._busy) >= MOST_CONNECTIONS:
            oldest = cast("asyncio.Transport | None", next(iter(self._idle), None))
            self._refused(_peer(oldest or transport))
            if oldest is None:
                return False
            self.close(oldest)
            oldest.abort()
        self._idle[transport] = None
        return True

    def close(self, transport: asyncio.BaseTransport) -> None:
        """Forget a connection."""
        self._idle.pop(transport, None)
        self._busy.discard(transport)

    @contextlib.contextmanager
    def request(self, request: web.Request) -> Iterator[None]:
        """Keep the connection of a request while it is being answered."""
        transport = request.transport
        if transport is None or transport not in self._idle:  # closed meanwhile
            yield
            return
        del self._idle[transport]
        self._busy.add(transport)
        try:
            yield
        finally:
            if transport in self._busy:
                self._busy.remove(transport)
                self._idle[transport] = None


class _Counted(asyncio.Protocol):
    """Protocol that counts its connection, and hands everything on to another one."""

    def __init__(self, inner: asyncio.Protocol, connections: Connections) -> None:
        self._inner = inner
        self._connections = connections
        self._transport: asyncio.Transport | None = None  # None: refused, or not connected

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        stream = cast(asyncio.Transport, transport)
        if not self._connections.open(stream):
            stream.abort()
            return
        self._transport = stream
        # The kernel closes a connection whose client takes nothing of an answer for so long.
        stream.get_extra_info("socket").setsockopt(
            socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * IDLE_S)
        )
        self._inner.connection_made(stream)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._connections.close(self._transport)
            self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()


def _peer(transport: asyncio.BaseTransport) -> str:
    name = transport.get_extra_info("peername")
    return str(name[0]) if name else "a client that has gone"

"""Metrics page: ``GET /metrics`` over HTTP/1.0 on loopback, served by the daemon's event loop.

The length of a request, the number of connections, the time of each (2 s) and the rate of pages are bounded,
and the data path never waits for any of them.
"""

import asyncio
import logging
import os
import socket
from collections.abc import Callable

from pydantic import Field

from tactiled.daemon.zmq.peers import StepLimit
from tactiled.tomlfile import Params

logger = logging.getLogger(__name__)

_HOST = "127.0.0.1"  # other hosts reach it through a proxy, node_exporter or ssh
_REQUEST_BYTES = 4096  # Prometheus sends some 300
_PATIENCE_S = 2.0  # for request and response together
_CLIENTS = 8  # connections at once; further ones are closed
_PAGES_PER_S = 10.0  # after the first ones: a page takes 0.4 ms for each board, and Prometheus asks each 15 s
_KIND = "text/plain; version=0.0.4; charset=utf-8"


class MetricsParams(Params):
    """Port of the metrics page."""

    port: int = Field(
        default=0,
        ge=0,
        le=65535,
        description="TCP port of this host for http://127.0.0.1:PORT/metrics, such as 9874; 0: off.",
    )


class Exporter:
    """Serve the metrics page at a port other than 0."""

    def __init__(self, params: MetricsParams, text: Callable[[], str]) -> None:
        self._text = text
        self._writers: set[asyncio.StreamWriter] = set()
        self._port = params.port
        self._limit = StepLimit(_PAGES_PER_S)

    async def run(self) -> None:
        """Serve until cancelled, then close all connections; without its port, the daemon senses on."""
        try:
            listening = socket.create_server((_HOST, self._port))
        except OSError as error:
            # The words of `error` have the address too, which this line names already.
            cause = os.strerror(error.errno) if error.errno else str(error)
            logger.error(  # noqa: TRY400  the cause is enough, a traceback would not help
                "no metrics: metrics.port: %s:%d cannot be had (%s); free it (ss -tlnp 'sport = :%d'), and "
                "restart tactiled", _HOST, self._port, cause, self._port,
            )  # fmt: skip
            await asyncio.Event().wait()
            return
        with listening:
            server = await asyncio.start_server(self._serve, sock=listening, limit=_REQUEST_BYTES)
            try:
                await server.serve_forever()
            finally:
                server.close()
                for writer in self._writers:
                    writer.transport.abort()
                while self._writers:
                    await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._writers) >= _CLIENTS:
            writer.transport.abort()
            return
        self._writers.add(writer)
        try:
            async with asyncio.timeout(_PATIENCE_S):
                head = await reader.readuntil(b"\r\n\r\n")
                await self._limit.wait()
                writer.write(self._answer(head.decode(errors="replace")))
                await writer.drain()
                writer.close()
                await writer.wait_closed()
        except (TimeoutError, OSError, EOFError, asyncio.LimitOverrunError):
            pass  # the client was too slow, sent too much, or has closed
        finally:
            writer.transport.abort()
            self._writers.discard(writer)

    def _answer(self, request: str) -> bytes:
        method, _, rest = request.partition("\r\n")[0].partition(" ")
        path = rest.split(" ")[0].split("?")[0]
        if method != "GET":
            return _response("405 Method Not Allowed", "only GET\n")
        if path != "/metrics":
            return _response("404 Not Found", "only /metrics\n")
        return _response("200 OK", self._text())


def _response(status: str, text: str) -> bytes:
    body = text.encode()
    head = f"HTTP/1.0 {status}\r\nContent-Type: {_KIND}\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode() + body

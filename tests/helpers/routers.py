"""Two routers of zenoh in this process, and a line between them that can be cut."""

import asyncio
import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import zenoh


def free_port() -> int:
    """Return a TCP port of loopback that nobody has now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def router(port: int, *connect: int) -> "zenoh.Session":
    """Open a router that listens at a port of loopback and connects to others."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{one}" for one in connect]))
    return zenoh.open(config)


class CuttableLine:
    """TCP relay from a port of its own to another, which can be cut.

    Cut, it closes its connections and accepts none (``close``), or keeps them and carries nothing
    (``silence``), as a cable that was pulled.
    """

    def __init__(self, to_port: int) -> None:
        self.port = free_port()
        self._to_port = to_port
        self._loop = asyncio.new_event_loop()
        self._flows: asyncio.Event
        self._is_cut = False
        self._writers: set[asyncio.StreamWriter] = set()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(self._main()))

    def __enter__(self) -> Self:
        self._thread.start()
        self._ready.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()
        self._loop.close()

    def close(self) -> None:
        """Cut: close the connections."""
        self._loop.call_soon_threadsafe(self._close)

    def silence(self) -> None:
        """Cut: carry nothing, and keep the connections."""
        self._loop.call_soon_threadsafe(self._flows.clear)

    def mend(self) -> None:
        """Carry again."""
        self._loop.call_soon_threadsafe(self._mend)

    async def _main(self) -> None:
        self._flows, self._end = asyncio.Event(), asyncio.Event()
        self._flows.set()
        server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self._ready.set()
        await self._end.wait()
        server.close()
        self._flows.set()
        self._close()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _close(self) -> None:
        self._is_cut = True
        for writer in self._writers:
            writer.transport.abort()

    def _mend(self) -> None:
        self._is_cut = False
        self._flows.set()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._is_cut:
            writer.transport.abort()
            return
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self._to_port)
        except OSError:
            writer.transport.abort()
            return
        ends = (writer, back)
        self._writers.update(ends)
        try:
            await asyncio.gather(self._carry(reader, back), self._carry(there, writer))
        except OSError:
            pass  # an end was closed
        finally:
            for end in ends:
                end.transport.abort()
            self._writers.difference_update(ends)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            await self._flows.wait()
            data = await reader.read(65536)
            if not data:
                writer.transport.abort()
                raise ConnectionResetError
            await self._flows.wait()
            writer.write(data)
            await writer.drain()


@dataclass
class TwoRouters:
    """Ports of two routers, and the line between them.

    Attributes
    ----------
    robots_port : int
        Router of the daemons' side.
    readers_port : int
        Router of the subscribers' side.
    """

    robots_port: int
    readers_port: int
    line: CuttableLine


@contextlib.contextmanager
def two_routers() -> Iterator[TwoRouters]:
    """Two routers of loopback, connected by a line that can be cut."""
    robots_port, readers_port = free_port(), free_port()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.closing(router(robots_port)))
        line = stack.enter_context(CuttableLine(robots_port))
        stack.enter_context(contextlib.closing(router(readers_port, line.port)))
        yield TwoRouters(robots_port, readers_port, line)

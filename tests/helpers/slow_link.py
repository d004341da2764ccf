"""Slow link between a browser and a page server, which counts what the browser gets."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

_PIECE = 2048
_BUFFER = 8192  # of the sockets, so that no second of a slow link is hidden in them


@dataclass
class Link:
    """Address of the page by this link, and how many bytes browsers have received."""

    url: str
    received: int = 0


@contextmanager
def slow_link(url: str, bytes_s: float) -> Iterator[Link]:
    """Forward connections to the server of a page, with at most `bytes_s` bytes a second to each browser."""
    loop = asyncio.new_event_loop()
    counted = Link("")
    target = urlsplit(url)
    tasks: set[asyncio.Task[None]] = set()

    async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, is_slow: bool) -> None:
        try:
            while piece := await reader.read(_PIECE):
                writer.write(piece)
                await writer.drain()
                if is_slow:
                    counted.received += len(piece)
                    await asyncio.sleep(len(piece) / bytes_s)
        except ConnectionError:
            pass
        finally:
            writer.close()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        server = await asyncio.open_connection(target.hostname, target.port, limit=_BUFFER)
        for way in (forward(reader, server[1], False), forward(server[0], writer, True)):
            task = asyncio.ensure_future(way)
            tasks.add(task)
            task.add_done_callback(tasks.discard)

    async def listen() -> asyncio.Server:
        listener = await asyncio.start_server(accept, "127.0.0.1", 0, limit=_BUFFER)
        counted.url = url.replace(f":{target.port}", f":{listener.sockets[0].getsockname()[1]}", 1)
        return listener

    async def end(listener: asyncio.Server) -> None:
        listener.close()
        for task in tuple(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        listener = asyncio.run_coroutine_threadsafe(listen(), loop).result()
        try:
            yield counted
        finally:
            asyncio.run_coroutine_threadsafe(end(listener), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

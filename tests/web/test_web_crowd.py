"""Many browsers at one page server, some of them slow, and a storm of reloads; clients without a browser."""

import asyncio
import contextlib
import json
import socket
from typing import Any

import aiohttp
import pytest
from frames import unpack
from pages import Robot
from patience import PATIENCE_S

from tactiled.client import Commander

pytestmark = pytest.mark.system
BROWSERS = 50
MARKS = 20


class Visitor:
    """Client that notes what a page would show."""

    def __init__(self) -> None:
        self.scans: list[dict[str, Any]] = []
        self.marks: list[str] = []

    async def watch(self, session: aiohttp.ClientSession, url: str) -> None:
        with contextlib.suppress(ConnectionError):  # closed between a frame and its answer
            async with session.ws_connect(url + "api/live", max_msg_size=0) as live:
                n_taken = -1  # the history is not counted
                async for message in live:
                    self.note(unpack(message.data))
                    n_taken += 1
                    await live.send_str(f"{n_taken}")

    def note(self, frame: dict[str, Any]) -> None:
        for _, topic, data, _ in frame.get("m", ()):
            if topic == "scan":
                self.scans.append(data)
            elif topic == "command":
                self.marks.append(json.loads(data["arguments"])["text"])


async def until(condition: Any) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.02)


def stuck_reader(url: str) -> socket.socket:
    """Connection that asks for frames and never reads them."""
    host, _, port = url.removeprefix("http://").rstrip("/").partition(":")
    connected = socket.create_connection((host, int(port)))
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connected.sendall(
        f"GET /api/live HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    return connected


async def send_marks(live: Robot) -> None:
    def send() -> None:
        with Commander(live.endpoint, "test") as daemon:
            for n in range(MARKS):
                assert daemon.send("mark", timeout_s=PATIENCE_S, text=f"mark {n}").ok

    await asyncio.to_thread(send)


def test_fifty_browsers_get_every_event_though_one_never_reads(live: Robot) -> None:
    url = live.serve()

    async def main() -> None:
        visitors = [Visitor() for _ in range(BROWSERS)]
        with stuck_reader(url):
            async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
                watching = [asyncio.create_task(visitor.watch(session, url)) for visitor in visitors]
                await until(lambda: all(visitor.scans for visitor in visitors))
                for visitor in visitors:
                    visitor.marks.clear()  # a page gets the newest one of before
                await send_marks(live)
                await until(lambda: all(len(visitor.marks) == MARKS for visitor in visitors))
                for task in watching:
                    task.cancel()
                await asyncio.gather(*watching, return_exceptions=True)
        for visitor in visitors:
            assert visitor.marks == [f"mark {n}" for n in range(MARKS)]
            instants = [scan["timestamp"] for scan in visitor.scans]
            assert instants == sorted(instants)

    asyncio.run(main())
    assert live.stop("web") == 0
    assert "Traceback" not in live.words("web")


def test_reloads_in_a_storm_cost_the_others_nothing(live: Robot) -> None:
    url = live.serve()

    async def main() -> None:
        visitor = Visitor()
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
            watching = asyncio.create_task(visitor.watch(session, url))
            await until(lambda: len(visitor.scans) > 100)
            visitor.marks.clear()

            async def reload() -> None:
                for path in ("", "static/app.js", "api/session"):
                    async with session.get(url + path) as answer:
                        assert answer.status == 200
                with contextlib.suppress(aiohttp.WSServerHandshakeError):  # the bound of browsers
                    socket = await session.ws_connect(url + "api/live", max_msg_size=0)
                    await socket.receive()
                    await socket.close()

            storm = asyncio.gather(*(reload() for _ in range(200)))
            await send_marks(live)
            await storm
            await until(lambda: len(visitor.marks) == MARKS)
            seen = len(visitor.scans)
            await until(lambda: len(visitor.scans) > seen + 100)
            watching.cancel()
            await asyncio.gather(watching, return_exceptions=True)

    asyncio.run(main())
    assert live.stop("web") == 0
    assert "Traceback" not in live.words("web")

"""Page server in this process, for requests without a browser."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, NamedTuple

import aiohttp
from yarl import URL

from tactiled.web.server import Listening, PageServer

Act = Callable[[aiohttp.ClientSession, str], Awaitable[None]]


class Answer(NamedTuple):
    """What a server answered."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


def serve_page(params: Listening, act: Act) -> None:
    """Run a server, and act on it with its address."""

    async def main() -> None:
        stop, address = asyncio.Event(), asyncio.get_running_loop().create_future()
        serving = asyncio.create_task(PageServer(params).run(address.set_result, stop))
        try:
            async with aiohttp.ClientSession() as session:
                await act(session, await address)
        finally:
            stop.set()
            await serving

    asyncio.run(main())


def answers(params: Listening, *asked: tuple[str, str], **options: Any) -> list[Answer]:
    """Ask a server by methods and paths, with the same headers or body for all."""
    found = []

    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for method, path in asked:
            async with session.request(method, URL(url + path, encoded=True), **options) as answer:
                found.append(Answer(answer.status, answer.headers.copy(), await answer.read()))

    serve_page(params, act)
    return found

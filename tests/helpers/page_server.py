"""Page server in this process, for requests without a browser."""

import asyncio
from collections.abc import Awaitable, Callable

import aiohttp

from tactiled.web.server import Listening, PageServer

Act = Callable[[aiohttp.ClientSession, str], Awaitable[None]]


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

"""Clients of a page server that read every frame: ``visitors.py URL NUMBER``, until killed."""

import asyncio
import sys

import aiohttp


async def main(url: str, number: int) -> None:
    """Connect all clients, say so on stdout, and read."""
    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        sockets = [await session.ws_connect(url + "api/live", max_msg_size=0) for _ in range(number)]
        print("connected", flush=True)
        await asyncio.gather(*(_read(socket) for socket in sockets))


async def _read(socket: aiohttp.ClientWebSocketResponse) -> None:
    async for _ in socket:
        pass


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))

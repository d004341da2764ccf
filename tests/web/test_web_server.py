"""Requests to the page server, without a browser."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from tactiled.errors import UnavailableError
from tactiled.web.guard import Guard
from tactiled.web.server import MOST_BROWSERS, Listening, PageServer, run_web

TOKEN = "0123456789abcdef"
Act = Callable[[aiohttp.ClientSession, str], Awaitable[None]]


def serve(tmp_path: Path, act: Act, token: str = "") -> None:
    """Run a server on a daemon that does not exist, and act on it."""

    async def main() -> None:
        stop, address = asyncio.Event(), asyncio.get_running_loop().create_future()
        params = Listening([f"ipc://{tmp_path}/events.ipc"], port=0, guard=Guard(token))
        serving = asyncio.create_task(PageServer(params).run(address.set_result, stop))
        try:
            async with aiohttp.ClientSession() as session:
                await act(session, await address)
        finally:
            stop.set()
            await serving

    asyncio.run(main())


def test_every_answer_forbids_scripts_of_others(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for path in (
            "",
            "static/app.js",
            "static/uplot/uPlot.esm.js",
            "api/session",
            "nothing",
            "static/../server.py",
        ):
            async with session.get(url + path) as answer:
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"], path
                assert "unsafe" not in answer.headers["Content-Security-Policy"]
                assert answer.status == (404 if path.startswith(("nothing", "static/..")) else 200)

    serve(tmp_path, act)


def test_another_host_name_or_origin_reads_nothing(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
            for path in ("", "api/session", "api/live"):
                async with session.get(url + path, headers=headers) as answer:
                    assert answer.status == 403

    serve(tmp_path, act)


@pytest.mark.parametrize("token", ["", TOKEN])
def test_commands_without_the_token_are_refused(tmp_path: Path, token: str) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for headers in ({}, {"Authorization": "Bearer wrong"}):
            async with session.get(url + "api/session", headers=headers) as answer:
                assert (await answer.json())["commands"] is False
            async with session.post(url + "api/command", json={"do": "tare"}, headers=headers) as answer:
                assert (answer.status, (await answer.json())["ok"]) == (403, False)

    serve(tmp_path, act, token)


def test_a_command_must_be_json_of_this_origin_and_small(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        good = {"Authorization": f"Bearer {TOKEN}"}

        async def status(headers: dict[str, str], **content: Any) -> int:
            async with session.post(url + "api/command", headers={**good, **headers}, **content) as answer:
                return answer.status

        assert await status({"Origin": "http://evil.example"}, json={"do": "tare"}) == 403
        assert await status({"Content-Type": "text/plain"}, data=json.dumps({"do": "tare"})) == 415
        assert await status({"Content-Type": "application/json"}, data="{") == 400
        assert await status({}, json={"do": "reboot"}) == 400
        assert await status({}, json={"do": "mark", "fields": {"text": "x" * 20_000}}) == 413

    serve(tmp_path, act, TOKEN)


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 16_000,
        b"\xff",
        b'{"do": "mark", "fields": {"text": "\\ud800"}}',
        b'{"do": "speed", "fields": {"speed_mm_s": ' + b"9" * 400 + b"}}",
    ],
)
def test_what_json_cannot_mean_is_refused(tmp_path: Path, body: bytes) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json; charset=none"}
        async with session.post(url + "api/command", headers=headers, data=body) as answer:
            assert answer.status == 400
            assert (await answer.json())["ok"] is False

    serve(tmp_path, act, TOKEN)


def test_browsers_are_bounded_and_leave_nothing(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        sockets = [await session.ws_connect(url + "api/live") for _ in range(MOST_BROWSERS)]
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url + "api/live")
        assert refused.value.status == 503
        for socket in sockets:
            assert json.loads((await socket.receive()).data)["m"] == []
            await socket.close()
        async with asyncio.timeout(10):
            while True:
                try:
                    await (await session.ws_connect(url + "api/live")).close()
                    break
                except aiohttp.WSServerHandshakeError:
                    await asyncio.sleep(0.01)

    serve(tmp_path, act)


def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:  # noqa: ARG001
        params = Listening([], port=int(url.rstrip("/").rsplit(":", 1)[1]))
        with pytest.raises(UnavailableError, match="cannot be served"):
            await PageServer(params).run(lambda _: None, asyncio.Event())

    serve(tmp_path, act)


def test_an_address_of_another_host_is_refused() -> None:
    with pytest.raises(UnavailableError, match="cannot be served"):
        run_web(Listening([], host="192.0.2.1", port=0), lambda _: None)

"""Requests to the page server, without a browser."""

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from unittest.mock import ANY
from urllib.parse import urlsplit

import aiohttp
import pytest
from frames import rows
from page_server import Act, answers, serve_page
from patience import PATIENCE_S

from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.errors import UnavailableError
from tactiled.web import server
from tactiled.web.connections import IDLE_S, MOST_CONNECTIONS
from tactiled.web.guard import Guard
from tactiled.web.server import MOST_BROWSERS, Listening, PageServer, run_web

TOKEN = "0123456789abcdef"


def listening(tmp_path: Path, token: str = "") -> Listening:
    """Server of a daemon that does not exist."""
    return Listening([f"ipc://{tmp_path}/events.ipc"], port=0, guard=Guard(token))


def serve(tmp_path: Path, act: Act, token: str = "") -> None:
    serve_page(listening(tmp_path, token), act)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("", 200),
        ("static/app.js", 200),
        ("static/uplot/uPlot.esm.js", 200),
        ("api/session", 200),
        ("nothing", 404),
    ]
    + [
        (f"static/{name}", 404)
        for name in ("../server.py", "a" * 300, "%2e%2e/server.py", "..%2fserver.py", "uplot", "%00", "%ff")
    ],
)
def test_every_answer_forbids_scripts_of_others_and_only_the_files_of_the_page_are_served(
    tmp_path: Path, path: str, status: int, caplog: pytest.LogCaptureFixture
) -> None:
    (answer,) = answers(listening(tmp_path), ("GET", path))
    assert answer.status == status
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert "unsafe" not in answer.headers["Content-Security-Policy"]
    assert not caplog.records


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}])
def test_another_host_name_or_origin_reads_nothing(tmp_path: Path, headers: dict[str, str]) -> None:
    found = answers(
        listening(tmp_path), ("GET", ""), ("GET", "api/session"), ("GET", "api/live"), headers=headers
    )
    assert [answer.status for answer in found] == [403] * 3


@pytest.mark.parametrize("token", ["", TOKEN])
@pytest.mark.parametrize("headers", [{}, {"Authorization": "Bearer wrong"}])
def test_commands_without_the_token_are_refused(tmp_path: Path, token: str, headers: dict[str, str]) -> None:
    asked = ("GET", "api/session"), ("POST", "api/command")
    session, command = answers(listening(tmp_path, token), *asked, json={"do": "tare"}, headers=headers)
    assert session.json["commands"] is False
    assert (command.status, command.json["ok"]) == (403, False)


JSON = {"Content-Type": "application/json; charset=none"}


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        (JSON | {"Origin": "http://evil.example"}, b'{"do": "tare"}', 403),
        ({"Content-Type": "text/plain"}, b'{"do": "tare"}', 415),
        (JSON, b"{", 400),
        (JSON, b'{"do": "reboot"}', 400),
        (JSON, b'{"do": "mark", "fields": {"text": "' + b"x" * 20_000 + b'"}}', 413),
        # What JSON cannot mean.
        (JSON, b"[" * 16_000, 400),
        (JSON, b"\xff", 400),
        (JSON, b'{"do": "mark", "fields": {"text": "\\ud800"}}', 400),
        (JSON, b'{"do": "speed", "fields": {"speed_mm_s": ' + b"9" * 400 + b"}}", 400),
        # What no message holds: the command is refused before it is sent.
        (JSON, b'{"do": "thresholds", "fields": {"values": {"x": 18446744073709551616}}}', 200),
        (JSON, b'{"do": "thresholds", "fields": {"values": {"x": -9223372036854775809}}}', 200),
    ],
)
def test_a_command_must_be_json_of_this_origin_small_and_meant(
    tmp_path: Path, headers: dict[str, str], body: bytes, status: int, caplog: pytest.LogCaptureFixture
) -> None:
    headers = headers | {"Authorization": f"Bearer {TOKEN}"}
    (answer,) = answers(listening(tmp_path, TOKEN), ("POST", "api/command"), headers=headers, data=body)
    assert answer.status == status
    assert status == 413 or answer.json["ok"] is False
    assert status != 200 or "beyond 64 bits" in answer.json["reason"]
    assert not caplog.records


def test_a_file_is_packed_for_who_asks_and_sent_once(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        file = url + "static/uplot/uPlot.esm.js"
        body = (server.STATIC / "uplot" / "uPlot.esm.js").read_bytes()
        async with session.get(file, headers={"Accept-Encoding": "identity"}) as plain:
            assert await plain.read() == body
            assert "Content-Encoding" not in plain.headers
        async with session.get(file, headers={"Accept-Encoding": "gzip"}) as packed:
            assert int(packed.headers["Content-Length"]) < 0.4 * len(body)
            assert await packed.read() == body
            assert packed.content_type == "text/javascript"
        async with session.get(file, headers={"If-None-Match": packed.headers["ETag"]}) as known:
            assert (known.status, await known.read()) == (304, b"")

    serve(tmp_path, act)


def test_the_page_offers_the_settings_of_the_detectors() -> None:
    html = (server.STATIC / "index.html").read_text()
    offered = re.findall(r'<option value="([\d.]+) ([\d.]+)"[^>]*>(\w+)', html)
    assert {name: (float(incipient), float(gross)) for incipient, gross, name in offered} == {
        name: (at.incipient, at.gross) for name, at in SETTINGS.items()
    }


def tuning(board: str = "") -> dict[str, Any]:
    return {"do": "tune", "board": board, "fields": {"quiet_s": 5, "motion_s": 5, "array": "--help"}}


def test_one_person_is_guided_at_a_time_and_only_with_the_token(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        async def ask(body: dict[str, Any], token: str = TOKEN) -> tuple[int, list[dict[str, Any]]]:
            headers = {"Authorization": f"Bearer {token}"}
            async with session.post(url + "api/command", json=body, headers=headers) as answer:
                return answer.status, [json.loads(line) for line in (await answer.text()).splitlines()]

        assert (await ask(tuning(), "wrong"))[0] == 403
        assert (await ask({"do": "tune", "fields": {"motion": "a.mcap"}}))[0] == 400
        # Nothing that a browser sends is taken for an option.
        (status, lines), (refused, _) = sorted(
            await asyncio.gather(*(ask(tuning("--help")) for _ in range(2)))
        )
        assert (status, refused) == (200, 409)
        assert lines[-1]["ok"] is False
        assert lines[-1]["reason"].startswith("no board at ipc://")  # after 5 s
        assert {} in lines  # signs of life

    serve(tmp_path, act, TOKEN)


def test_a_record_is_fitted_only_with_the_token_and_to_what_was_recorded(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        async def send(query: str, token: str = TOKEN) -> tuple[int, str]:
            headers = {"Authorization": f"Bearer {token}"}
            body = b"time_s,fz_n\n" * 10_000  # more than a command may have
            async with session.post(f"{url}api/calibration?{query}", data=body, headers=headers) as answer:
                return answer.status, (await answer.json())["reason"]

        assert (await send("name=mine&log=0", "wrong"))[0] == 403
        assert await send("name=../mine&log=0") == (400, ANY)
        assert await send("name=mine&log=0") == (409, "its readings are no longer here: record again")
        asked = {"do": "calibrate", "fields": {"array": "/etc/passwd", "guide_s": 5}}
        headers = {"Authorization": f"Bearer {TOKEN}"}
        async with session.post(url + "api/command", json=asked, headers=headers) as answer:
            reason = json.loads(await answer.text())["reason"]
            assert reason.startswith("the board has not said which array it has")

    serve(tmp_path, act, TOKEN)


def test_browsers_are_bounded_and_leave_nothing(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        sockets = [await session.ws_connect(url + "api/live") for _ in range(MOST_BROWSERS)]
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url + "api/live")
        assert refused.value.status == 503
        for socket in sockets:
            assert rows((await socket.receive()).data) == []
            await socket.close()
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    await (await session.ws_connect(url + "api/live")).close()
                    break
                except aiohttp.WSServerHandshakeError:
                    await asyncio.sleep(0.01)

    serve(tmp_path, act)


def test_two_of_three_turns_are_for_verdicts_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What else has arrived waits for the next frame: reading it costs more than a turn."""
    asked: list[frozenset[str]] = []

    class Noting(contextlib.AbstractContextManager["Noting"]):
        """Subscription to which nothing comes."""

        def __init__(self, *_: object, **__: object) -> None:
            pass

        def __exit__(self, *_: object) -> None:
            pass

        def arrived(self, _most: int, _newest_of: frozenset[str], only_with: frozenset[str]) -> list[object]:
            asked.append(only_with)
            return []

    async def act(_session: aiohttp.ClientSession, _url: str) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(asked) < 9:
                await asyncio.sleep(0.01)

    monkeypatch.setattr(server, "Subscription", Noting)
    serve(tmp_path, act)
    assert asked[:9:3] == [frozenset()] * 3
    assert all({"slip", "contact"} <= topics for topics in (*asked[1:9:3], *asked[2:9:3]))


def test_an_address_that_cannot_be_had_is_one_line(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:  # noqa: ARG001
        params = Listening([], port=int(url.rstrip("/").rsplit(":", 1)[1]))
        with pytest.raises(UnavailableError, match="cannot be served"):
            await PageServer(params).run(lambda _: None, asyncio.Event())

    serve(tmp_path, act)
    with pytest.raises(UnavailableError, match="cannot be served"):
        run_web(Listening([], host="192.0.2.1", port=0), lambda _: None)  # an address of another host


@contextlib.asynccontextmanager
async def raw(url: str) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    parts = urlsplit(url)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def test_idle_connections_make_room_for_those_that_ask(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        async with session.ws_connect(url + "api/live") as live, contextlib.AsyncExitStack() as stack:
            held = [await stack.enter_async_context(raw(url)) for _ in range(MOST_CONNECTIONS + 50)]
            async with session.get(url) as answer:
                assert answer.status == 200
            # The first to come have gone; the WebSocket and those that came last stay.
            async with asyncio.timeout(PATIENCE_S):
                for reader, _ in held[:50]:
                    with contextlib.suppress(ConnectionError):
                        assert await reader.read() == b""
            assert not held[-1][0].at_eof()
            assert not live.closed

    serve(tmp_path, act)
    lines = [record.getMessage() for record in caplog.records]
    assert lines == ["127.0.0.1: an idle connection was closed, because as many as are allowed are open"]


def test_where_all_connections_are_busy_a_new_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactiled.web.connections.MOST_CONNECTIONS", 3)

    async def act(session: aiohttp.ClientSession, url: str) -> None:
        sockets = [await session.ws_connect(url + "api/live") for _ in range(3)]
        with pytest.raises(aiohttp.ClientConnectionError):
            await session.get(url)
        for socket in sockets:
            assert not socket.closed
            await socket.close()

    serve(tmp_path, act)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (b"", b""),
        (b"GET / HTTP/1.1\r\nHost: localh", b""),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"HTTP/1.1 200"),
    ],
)
def test_a_connection_without_a_complete_request_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: bytes, expected: bytes
) -> None:
    assert IDLE_S == 30.0
    monkeypatch.setattr(server, "IDLE_S", 0.2)

    async def act(session: aiohttp.ClientSession, url: str) -> None:  # noqa: ARG001
        async with raw(url) as (reader, writer), asyncio.timeout(PATIENCE_S):
            writer.write(sent)
            assert (await reader.read()).startswith(expected)  # and closed

    serve(tmp_path, act)


def test_a_command_that_never_ends_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "IDLE_S", 0.2)

    async def act(session: aiohttp.ClientSession, url: str) -> None:  # noqa: ARG001
        head = f"POST /api/command HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n"
        async with raw(url) as (reader, writer), asyncio.timeout(PATIENCE_S):
            writer.write(f"{head}Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{{".encode())
            assert (await reader.read()).startswith(b"HTTP/1.1 408")  # and closed

    serve(tmp_path, act, TOKEN)


def test_frames_are_compressed_for_who_asks(tmp_path: Path) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for asks in (0, 15):
            socket = await session.ws_connect(url + "api/live", compress=asks)
            assert bool(socket.compress) is bool(asks)
            assert rows((await socket.receive()).data) == []
            await socket.close()

    serve(tmp_path, act)


def test_requests_that_are_no_http_are_counted_in_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        for _ in range(100):
            async with raw(url) as (reader, writer):
                writer.write(b"GET / HTTP/1.1\r\nA\x00: b\r\n\r\n")
                assert b" 400 " in await reader.readline()
        async with session.get(url) as answer:
            assert answer.status == 200

    serve(tmp_path, act)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("Error handling request from 127.0.0.1: ")
    assert "\n" not in line


def test_failed_accepts_are_counted_in_the_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def act(session: aiohttp.ClientSession, url: str) -> None:
        error = OSError(24, "Too many open files")
        for _ in range(1000):  # as asyncio does for each connection that it cannot accept
            what = {"message": "socket.accept() out of system resource", "exception": error}
            asyncio.get_running_loop().call_exception_handler(what)
        async with session.get(url) as answer:
            assert answer.status == 200

    serve(tmp_path, act)
    (record,) = caplog.records
    assert record.getMessage().startswith("socket.accept() out of system resource: OSError: ")
    assert record.exc_info is None

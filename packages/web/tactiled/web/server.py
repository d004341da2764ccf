"""HTTP server of the live page: static files, one WebSocket for each browser, commands, replay.

The server is a process of its own and a client of the daemon: browsers cannot delay the daemon.
"""

import asyncio
import contextlib
import gzip
import hashlib
import itertools
import logging
import signal
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aiohttp import WSCloseCode, web

from tactiled.array import Array
from tactiled.client import Subscription
from tactiled.errors import DataError, UnavailableError
from tactiled.limited_log import RateLimitedLog, limit_rate_of
from tactiled.version import __version__
from tactiled.web.browsers import TURNS_PER_FRAME, TURNS_PER_S, Browser
from tactiled.web.commands import GUIDED, DaemonCommands, check_request
from tactiled.web.connections import BACKLOG, IDLE_S, Connections
from tactiled.web.feed import NEWEST_ALONE, URGENT, Feed
from tactiled.web.guard import Guard
from tactiled.web.guided import GuidedVerbs
from tactiled.web.recordings import RecordingFolder, RecordingRoutes, answer
from tactiled.web.replay import ReplayFile

logger = logging.getLogger(__name__)

STATIC = Path(__file__).parent / "static"
MOST_BROWSERS = 64
_MOST_MESSAGES = 500  # of one endpoint in a frame, some 20 ms: more wait for the next frame
_LARGEST_REQUEST_BYTES = 16 * 1024  # as the daemon's own limit for a request
_LINGERING_S = 1.0  # for the rest of a request that was refused before its end
_SETTINGS_S = 1.0  # interval at which a daemon is asked for its settings, which other clients change as well
_LOGGERS = ("aiohttp.server", "aiohttp.web", "asyncio")  # which write about connections and requests
_HEADERS = {
    # No inline script and no inline style, nothing from elsewhere, and nobody may frame the buttons.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",  # a page of another version than its server would misread the frames
}

# Types of the files of the page; the tables of the host may have others, with which a browser runs no module.
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    "": "text/plain",  # the licence of uPlot
}

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True)
class Listening:
    """Endpoints to serve, and the address of the page."""

    endpoints: Sequence[str]  # of events; empty with a recording
    host: str = "127.0.0.1"
    port: int = 8765  # 0 takes a free one
    arrays: Mapping[str, Array] = field(default_factory=dict)  # those that do not ship, by their files
    keys: Path | None = None  # key file of this client, for daemons of other hosts
    guard: Guard = field(default_factory=Guard)
    replay: ReplayFile | None = None  # recording to show instead of live boards
    recordings: Path | None = None  # directory of recordings that the page lists and opens


@dataclass(frozen=True)
class StaticFile:
    """One file of the page."""

    content_type: str
    etag: str  # changes with the content
    body: bytes
    packed: bytes  # the same by gzip

    def answer(self, request: web.Request) -> web.Response:
        """Return the file, compressed where the client accepts that; 304 where the client has it already."""
        headers = {"ETag": f'"{self.etag}"', "Vary": "Accept-Encoding"}
        if any(known.value == self.etag for known in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        body = self.body
        if "gzip" in request.headers.get("Accept-Encoding", ""):
            body, headers["Content-Encoding"] = self.packed, "gzip"
        charset = "utf-8" if self.content_type.startswith("text/") else None
        return web.Response(body=body, content_type=self.content_type, charset=charset, headers=headers)


def read_static(folder: Path) -> Mapping[str, StaticFile]:
    """Return the files of a folder by their names below it; files of other types than ours are not served."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in _TYPES:
            body = path.read_bytes()
            etag = hashlib.sha256(body).hexdigest()
            file = StaticFile(_TYPES[path.suffix], etag, body, gzip.compress(body, mtime=0))
            found[path.relative_to(folder).as_posix()] = file
    return found


class PageServer:
    """Subscriptions, browsers and routes of one server."""

    def __init__(self, params: Listening) -> None:
        self._params = params
        arrays = [*params.arrays.values()]
        self._feed = Feed(arrays)
        self._browsers: set[Browser] = set()
        self._commands = [DaemonCommands(endpoint, params.keys) for endpoint in params.endpoints]
        files = {array.name: file for file, array in params.arrays.items()}
        self._guided = GuidedVerbs(params.endpoints, files, params.keys)
        self._static = read_static(STATIC)
        etags = "".join(file.etag for file in self._static.values())
        self._page_version = hashlib.sha256(etags.encode()).hexdigest()
        self._log = RateLimitedLog(logger)
        self._connections = Connections(self._crowded)
        self._settings: dict[tuple[int, str], dict[str, Any]] = {}
        folder = None if params.recordings is None else RecordingFolder(params.recordings, arrays)
        self._recordings = RecordingRoutes(folder, params.replay)

    def application(self) -> web.Application:
        """Return the routes."""
        app = web.Application(middlewares=[self._guarded], client_max_size=_LARGEST_REQUEST_BYTES)
        app.router.add_get("/", self._page)
        app.router.add_get("/api/session", self._session)
        app.router.add_get("/api/live", self._live)
        app.router.add_post("/api/command", self._command)
        app.router.add_post("/api/calibration", self._calibration)
        app.router.add_get("/static/{name:.*}", self._file)
        self._recordings.add_to(app)
        return app

    async def run(self, ready: Callable[[str], None], stop: asyncio.Event) -> None:
        """Serve until `stop` is set; `ready` is called with the address of the page.

        `UnavailableError` where the port is in use, or the address is none of this host.
        """
        runner = web.AppRunner(
            self.application(),
            access_log=None,
            shutdown_timeout=1.0,
            keepalive_timeout=IDLE_S,
            lingering_time=_LINGERING_S,
        )
        async with contextlib.AsyncExitStack() as stack:
            stack.enter_context(limit_rate_of(_LOGGERS, self._log))
            await runner.setup()
            stack.push_async_callback(runner.cleanup)
            assert runner.server is not None  # made by setup
            try:
                listener = await asyncio.get_running_loop().create_server(
                    self._connections.protocols(runner.server),
                    self._params.host,
                    self._params.port,
                    backlog=BACKLOG,
                )
            except OSError as error:
                where = f"{self._params.host}:{self._params.port}"
                words = f"{where}: the page cannot be served there: {error.strerror}"
                raise UnavailableError(words) from None
            stack.callback(listener.close)
            stack.callback(self._guided.close)
            for commands in self._commands:
                stack.callback(commands.close)
            stack.push_async_callback(self._leave)
            subscriptions = [
                stack.enter_context(Subscription(endpoint, keys=self._params.keys))
                for endpoint in self._params.endpoints
            ]
            host, port = listener.sockets[0].getsockname()[:2]
            ready(f"http://{f'[{host}]' if ':' in host else host}:{port}/")
            async with asyncio.TaskGroup() as tasks:
                running = [tasks.create_task(self._flush(subscriptions))]
                if self._params.guard.allows_commands:
                    running.append(tasks.create_task(self._follow_settings()))
                await stop.wait()
                for task in running:
                    task.cancel()

    async def _leave(self) -> None:
        """Close the connections of the browsers that answer."""
        closing = [browser.socket.close(code=WSCloseCode.GOING_AWAY) for browser in self._browsers]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                await asyncio.gather(*closing)

    async def _flush(self, subscriptions: Sequence[Subscription]) -> None:
        """Send frames to all browsers: in every third turn, and in the others where a verdict has come.

        What has arrived is read at once: waiting for single messages in asyncio takes more processor time.
        """
        for turn in itertools.count():
            await asyncio.sleep(1 / TURNS_PER_S)
            only_with = frozenset() if turn % TURNS_PER_FRAME == 0 else URGENT
            items = [
                (source, item)
                for source, subscription in enumerate(subscriptions)
                for item in subscription.arrived(_MOST_MESSAGES, NEWEST_ALONE, only_with)
            ]
            if only_with and not items:
                continue
            for source, item in items:
                self._feed.take(source, item)
            frames = self._feed.frames(time.time(), time.monotonic())
            for browser in self._browsers:
                browser.offer(frames)
            self._log.write_counts(time.monotonic())

    async def _follow_settings(self) -> None:
        """Ask the daemons for their settings, so that the buttons of the browsers show them."""
        while True:
            await asyncio.sleep(_SETTINGS_S)
            for source, board in self._feed.boards() if self._browsers else ():
                await self._ask_settings(source, board)

    async def _ask_settings(self, source: int, board: str) -> None:
        found = await self._commands[source].settings(board)
        if found is not None and found != self._settings.get((source, board)):
            self._settings[source, board] = found
            self._feed.add(source, "settings", found)

    def _crowded(self, address: str) -> None:
        reason = f"{address}: an idle connection was closed, because as many as are allowed are open"
        self._log.add(reason, time.monotonic(), kind="crowded")

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        guard = self._params.guard
        origin = request.headers.get("Origin")
        refusal = guard.refuse_host(request.host) or guard.refuse_origin(origin, request.host)
        with self._connections.request(request):
            try:
                response = answer(403, refusal) if refusal else await handler(request)
            except web.HTTPException as error:
                error.headers.update(_HEADERS)
                raise
        if not response.prepared:
            response.headers.update(_HEADERS)
        return response

    async def _page(self, request: web.Request) -> web.StreamResponse:
        return self._static["index.html"].answer(request)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        file = self._static.get(request.match_info["name"])
        return answer(404, "there is no such file") if file is None else file.answer(request)

    async def _session(self, request: web.Request) -> web.StreamResponse:
        """Describe this server to the page. `commands` is true only with the right token."""
        try:
            replay = await self._recordings.chosen(request)
        except DataError as error:
            return answer(404, str(error))
        session = {
            "version": __version__,
            "page": self._page_version,  # a tab with another one, from before an upgrade, loads itself anew
            "endpoints": list(self._params.endpoints),
            "commands": not self._refuse(request) and replay is None,
            "replay": None if replay is None else replay.summary(),
            "recordings": self._params.recordings is not None,
        }
        return web.json_response(session)

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if len(self._browsers) >= MOST_BROWSERS:
            return answer(503, f"{MOST_BROWSERS} browsers are connected, which is the most")
        socket = web.WebSocketResponse(heartbeat=10.0, compress=True, max_msg_size=1024)
        socket.headers.update(_HEADERS)
        browser = Browser(socket)
        self._browsers.add(browser)  # before any wait, so that the limit holds
        try:
            await socket.prepare(request)
            browser.forget()
            await socket.send_bytes(self._feed.history(time.time(), time.monotonic()))
            sending = asyncio.create_task(self._send(browser))
            try:
                async for message in socket:
                    browser.answered(message.data)
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)
        except ConnectionError:
            pass  # closed while the history was being sent
        finally:
            self._browsers.discard(browser)
        return socket

    @staticmethod
    async def _send(browser: Browser) -> None:
        await browser.send_all()
        with contextlib.suppress(TimeoutError, ConnectionError):
            async with asyncio.timeout(1.0):
                await browser.socket.close(code=WSCloseCode.TRY_AGAIN_LATER)

    def _refuse(self, request: web.Request) -> str:
        return self._params.guard.refuse_command(request.headers.get("Authorization"))

    async def _command(self, request: web.Request) -> web.StreamResponse:
        if refusal := self._refuse(request):
            return answer(403, refusal)
        if request.content_type != "application/json":
            return answer(415, "send JSON")
        try:
            async with asyncio.timeout(IDLE_S):
                body = await request.read()
            source, do, fields = check_request(body, len(self._commands))
        except TimeoutError:
            return answer(408, f"the request was not complete within {IDLE_S:g} s")
        except ValueError as error:
            return answer(400, str(error))
        if do in GUIDED:
            return await self._guided.answer(request, _HEADERS, source, do, fields)
        reply = await self._commands[source].send(do, fields)
        if reply.ok and "board" in fields:
            await self._ask_settings(source, fields["board"])
        return web.json_response({"ok": reply.ok, "reason": reply.reason, "do": do})

    async def _calibration(self, request: web.Request) -> web.StreamResponse:
        """Fit what was recorded last to the record of a force sensor."""
        if refusal := self._refuse(request):
            return answer(403, refusal)
        return await self._guided.fit(request, _HEADERS)


def run_web(params: Listening, ready: Callable[[str], None]) -> None:
    """Serve the page until SIGINT or SIGTERM; errors as for `PageServer.run`."""

    async def main() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        await PageServer(params).run(ready, stop)

    try:
        asyncio.run(main())
    except* UnavailableError as group:
        raise group.exceptions[0] from None

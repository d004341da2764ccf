"""Recordings of one directory: listed, sent as they are, and opened in the page. Nothing is written.

A name of a request is looked up among the files that the directory has at that moment, and never made into
a path, so that no name leads out of it. Links are not followed.
"""

import asyncio
import contextlib
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from aiohttp import web

from tactiled.array import Array
from tactiled.errors import DataError
from tactiled.web.replay import ReplayFile

_SUFFIX = ".mcap"
_LISTED = 500  # newest
# Opened in this process, which holds ten times as many bytes: the unit may have 512 MB.
LARGEST_BYTES = 40_000_000
"""Size of a recording that the page opens."""
_LONGEST_CHUNK_S = 30.0  # of a recording in one answer: 3000 scans of 36 channels have 3 MB


class _Opened(NamedTuple):
    """Recording in memory, and what identifies the file that it was read from."""

    name: str
    changed_ns: int
    replay: ReplayFile


class RecordingFolder:
    """Recordings in a directory; the one that was opened last stays in memory."""

    def __init__(self, directory: Path, arrays: Sequence[Array] = ()) -> None:
        self._directory = directory
        self._arrays = arrays
        self._opened: _Opened | None = None
        self._one_at_a_time = asyncio.Lock()

    def files(self) -> dict[str, tuple[Path, os.stat_result]]:
        """Return the finished recordings by name, the newest first; none where it cannot be read."""
        found = []
        with contextlib.suppress(OSError):  # the directory is gone, or not allowed
            for path in self._directory.iterdir():
                with contextlib.suppress(OSError):  # this file was removed meanwhile
                    if path.suffix == _SUFFIX and stat.S_ISREG((status := path.lstat()).st_mode):
                        found.append((path, status))
        found.sort(key=lambda file: file[1].st_mtime, reverse=True)
        return {path.name: (path, status) for path, status in found[:_LISTED]}

    def listed(self) -> list[dict[str, Any]]:
        """Return name, size in bytes and time of the last write of each recording, the newest first."""
        return [
            {
                "name": name,
                "bytes": status.st_size,
                "ended": status.st_mtime,
                "opens": status.st_size <= LARGEST_BYTES,
            }
            for name, (_, status) in self.files().items()
        ]

    async def open(self, name: str) -> ReplayFile:
        """Read a recording into memory, in a thread.

        `DataError` where there is none of that name, it is too large, or it is no recording.
        """
        async with self._one_at_a_time:
            if name not in (files := await asyncio.to_thread(self.files)):
                raise DataError(f"there is no recording {name!r}")
            path, status = files[name]
            if self._opened is not None and self._opened[:2] == (name, status.st_mtime_ns):
                return self._opened.replay
            if status.st_size > LARGEST_BYTES:
                raise DataError(f"{name}: larger than {LARGEST_BYTES / 1e6:g} MB: use `tactiled web --file`")
            self._opened = None  # two large ones are too much
            try:
                replay = await asyncio.to_thread(ReplayFile, [path], self._arrays)
            except DataError as error:  # who looks need not know where the files are
                raise DataError(str(error).replace(str(path), name)) from None
            self._opened = _Opened(name, status.st_mtime_ns, replay)
            return replay


class RecordingRoutes:
    """Requests for recordings: of the directory, if any, and of the one that the page began with."""

    def __init__(self, folder: RecordingFolder | None, started_with: ReplayFile | None) -> None:
        self._folder = folder
        self._started_with = started_with

    def add_to(self, app: web.Application) -> None:
        """Add the routes."""
        app.router.add_get("/api/replay", self._stretch)
        app.router.add_get("/api/recordings", self._list)
        app.router.add_get("/api/recordings/{name}", self._download)

    async def chosen(self, request: web.Request) -> ReplayFile | None:
        """Return the recording of ``?recording=NAME``, or that of the start; None for live boards.

        `DataError` where it cannot be opened.
        """
        name = request.query.get("recording")
        if name is None or self._started_with is not None:
            return self._started_with
        if self._folder is None:
            raise DataError("no recordings are served: start tactiled web with --recordings")
        return await self._folder.open(name)

    async def _stretch(self, request: web.Request) -> web.StreamResponse:
        """Return the messages of a stretch of the recording, ``?from=SECONDS&to=SECONDS``."""
        try:
            replay = await self.chosen(request)
        except DataError as error:
            return answer(404, str(error))
        if replay is None:
            return answer(404, "this page is live")
        try:
            from_s, to_s = float(request.query["from"]), float(request.query["to"])
        except (KeyError, ValueError):
            return answer(400, "give from and to in seconds")
        if not 0.0 <= to_s - from_s <= _LONGEST_CHUNK_S:
            return answer(400, f"ask for at most {_LONGEST_CHUNK_S:g} s at once")
        thin = request.query.get("thin") == "1"
        found = web.Response(text=replay.stretch(from_s, to_s, thin=thin), content_type="application/json")
        found.enable_compression()  # where the client asks for it
        return found

    async def _list(self, request: web.Request) -> web.StreamResponse:  # noqa: ARG002  a handler
        if self._folder is None:
            return answer(404, "no recordings are served: start tactiled web with --recordings")
        return web.json_response(await asyncio.to_thread(self._folder.listed))

    async def _download(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        files = {} if self._folder is None else await asyncio.to_thread(self._folder.files)
        if name not in files:
            return answer(404, f"there is no recording {name!r}")
        # The browser takes the name of the address.
        headers = {"Content-Disposition": "attachment", "Content-Type": "application/octet-stream"}
        return web.FileResponse(files[name][0], headers=headers)


def answer(status: int, reason: str) -> web.Response:
    """Return a refusal with its reason."""
    return web.json_response({"ok": False, "reason": reason}, status=status)

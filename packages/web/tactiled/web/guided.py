"""`tactiled tune` and `tactiled calibrate` for a person at the page: prompts as they come, then numbers.

A verb runs as a process of its own, as in a terminal. The page shows the same steps and the same verdict,
and the computation at its end delays no browser.
"""

import asyncio
import json
import re
import sys
import tempfile
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any, NamedTuple

from aiohttp import web

from tactiled.web.recordings import answer

_LEFT = re.compile(r" +(\d+) s")  # countdown of `tune.recordings`
_LIFE_SIGN_S = 1.0  # a browser that has gone is found by writing to it
_ENDED_S = 2.5  # within which a run that was cancelled has ended
_LARGEST_REFERENCE_BYTES = 64 * 2**20  # an hour of a force sensor of 100 Hz has half of that
_UPLOAD_S = 60.0
_BUSY = "somebody is being guided on a page of this server: wait, or cancel it there"
# Of a calibration, which is that of its file, and of an array.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")

Lines = AsyncGenerator[dict[str, Any], None]


class _Log(NamedTuple):
    """Readings that were recorded for a calibration, and what they are of."""

    number: int
    array: str
    board: str


class GuidedVerbs:
    """Runs of guided verbs, one at a time: a person follows the prompts of one.

    `array_files` are those of arrays that do not ship with tactiled, by the names of the arrays.
    """

    def __init__(
        self, endpoints: Sequence[str], array_files: Mapping[str, str], keys: Path | None = None
    ) -> None:
        self._endpoints = endpoints
        self._array_files = array_files
        self._keys = keys
        self._one_at_a_time = asyncio.Lock()
        self._files: tempfile.TemporaryDirectory[str] | None = None  # of the calibration
        self._log = _Log(0, "", "")

    def close(self) -> None:
        """Remove what was recorded."""
        if self._files is not None:
            self._files.cleanup()  # a process that writes there may not have ended yet

    async def answer(
        self,
        request: web.Request,
        headers: Mapping[str, str],
        source: int,
        do: str,
        fields: Mapping[str, Any],
    ) -> web.StreamResponse:
        """Run `tactiled tune`, or the recording of `tactiled calibrate --guide`, and send JSON lines.

        The lines are ``{"words": prompt}``, ``{"left_s": countdown}``, ``{}`` each second in which there is
        no other, and at last ``{"ok": true, "found": numbers}`` or ``{"ok": false, "reason": words}``. The
        process ends where the browser closes the connection.
        """
        if not await self._has_turn():
            return answer(409, _BUSY)
        try:
            lines = self._record(source, fields)
            if do == "tune":
                lines = _run(["tune", self._endpoints[source], *self._options(fields)])
            return await _send(request, headers, lines)
        finally:
            self._one_at_a_time.release()

    async def fit(self, request: web.Request, headers: Mapping[str, str]) -> web.StreamResponse:
        """Fit what was recorded to the record of a force sensor, which is the request; lines as above.

        The numbers have the text of the calibration file as ``file``.
        """
        name, number = request.query.get("name", ""), request.query.get("log", "")
        if not _NAME.fullmatch(name):
            return answer(400, "name: letters, digits, - and _, at most 64: the name of the calibration")
        if not await self._has_turn():
            return answer(409, _BUSY)
        try:
            if self._files is None or number != f"{self._log.number}":
                return answer(409, "its readings are no longer here: record again")
            reference = Path(self._files.name, "reference.csv")
            refusal = await _refuse_upload(request, reference)
            return refusal or await _send(request, headers, self._fit(reference, name))
        finally:
            self._one_at_a_time.release()

    async def _has_turn(self) -> bool:
        """Wait for the end of a run that was cancelled; return False where one goes on."""
        try:
            async with asyncio.timeout(_ENDED_S):
                return await self._one_at_a_time.acquire()
        except TimeoutError:
            return False

    async def _record(self, source: int, fields: Mapping[str, Any]) -> Lines:
        """Yield the lines of `tactiled calibrate --guide`; the numbers have the number of the log."""
        array = fields.get("array", "")
        if array not in self._array_files and not _NAME.fullmatch(array):  # no path, which the fit would open
            yield {"ok": False, "reason": "the board has not said which array it has: wait until it is fresh"}
            return
        if self._files is None:
            self._files = tempfile.TemporaryDirectory(prefix="tactiled-web-", ignore_cleanup_errors=True)
        log = Path(self._files.name, "new.npz")  # until it is whole: a run that is cancelled changes nothing
        arguments = ["calibrate", f"{log}", f"--guide={self._endpoints[source]}", *self._options(fields)]
        async with aclosing(_run(arguments, log.parent)) as lines:
            async for line in lines:
                if "found" in line:
                    log.replace(log.with_name("log.npz"))
                    self._log = _Log(self._log.number + 1, array, fields.get("board", ""))
                    line["found"]["log"] = self._log.number
                yield line

    async def _fit(self, reference: Path, name: str) -> Lines:
        """Yield the lines of `tactiled calibrate`."""
        log, file = reference.with_name("log.npz"), reference.with_name(f"{name}.toml")
        array = self._array_files.get(self._log.array, self._log.array)
        about = f"--array={array}", f"--board={self._log.board}"
        arguments = ["calibrate", f"{log}", f"--reference={reference}", f"--out={file}", *about]
        async with aclosing(_run(arguments, log.parent)) as lines:
            async for line in lines:
                if "found" in line:
                    text = file.read_text(encoding="utf-8")
                    file.unlink()
                    line["found"]["file"] = text
                yield line

    def _options(self, fields: Mapping[str, Any]) -> list[str]:
        """Return options; what the browser sent stands behind ``=``, so that it is no option."""
        options = {"--" + name.replace("_", "-"): value for name, value in fields.items() if name != "array"}
        options["--array"] = self._array_files.get(fields.get("array", ""))
        options["--keys"] = self._keys
        return [f"{option}={value}" for option, value in options.items() if value is not None]


async def _refuse_upload(request: web.Request, to: Path) -> web.Response | None:
    """Write the body of a request to a file; return why it was not taken."""
    try:
        async with asyncio.timeout(_UPLOAD_S):
            with to.open("wb") as stream:
                async for part in request.content.iter_chunked(2**16):
                    await asyncio.to_thread(stream.write, part)  # a slow disk delays no browser
                    if stream.tell() > _LARGEST_REFERENCE_BYTES:
                        return answer(413, f"the record has more than {_LARGEST_REFERENCE_BYTES} bytes")
    except TimeoutError:
        return answer(408, f"the record was not complete within {_UPLOAD_S:g} s")
    except OSError as error:
        return answer(507, f"the server cannot keep the record: {error.strerror}")
    return None


async def _send(request: web.Request, headers: Mapping[str, str], run: Lines) -> web.StreamResponse:
    """Send lines as they come, until the browser closes the connection."""
    response = web.StreamResponse(headers={**headers, "Content-Type": "application/x-ndjson"})
    try:
        await response.prepare(request)
        async with aclosing(run) as lines:
            async for line in lines:
                await response.write(json.dumps(line).encode() + b"\n")
        await response.write_eof()
    except ConnectionError:
        pass  # cancelled, or the tab was closed
    return response


async def _run(arguments: Sequence[str], folder: Path | None = None) -> Lines:
    """Yield what a verb says, then its result; the process ends with the iteration.

    A `folder` of this server is left out of its words: it tells a browser nothing.
    """
    # -P: modules of the folder in which the server was started are not those of tactiled.
    command = [sys.executable, "-P", "-m", "tactiled", *arguments]
    none, pipe = asyncio.subprocess.DEVNULL, asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, stdin=none, stdout=pipe, stderr=pipe)
    assert process.stdout is not None  # as asked for
    assert process.stderr is not None
    result = asyncio.create_task(process.stdout.read())  # a full pipe would stop the verb
    try:
        said = ""
        while True:
            try:
                line = await asyncio.wait_for(process.stderr.readline(), _LIFE_SIGN_S)
            except TimeoutError:
                yield {}
                continue
            if not line:
                break
            words = line.decode(errors="replace").rstrip("\n")
            if folder is not None:
                words = words.replace(f"{folder}/", "")
            said = words or said
            left = _LEFT.fullmatch(words)
            yield {"words": words} if left is None else {"left_s": int(left[1])}
        found = await result
        await process.wait()
        if found:  # also where its exit code says that a motion is lacking
            yield {"ok": True, "found": json.loads(found)}
        else:
            yield {"ok": False, "reason": said.removeprefix("tactiled: ")}
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        result.cancel()

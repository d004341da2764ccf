"""`tactiled tune` for a person at the page: its prompts as they come, its numbers at the end.

The verb runs as a process of its own, as in a terminal. The page shows the same steps and the same verdict,
and the computation at its end delays no browser.
"""

import asyncio
import json
import re
import sys
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any

from aiohttp import web

from tactiled.web.recordings import answer

_LEFT = re.compile(r" +(\d+) s")  # countdown of `tune.live`
_LIFE_SIGN_S = 1.0  # a browser that has gone is found by writing to it
_ENDED_S = 2.5  # within which a run that was cancelled has ended


class GuidedVerbs:
    """Runs of guided verbs, one at a time: a person follows the prompts of one.

    Parameters
    ----------
    endpoints : sequence of str
        Endpoints of events.
    array_files : mapping of str to str
        Files of arrays that do not ship with tactiled, by the names of the arrays.
    keys : Path, optional
        Key file of this client.
    """

    def __init__(
        self, endpoints: Sequence[str], array_files: Mapping[str, str], keys: Path | None = None
    ) -> None:
        self._endpoints = endpoints
        self._array_files = array_files
        self._keys = keys
        self._one_at_a_time = asyncio.Lock()

    async def answer(
        self, request: web.Request, headers: Mapping[str, str], source: int, fields: Mapping[str, Any]
    ) -> web.StreamResponse:
        """Run `tactiled tune` and send JSON lines; the process ends where the browser closes the connection.

        The lines are ``{"words": prompt}``, ``{"left_s": countdown}``, ``{}`` each second in which there is
        no other, and at last ``{"ok": true, "found": numbers}`` or ``{"ok": false, "reason": words}``.
        """
        try:
            async with asyncio.timeout(_ENDED_S):
                await self._one_at_a_time.acquire()
        except TimeoutError:
            return answer(409, "somebody is being guided on a page of this server: wait, or cancel it there")
        response = web.StreamResponse(headers={**headers, "Content-Type": "application/x-ndjson"})
        try:
            await response.prepare(request)
            async with aclosing(_run(self._arguments(source, fields))) as lines:
                async for line in lines:
                    await response.write(json.dumps(line).encode() + b"\n")
            await response.write_eof()
        except ConnectionError:
            pass  # cancelled, or the tab was closed
        finally:
            self._one_at_a_time.release()
        return response

    def _arguments(self, source: int, fields: Mapping[str, Any]) -> list[str]:
        """Return the command line; what the browser sent stands behind ``=``, so that it is no option."""
        options = {"--" + name.replace("_", "-"): value for name, value in fields.items() if name != "array"}
        options["--array"] = self._array_files.get(fields.get("array", ""))
        options["--keys"] = self._keys
        given = [f"{option}={value}" for option, value in options.items() if value is not None]
        return ["tune", self._endpoints[source], *given]


async def _run(arguments: Sequence[str]) -> AsyncGenerator[dict[str, Any], None]:
    """Yield what a verb says, then its result; the process ends with the iteration."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-P",  # modules of the folder in which the server was started are not those of tactiled
        "-m",
        "tactiled",
        *arguments,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=pipe,
        stderr=pipe,
    )
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
            said = words or said
            left = _LEFT.fullmatch(words)
            yield {"words": words} if left is None else {"left_s": int(left[1])}
        found = await result
        if await process.wait() == 0:
            yield {"ok": True, "found": json.loads(found)}
        else:
            yield {"ok": False, "reason": said.removeprefix("tactiled: ")}
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        result.cancel()

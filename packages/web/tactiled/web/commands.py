"""Commands of the page, handed on to the daemon of its endpoint."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tactiled.client import AsyncCommander, Reply
from tactiled.client.commander import TIMEOUT_S
from tactiled.errors import OperatorError

FIELDS: dict[str, dict[str, type]] = {
    "tare": {"force": bool},
    "inhibit": {"duration_s": float},
    "expect-load-change": {"duration_s": float},
    "mark": {"text": str},
    "record": {"on": bool},
    "speed": {"speed_mm_s": float},
    "friction": {"value": float, "sd": float},
    "object-changed": {},
    "thresholds": {"values": dict},
}
"""Commands that the page may give, with their fields (protocols/control.md). The daemon checks the values."""
GUIDED: dict[str, dict[str, type]] = {
    "tune": {"array": str, "quiet_s": float, "motion_s": float, "reports_per_hour": float},
    "calibrate": {"array": str, "guide_s": float},
}
"""Verbs of the terminal that the page may start (see `guided`), with their fields."""
_WHO = "web page"
_ASK_S = 0.5  # for a question: a daemon answers within milliseconds, and a command may wait behind it


class DaemonCommands:
    """Connection to the daemon behind one endpoint of events, opened with the first command."""

    def __init__(self, endpoint: str, keys: Path | None = None) -> None:
        self._endpoint = endpoint
        self._keys = keys
        self._commander: AsyncCommander | None = None

    async def send(self, do: str, fields: Mapping[str, Any], timeout_s: float = TIMEOUT_S) -> Reply:
        """Send a command and return the reply; a daemon that does not answer is a refusal with the reason."""
        try:
            if self._commander is None:
                self._commander = AsyncCommander(self._endpoint, _WHO, keys=self._keys)
            return await self._commander.send(do, timeout_s, **fields)
        except OperatorError as error:
            return Reply(False, str(error), {})

    async def settings(self, board: str) -> dict[str, Any] | None:
        """Return what the buttons of a board show; None where the daemon does not say."""
        reply = await self.send("state", {"board": board}, _ASK_S)
        found = reply.data.get("settings")
        if not isinstance(found, dict) or not found:
            return None
        detect = found.get("detect")
        grip = detect.get("grip") if isinstance(detect, dict) else None
        grip = grip if isinstance(grip, dict) else {}
        return {
            "board": board,
            "speed_mm_s": found.get("speed_mm_s", 0.0),
            "tared": found.get("tared", False),
            "incipient_p": grip.get("incipient_p", 0.0),
            "gross_p": grip.get("gross_p", 0.0),
        }

    def close(self) -> None:
        """Close the connection."""
        if self._commander is not None:
            self._commander.close()


def check_request(body: bytes, n_sources: int) -> tuple[int, str, dict[str, Any]]:
    """Return source, command and fields of a request of the page; `ValueError` says why it is none."""
    try:
        document: object = json.loads(body)
        json.dumps(document, ensure_ascii=False).encode()  # lone surrogates are JSON, but no text
    except RecursionError:
        raise ValueError("the request is nested too deeply") from None
    if not isinstance(document, dict):
        raise ValueError("the request is not a JSON object")  # noqa: TRY004  one kind of error for the caller
    source, do, fields = document.get("source", 0), document.get("do"), document.get("fields", {})
    if type(source) is not int or not 0 <= source < n_sources:
        raise ValueError(f"source is {source!r}; there are 0 to {n_sources - 1}")
    if not isinstance(do, str) or do not in (known := FIELDS | GUIDED):
        raise ValueError(f"no command {do!r}; there are: {', '.join(known)}")
    if not isinstance(fields, dict):
        raise ValueError("fields is not a JSON object")  # noqa: TRY004
    board = document.get("board", "")
    if not isinstance(board, str) or "\0" in board:
        raise ValueError(f"board is {board!r}, not a serial number")
    checked: dict[str, Any] = {"board": board} if board else {}  # a daemon may read several boards
    for name, value in fields.items():
        kind = known[do].get(name)
        if kind is None:
            raise ValueError(f"{do} has no field {name!r}")
        if kind is float and type(value) in (int, float):
            try:
                checked[name] = float(value)
            except OverflowError:
                raise ValueError(f"{name} is larger than any number here") from None
        elif type(value) is kind:
            checked[name] = value
        else:
            raise ValueError(f"{name} is {value!r}, which is no {kind.__name__}")
    return source, do, checked

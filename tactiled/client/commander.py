"""Asking the daemon for something, and knowing what came of it: `Commander`, `AsyncCommander`.

A command that got no reply is sent again with the same session and id. The daemon does it once however often
it comes, so a reply that was lost never makes a command happen twice.
"""

import itertools
import json
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import msgpack
import zmq
import zmq.asyncio

from tactiled.client import connect, nearby
from tactiled.client.items import Malformed
from tactiled.client.parse import parse_map
from tactiled.errors import OperatorError
from tactiled.events.endpoints import control_endpoint

TIMEOUT_S = 5.0  # the slowest command, a rate that the board does not take, is answered within 3 s
_AGAIN_S = 0.5  # a reply takes a millisecond; a change of rate some 100


@dataclass(frozen=True)
class Reply:
    """What the daemon answered.

    Attributes
    ----------
    ok : bool
    reason : str
        Why not; empty where `ok`.
    data : dict
        The whole map (protocols/control.md).
    """

    ok: bool
    reason: str
    data: dict[str, Any]


class _Request:
    """One request until it is answered; `session` and `number` tell it from all others."""

    def __init__(self, do: str, session: str, number: int, rest: dict[str, Any], timeout_s: float) -> None:
        self.id = f"{session[:8]}-{number}"
        self.payload = msgpack.packb({"v": 1, "session": session, "id": self.id, "do": do, **rest})
        self.until_s = time.monotonic() + timeout_s
        self.again_s = 0.0

    def wait_ms(self, endpoint: str) -> int:
        """How long to wait for the reply now; raises when the time is up."""
        now_s = time.monotonic()
        if now_s >= self.until_s:
            raise OperatorError(f"{endpoint}: no answer; is tactiled running there, and our key known to it?")
        return max(1, round(1000 * (min(self.until_s, self.again_s) - now_s)))

    def is_due(self) -> bool:
        """Whether to send it (again) now."""
        now_s = time.monotonic()
        if now_s < self.again_s:
            return False
        self.again_s = now_s + _AGAIN_S
        return True

    def reply(self, payload: bytes) -> Reply | None:
        """The reply, if that is ours."""
        data = parse_map(payload, "reply")
        if isinstance(data, Malformed) or data.get("id") != self.id:
            return None
        return Reply(data.get("ok") is True, str(data.get("reason", "")), data)


class _Connected:
    """Where requests go."""

    def __init__(
        self,
        endpoint: str | None = None,
        who: str = "",
        control: str | None = None,
        keys: Path | str | None = None,
    ) -> None:
        self._who = who
        self._session = secrets.token_hex(16)
        self._numbers = itertools.count(1)
        if control is not None:
            self._endpoint = control
        elif endpoint is not None:
            self._endpoint = control_endpoint(endpoint)
        else:
            self._endpoint = nearby.control()
        self._context = zmq.Context()
        self._socket: zmq.Socket[bytes] = self._context.socket(zmq.DEALER)
        try:
            connect.ask(self._socket, self._endpoint, None if keys is None else Path(keys))
        except BaseException:
            self.close()
            raise

    def _request(self, do: str, arguments: dict[str, Any], timeout_s: float) -> _Request:
        rest = {"who": self._who, **arguments}
        return _Request(do, self._session, next(self._numbers), rest, timeout_s)

    def close(self) -> None:
        self._socket.close(linger=0)
        self._context.term()


class Commander(_Connected):
    """Commands to a daemon, one after the other.

    Parameters
    ----------
    endpoint : str, optional
        Where the daemon publishes; left out: the ipc endpoint of the one daemon of this host (`nearby`).
    who : str
        How we call ourselves, for the record.
    control : str, optional
        Where it takes requests; left out: beside `endpoint`, by the daemon's own rule.
    keys : path, optional
        Our file of `tactiled keys make`.

    Raises
    ------
    ConfigError
        The endpoint is none, or there are no keys in the file.
    OperatorError
        No endpoint is given, and on this host is no daemon, more than one, or one that does not let us in.

    Examples
    --------
    ::

        with Commander(who="left gripper") as daemon:
            daemon.send("inhibit", duration_s=0.4)  # our own motion: no slip, whatever it looks like
    """

    def send(self, do: str, timeout_s: float = TIMEOUT_S, **arguments: Any) -> Reply:
        """Ask for something and wait for the reply.

        Raises
        ------
        OperatorError
            Nobody answered in time. Whether a command was done is not known then.
        """
        request = self._request(do, arguments, timeout_s)
        while True:
            if request.is_due() and self._socket.poll(request.wait_ms(self._endpoint), zmq.POLLOUT):
                self._socket.send(request.payload)
            if self._socket.poll(request.wait_ms(self._endpoint)):
                reply = request.reply(self._socket.recv_multipart()[-1])
                if reply is not None:
                    return reply

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncCommander(_Connected):
    """The same for asyncio; parameters and errors as `Commander`'s."""

    async def send(self, do: str, timeout_s: float = TIMEOUT_S, **arguments: Any) -> Reply:
        """Ask for something and wait for the reply; errors as `Commander.send`'s. One at a time."""
        request = self._request(do, arguments, timeout_s)
        sock: zmq.asyncio.Socket = zmq.asyncio.Socket(shadow=self._socket)
        while True:
            wait_ms = request.wait_ms(self._endpoint) if request.is_due() else 0
            # pyzmq's stub does not know of the flags.
            if wait_ms and await sock.poll(wait_ms, zmq.POLLOUT):  # type: ignore[call-arg]
                self._socket.send(request.payload)
            if await sock.poll(request.wait_ms(self._endpoint)):
                reply = request.reply(self._socket.recv_multipart()[-1])
                if reply is not None:
                    return reply

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


def fields_of(do: str, words: Sequence[str]) -> dict[str, Any]:
    """Arguments of a request from words like ``speed_mm_s=5``; values are JSON, or else text.

    Raises
    ------
    OperatorError
        A word has no ``=``.
    """
    fields: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name:
            raise OperatorError(f"{word}: say FIELD=VALUE, as in speed_mm_s=5")
        try:
            fields[name] = json.loads(text)
        except ValueError:
            fields[name] = text
    return {"values": fields} if do == "thresholds" else fields

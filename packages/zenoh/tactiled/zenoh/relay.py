"""Requests of zenoh to the daemon, and their replies back. No sockets: `bridge` has these.

Payloads pass unchanged, so that the daemon checks and records them as over ZeroMQ. A reply is matched to its
request by ``id``, which clients draw at random.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack

from tactiled.client.items import Malformed
from tactiled.client.parse import parse_map

QUESTIONS = ("state", "events")
"""Requests that change nothing, so that they may be repeated."""
_MOST_WAITING = 256  # requests at once; the daemon takes 500 in a second
_MOST_REPEATS = 32  # of one request
_PATIENCE_S = 5.0  # a reply takes milliseconds; a daemon that is being restarted is back within this time
_LONGEST_WHO = 64
_LONGEST_BYTES = 16 * 1024 - 256  # the daemon cuts the connection of all for one byte more than 16 kB
_NO_COMMANDS = "this bridge takes no commands: its owner may start it with --allow-commands"
_NOT_HERE = "commands go to the key tactile/HOST/command"

Respond = Callable[[bytes], None]
"""Takes the reply; an empty one ends the request without any."""


Ask = Callable[[bytes], bool]
"""Sends a request to the daemon; False where it is not connected."""


@dataclass
class _Waiting:
    respond: list[Respond]
    until_s: float
    request: bytes


class Relay:
    """Match requests, sent with `ask`, and replies; without `allow_commands` refuse commands here."""

    def __init__(self, ask: Ask, *, allow_commands: bool) -> None:
        self._ask = ask
        self._allow_commands = allow_commands
        self._waiting: dict[str, _Waiting] = {}

    def request(self, payload: bytes, respond: Respond, now_s: float, *, may_command: bool) -> None:
        """Take a request; never raises, whatever it contains. `may_command`: it came over that key."""
        self._expire(now_s)
        if len(payload) > _LONGEST_BYTES:
            self._refuse({}, f"longer than {_LONGEST_BYTES} bytes", respond)
            return
        request = parse_map(payload, "request")
        if isinstance(request, Malformed):
            self._refuse({}, request.reason, respond)
            return
        id_, do = request.get("id"), request.get("do")
        if not isinstance(id_, str) or not isinstance(do, str) or not 0 < len(id_) <= 64:
            self._refuse({}, "id or do is missing, or no text", respond)
            return
        if do not in QUESTIONS:
            if not self._allow_commands or not may_command:
                self._refuse(request, _NOT_HERE if self._allow_commands else _NO_COMMANDS, respond)
                return
            who = request.get("who")
            request["who"] = f"{who[: _LONGEST_WHO - 6] if isinstance(who, str) else ''} zenoh".strip()
            try:
                payload = msgpack.packb(request)
            except ValueError:
                self._refuse({}, "nested too deeply", respond)
                return
            if len(payload) > _LONGEST_BYTES:  # numbers of 4 bytes have become such of 8
                self._refuse(request, f"longer than {_LONGEST_BYTES} bytes", respond)
                return
        waiting = self._waiting.get(id_)
        if waiting is not None and waiting.request != payload:
            self._refuse(request, "id: another request with it waits for its reply", respond)
        elif waiting is not None and len(waiting.respond) < _MOST_REPEATS:
            waiting.respond.append(respond)
        elif waiting is None and len(self._waiting) < _MOST_WAITING and self._ask(payload):
            self._waiting[id_] = _Waiting([respond], now_s + _PATIENCE_S, payload)
        else:
            respond(b"")  # the client repeats a question

    def reply(self, payload: bytes) -> None:
        """Take a reply of the daemon."""
        waiting = self._waiting.pop(_id_of(payload), None)
        if waiting is not None:
            for respond in waiting.respond:
                respond(payload)

    def _expire(self, now_s: float) -> None:
        for id_ in [id_ for id_, waiting in self._waiting.items() if now_s >= waiting.until_s]:
            for respond in self._waiting.pop(id_).respond:
                respond(b"")

    def _refuse(self, request: dict[str, Any], reason: str, respond: Respond) -> None:
        head = {"v": 1, "id": request.get("id", ""), "do": request.get("do", "")}
        respond(msgpack.packb(head | {"ok": False, "reason": reason, "run": 0}))


def _id_of(payload: bytes) -> str:
    """Id of a reply, which stands among its first fields: a reply may have 128 kB of messages behind it."""
    unpacker = msgpack.Unpacker()
    unpacker.feed(payload)
    try:
        for _ in range(unpacker.read_map_header()):
            name, value = unpacker.unpack(), unpacker.unpack()
            if name == "id":
                return str(value)
    except (ValueError, msgpack.exceptions.UnpackException):
        pass  # no reply of a daemon
    return ""

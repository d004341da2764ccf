"""Requests and replies: newest messages, missed messages, and commands (protocols/control.md).

`Control` turns the bytes of a request into those of a reply, without I/O; `network` has the sockets.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import msgpack

from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import (
    CONTROL_VERSION,
    Bad,
    CommandRequest,
    Events,
    Request,
    Requester,
    parse,
)
from tactiled.events.types import EVENT_TYPES
from tactiled.limited_log import RateLimitedLog

logger = logging.getLogger(__name__)

# Limit of the messages in a reply: 200 scans. A minute of scans takes 30 round trips.
REPLY_BYTES = 128 * 1024
# Clients of ours take frames of 1 MiB; some bytes less, for what precedes the reply in a queue of that size.
LONGEST_REPLY_BYTES = 2**20 - 1024
_NO_COMMANDS = (
    "commands are not taken over TCP without a key, because TCP does not tell which user asks: send them to "
    "the ipc endpoint (tactiled command does), or set publish.allow_commands_over_tcp"
)


class CommandedBoard(Protocol):
    """Board that takes commands."""

    @property
    def serial(self) -> str:
        """Serial number; empty while it is unknown."""

    def settings(self, now_s: float) -> dict[str, Any]:
        """Return the present settings, by the names that requests use."""

    def do(self, request: CommandRequest, requester: Requester, now_s: float) -> str:
        """Carry out a command; return why it is refused, or an empty string."""


class Control:
    """Answer requests to the boards that share these endpoints."""

    def __init__(self, publisher: Publisher, boards: Sequence[CommandedBoard]) -> None:
        self.bad = RateLimitedLog(logger, "request refused")
        self.commanded = RateLimitedLog(logger, "command")
        self._publisher = publisher
        self._boards = boards

    def answer(self, payload: bytes, requester: Requester, now_s: float) -> bytes:
        """Return the reply to a request; never raises."""
        request = parse(payload)
        if isinstance(request, Bad):
            self.bad.add(request.reason, now_s)
            return self._reply(request.id, request.do, request.reason)
        try:
            if isinstance(request, CommandRequest):
                return self._command(request, requester, now_s)
            reply = self._events(request) if isinstance(request, Events) else self._state(request, now_s)
            if len(reply) <= LONGEST_REPLY_BYTES:
                return reply
            too_long = (
                f"the reply has {len(reply)} bytes, {LONGEST_REPLY_BYTES} are the most: ask for the topics "
                "that you need with `events`"
            )
            return self._reply(request.id, request.do, too_long)
        except Exception as error:  # a bug in the control channel must not stop sensing
            fault = f"a fault of tactiled, please report it: {error!r:.200}"
            self.bad.add(f"{request.do}: {fault}", now_s)
            return self._reply(request.id, request.do, fault)

    def _state(self, request: Request, now_s: float) -> bytes:
        board = self._addressed(request)
        if board is None and request.board:
            return self._reply(request.id, request.do, self._no_board(request))
        return self._reply(
            request.id,
            request.do,
            "",
            messages=_pack_map(self._publisher.store.latest()),
            settings=msgpack.packb({} if board is None else board.settings(now_s)),
            boards=msgpack.packb([each.serial for each in self._boards]),
        )

    def _addressed(self, request: Request) -> CommandedBoard | None:
        """Return the board that a request names; without a name, the only one."""
        boards = self._boards
        if not request.board:
            return boards[0] if len(boards) == 1 else None
        return next((board for board in boards if board.serial == request.board), None)

    def _events(self, request: Events) -> bytes:
        if request.topic not in EVENT_TYPES:
            return self._reply(request.id, request.do, f"topic: none of {', '.join(EVENT_TYPES)}")
        span = self._publisher.store.span(
            request.board, request.topic, request.first_seq, request.end_seq, REPLY_BYTES
        )
        return self._reply(
            request.id,
            request.do,
            "",
            messages=msgpack.Packer().pack_array_header(len(span.payloads)) + b"".join(span.payloads),
            next_seq=msgpack.packb(span.next_seq),
            more=msgpack.packb(span.more),
        )

    def _command(self, command: CommandRequest, requester: Requester, now_s: float) -> bytes:
        if not requester.may_command:
            self.bad.add(f"{command.do} by {requester}: {_NO_COMMANDS}", now_s)
            return self._reply(command.id, command.do, _NO_COMMANDS)
        board = self._addressed(command)
        reason = self._no_board(command) if board is None else board.do(command, requester, now_s)
        # The event has the reason; one line for each outcome keeps the log short.
        outcome = "refused" if reason else "done"
        self.commanded.add(f"{command.do} by {requester}: {outcome}", now_s, logging.INFO)
        return self._reply(command.id, command.do, reason)

    def _no_board(self, request: Request) -> str:
        """Reason for the refusal of a request that is to no board, or to an unknown one."""
        known = ", ".join(each.serial for each in self._boards) or "none yet"
        what = f"{request.board} is not read here" if request.board else "say which one is meant"
        return f"board: {what}; there are: {known}"

    def _reply(self, id_: str, do: str, reason: str, **packed: bytes) -> bytes:
        head = {"v": CONTROL_VERSION, "id": id_, "do": do, "ok": not reason, "reason": reason}
        known = {name: msgpack.packb(value) for name, value in head.items()}
        return _pack_map({**known, "run": msgpack.packb(self._publisher.run), **packed})


def _pack_map(packed: Mapping[str, bytes]) -> bytes:
    """Msgpack map of values that are packed already, so that messages are sent as they were published."""
    parts = [msgpack.Packer().pack_map_header(len(packed))]
    for name, value in packed.items():
        parts += (msgpack.packb(name), value)
    return b"".join(parts)

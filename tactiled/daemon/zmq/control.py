"""Requests and replies: newest messages, missed messages, and commands (protocols/control.md).

`Control` turns the bytes of a request into those of a reply, without I/O; `network` has the sockets.
"""

import logging
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import msgpack

from tactiled.daemon.zmq.commands import Done
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import (
    CONTROL_VERSION,
    Bad,
    CommandRequest,
    Events,
    Motion,
    Request,
    Requester,
    parse,
    sender_of,
)
from tactiled.events.types import EVENT_TYPES
from tactiled.limited_log import RateLimitedLog

logger = logging.getLogger(__name__)

# Limit of the messages in a reply: 200 scans. A minute of scans takes 30 round trips.
REPLY_BYTES = 128 * 1024
_REMEMBERED = 1000  # commands whose replies are kept for repeated requests; some 2 MB at worst
# Motion commands are remembered apart, because they come in streams and would displace the others: 2 s at
# 100 Hz, while a client repeats a command after 0.5 s; some 4 MB at worst.
_REMEMBERED_MOTION = 200
_MOST_WAITING = 8  # requests for one pending command that get an answer: the first, and its repetitions

Respond = Callable[[bytes], None]
_NO_COMMANDS = (
    "commands are not taken over TCP without a key, because TCP does not tell which user asks: send them to "
    "the ipc endpoint (tactiled command does), or set publish.allow_commands_over_tcp"
)


@dataclass
class _Asked:
    """Accepted command, with its reply as soon as there is one."""

    command: CommandRequest
    reply: bytes = b""
    waiting: list[Respond] = field(default_factory=list)


class CommandedBoard(Protocol):
    """Board that takes commands."""

    @property
    def serial(self) -> str:
        """Serial number; empty while it is unknown."""

    def settings(self, now_s: float) -> dict[str, Any]:
        """Return the present settings, by the names that requests use."""

    def do(self, request: CommandRequest, requester: Requester, now_s: float, done: Done) -> None:
        """Carry out a command, and say whether it is done or why it is refused."""


class Control:
    """Answer requests to the boards that share these endpoints."""

    def __init__(self, publisher: Publisher, boards: Sequence[CommandedBoard]) -> None:
        self.bad = RateLimitedLog(logger, "request refused")
        self.commanded = RateLimitedLog(logger, "command")
        self._publisher = publisher
        self._boards = boards
        self._asked: OrderedDict[tuple[str, ...], _Asked] = OrderedDict()
        self._asked_motion: OrderedDict[tuple[str, ...], _Asked] = OrderedDict()

    def take(self, payload: bytes, requester: Requester, now_s: float, respond: Respond) -> None:
        """Answer a request, at once or when a command is done; never raises."""
        request = parse(payload)
        if isinstance(request, Bad):
            self.bad.add(request.reason, now_s)
            respond(self._reply(request.id, request.do, request.reason))
            return
        try:
            if isinstance(request, CommandRequest):
                self._command(request, requester, now_s, respond)
            elif isinstance(request, Events):
                respond(self._events(request))
            else:
                respond(self._state(request, now_s))
        except Exception as error:  # a bug in the control channel must not stop sensing
            self.bad.add(f"a fault of tactiled, please report it: {error!r}", now_s)

    def _state(self, request: Request, now_s: float) -> bytes:
        board = self._addressed(request)
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

    def _command(self, command: CommandRequest, requester: Requester, now_s: float, respond: Respond) -> None:
        """Carry out a command once for each id of a session, while its id is among those remembered.

        A command whose `do` has raised before an answer is forgotten, so that the client may send it again.
        """
        if not requester.may_command:
            self.bad.add(f"{command.do} by {requester}: {_NO_COMMANDS}", now_s)
            respond(self._reply(command.id, command.do, _NO_COMMANDS))
            return
        name = (*sender_of(command, requester), command.id)
        known, most = self._asked, _REMEMBERED
        if isinstance(command, Motion):
            known, most = self._asked_motion, _REMEMBERED_MOTION
        asked = known.get(name)
        if asked is not None and asked.command != command:
            respond(self._reply(command.id, command.do, "id: was used for another request"))
        elif asked is not None and asked.reply:
            respond(asked.reply)
        elif asked is not None:
            if len(asked.waiting) < _MOST_WAITING:
                asked.waiting.append(respond)
        else:
            asked = known[name] = _Asked(command, waiting=[respond])
            if len(known) > most:
                known.popitem(last=False)
            try:
                self._do(command, requester, now_s, partial(self._finish, asked, requester, now_s))
            except Exception:
                if not asked.reply:
                    known.pop(name, None)
                raise

    def _do(self, command: CommandRequest, requester: Requester, now_s: float, done: Done) -> None:
        if (board := self._addressed(command)) is not None:
            board.do(command, requester, now_s, done)
            return
        known = ", ".join(each.serial for each in self._boards) or "none yet"
        what = f"{command.board} is not read here" if command.board else "say which one is meant"
        done(f"board: {what}; there are: {known}")

    def _finish(self, asked: _Asked, requester: Requester, now_s: float, reason: str) -> None:
        # The event has the reason; one line for each outcome keeps the log short.
        outcome = "refused" if reason else "done"
        self.commanded.add(f"{asked.command.do} by {requester}: {outcome}", now_s, logging.INFO)
        asked.reply = self._reply(asked.command.id, asked.command.do, reason)
        for respond in asked.waiting:
            respond(asked.reply)
        asked.waiting.clear()

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

"""Bridge of one daemon: its messages to zenoh, and requests from zenoh to it.

One thread reads ZeroMQ and publishes. zenoh's threads hand requests over through a queue. Messages that a
slow network drops, or that come while a link is cut, are not kept here: subscribers fetch them from the
daemon's store by their sequence numbers, as over ZeroMQ.
"""

import logging
import math
import os
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import zenoh
import zmq

from tactiled.client.transports import ZmqTransport
from tactiled.errors import UnavailableError
from tactiled.events.endpoints import control_endpoint
from tactiled.zenoh.relay import Relay
from tactiled.zenoh.session import chunk_of, words_of
from tactiled.zenoh.transport import WakeUp

logger = logging.getLogger(__name__)

PER_SCAN = ("scan", "grip", "force")
"""Topics with a message for each scan: nearly all of the bytes."""
_MOST_WAITING = 1000  # requests that zenoh handed over and that were not looked at yet
_MOST_AT_ONCE = 500  # messages until requests are looked at again
_ALIVE_S = 1.0  # ten periods of the status
_TURN_MS = 200
_RETRY_S = 1.0  # period of looking for a router
_FIRST = zenoh.Priority.INTERACTIVE_HIGH  # overtakes scans that wait for a slow link
_LAST = zenoh.Priority.DATA_LOW


@dataclass(frozen=True)
class ZenohBridgeParams:
    """Messages to forward, and the name to forward them under."""

    endpoint: str
    host: str  # in the keys
    # Highest rate of the topics of each scan; 0: none of them; left out: every message
    scan_rate_hz: float | None = None
    allow_commands: bool = False
    keys: Path | None = None  # key file for the daemon, where its endpoint needs one


@dataclass
class RateLimit:
    """Highest rate of the messages of each topic; None for every message, 0 for none."""

    rate_hz: float | None
    _due_s: dict[bytes, float] = field(default_factory=dict)

    def admits(self, topic: bytes, now_s: float) -> bool:
        """Return True for a message that is to be forwarded."""
        if self.rate_hz is None:
            return True
        if self.rate_hz == 0 or now_s < self._due_s.get(topic, 0.0):
            return False
        # Counted from the last due time, so that the mean rate is what was asked for.
        period_s = 1 / self.rate_hz
        self._due_s[topic] = max(self._due_s.get(topic, now_s), now_s - period_s) + period_s
        return True


def key_of(host: str, topic: bytes) -> str | None:
    """Return the key of a topic ``tactile/BOARD/TOPIC``; None for what is no topic."""
    parts = topic.decode(errors="replace").split("/")
    if len(parts) != 3 or not all(parts):
        return None
    return "/".join(("tactile", host, *map(chunk_of, parts[1:])))


def wait_for_session(config: "zenoh.Config") -> "zenoh.Session":
    """Open a session as soon as a router answers."""
    fault = ""
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if fault != (fault := words_of(error)):
                logger.warning("no router of zenoh answers, tried again every %g s: %s", _RETRY_S, fault)
        time.sleep(_RETRY_S)


class ZenohBridge:
    """Forward messages and requests until stopped; the session is closed by its owner.

    `ConfigError` where the endpoint or the keys are invalid; `UnavailableError` where another bridge has this
    name.
    """

    def __init__(self, params: ZenohBridgeParams, session: "zenoh.Session") -> None:
        _refuse_second(session, params.host)
        self._params = params
        self._session = session
        self._limit = RateLimit(params.scan_rate_hz)
        # Names of the topics of which a part is forwarded, for the subscribers.
        self._thinned = None if params.scan_rate_hz is None else ",".join(PER_SCAN).encode()
        self._publishers: dict[bytes, zenoh.Publisher | None] = {}
        self._boards = LivelyBoards(session, params.host)
        # There while no board is: lists show the host as silent, and another bridge cannot take its name.
        self._token = session.liveliness().declare_token(f"tactile/{params.host}/control")
        self._queries: deque[zenoh.Query] = deque()
        self._ended = False
        self._wakeup = WakeUp()
        control = control_endpoint(params.endpoint)
        self._daemon = ZmqTransport(zmq.Context(), params.endpoint, control, (), None, params.keys)
        ask = partial(self._daemon.send, until_s=math.inf)
        self._relay = Relay(ask, allow_commands=params.allow_commands)
        self._command_key = f"tactile/{params.host}/command"
        self._queryables = [
            session.declare_queryable(key, self._asked)
            for key in (f"tactile/{params.host}/control", self._command_key)
        ]

    def run(self) -> None:
        """Forward until `stop`."""
        poller = zmq.Poller()
        for pollable in (*self._daemon.pollables, self._wakeup.fileno()):
            poller.register(pollable, zmq.POLLIN)
        while not self._ended:
            poller.poll(_TURN_MS)
            self._wakeup.clear()
            now_s = time.monotonic()
            while self._queries:
                self._take(self._queries.popleft(), now_s)
            while (reply := self._daemon.take_reply()) is not None:
                self._relay.reply(reply)
            for _ in range(_MOST_AT_ONCE):
                if len(parts := self._daemon.receive()) != 2:
                    break
                self._forward(parts[0], parts[1], now_s)
            self._boards.drop_silent(now_s)

    def stop(self) -> None:
        """End `run` within 0.2 s; from any thread, and from a signal handler, which must take no lock."""
        self._ended = True

    def close(self) -> None:
        """Close all that was opened here."""
        for queryable in self._queryables:
            queryable.undeclare()
        self._boards.close()
        self._token.undeclare()
        self._daemon.close()
        self._wakeup.close()

    def _forward(self, topic: bytes, payload: bytes, now_s: float) -> None:
        name = topic.rsplit(b"/", 1)[-1].decode(errors="replace")
        if name in PER_SCAN and not self._limit.admits(topic, now_s):
            return
        if topic not in self._publishers:
            key = key_of(self._params.host, topic)
            self._publishers[topic] = None if key is None else _publisher(self._session, key, name)
        if (publisher := self._publishers[topic]) is None:
            return
        if name == "status":
            self._boards.heard(topic, now_s)
        is_told = name in ("status", *PER_SCAN)
        publisher.put(payload, attachment=self._thinned if is_told else None)

    def _asked(self, query: "zenoh.Query") -> None:
        """Take a request, in a thread of zenoh."""
        if len(self._queries) >= _MOST_WAITING:
            query.drop()
            return
        self._queries.append(query)
        self._wakeup.set()

    def _take(self, query: "zenoh.Query", now_s: float) -> None:
        # A query for all hosts has a wildcard, and its reply the key of this one.
        may_command = str(query.key_expr) == self._command_key
        key = self._command_key if may_command else f"tactile/{self._params.host}/control"

        def respond(payload: bytes) -> None:
            with suppress(zenoh.ZError):  # the client has gone
                if payload:
                    query.reply(key, payload)
            query.drop()

        payload = b"" if query.payload is None else query.payload.to_bytes()
        self._relay.request(payload, respond, now_s, may_command=may_command)


class LivelyBoards:
    """Tokens of the boards whose status arrives."""

    def __init__(self, session: "zenoh.Session", host: str) -> None:
        self._session = session
        self._host = host
        # Token of each board, and when its newest status was heard.
        self._boards: dict[bytes, tuple[zenoh.LivelinessToken, float]] = {}

    def heard(self, topic: bytes, now_s: float) -> None:
        """Take note of a status."""
        if topic in self._boards:
            token, _ = self._boards[topic]
        else:
            board = chunk_of(topic.decode(errors="replace").split("/")[1])
            token = self._session.liveliness().declare_token(f"tactile/{self._host}/{board}")
            logger.info("tactile/%s/%s is on the network", self._host, board)
        self._boards[topic] = token, now_s

    def drop_silent(self, now_s: float) -> None:
        """Take back the tokens of boards without a status."""
        for topic in [topic for topic, (_, at_s) in self._boards.items() if now_s > at_s + _ALIVE_S]:
            self._boards.pop(topic)[0].undeclare()
            logger.warning("%s: silent, taken from the network", topic.decode(errors="replace"))

    def close(self) -> None:
        """Take back all tokens."""
        for token, _ in self._boards.values():
            token.undeclare()


def _refuse_second(session: "zenoh.Session", host: str) -> None:
    """Refuse a name that another bridge has: subscribers would see two daemons as one."""
    for reply in session.liveliness().get(f"tactile/{host}/*"):
        if reply.ok is not None:
            raise UnavailableError(
                f"{host}: another bridge has this name on the network: give --host another"
            )


def host_name() -> str:
    """Return the name of this host without its domain, as a part of keys."""
    return chunk_of(os.uname().nodename.split(".")[0]) or "host"


def _publisher(session: "zenoh.Session", key: str, topic: str) -> "zenoh.Publisher":
    return session.declare_publisher(
        key,
        encoding="application/msgpack",
        priority=_LAST if topic in PER_SCAN else _FIRST,
        congestion_control=zenoh.CongestionControl.DROP,
        express=topic not in PER_SCAN,
    )

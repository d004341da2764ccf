"""Transport of `tactiled.client` through a zenoh network; the client imports it for ``zenoh://`` endpoints.

`tactiled zenoh` on the host of a daemon publishes its messages under ``tactile/HOST/BOARD/TOPIC``, answers
questions at ``tactile/HOST/control`` and takes commands at ``tactile/HOST/command``. Payloads are those of
ZeroMQ (protocols/events.md, control.md).

zenoh calls back from its own threads. They fill bounded queues, and a socket pair wakes the reader.
"""

import atexit
import logging
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgpack
import zenoh

from tactiled.errors import ConfigError, OperatorError
from tactiled.events.codec import topic_of
from tactiled.zenoh.relay import QUESTIONS
from tactiled.zenoh.session import ZenohAddress, chunk_of, open_session, parse_address, session_config

logger = logging.getLogger(__name__)

_RECEIVE_HIGH_WATER = 2000  # messages, as over ZeroMQ; further ones are dropped, and recovered later
_QUERY_TIMEOUT_S = 5.0
_REACHES_NONE_S = 1.0  # a request that no host takes ends within some milliseconds, a lost one after 5 s
_AGAIN_S = 0.1  # a request that reached no host is repeated then: right after a cut, routes are missing
_RETRY_S = 0.5  # period of looking for a router
_CLOSE_S = 2.0  # a host that drops packets keeps a connection attempt waiting for longer; it ends by itself
_EXIT_S = 10.0  # for the same at the end of a program that did not close its client


def subscription(
    endpoint: str, topics: Sequence[str], board: str | None, keys: Path | None, *, can_ask: bool
) -> "ZenohTransport":
    """Subscribe to a host, and to what it sends of some topics and a board; parameters as for `Client`.

    `ConfigError` as for `parse_address` and `session_config`.
    """
    address = _of_one_host(endpoint, keys)
    return ZenohTransport(address, _keys(address.host, topics, board), address.control if can_ask else "")


def requests(endpoint: str, keys: Path | None) -> "ZenohTransport":
    """Connect to a host for commands; errors as for `subscription`."""
    address = _of_one_host(endpoint, keys)
    return ZenohTransport(address, (), address.command)


def _of_one_host(endpoint: str, keys: Path | None) -> ZenohAddress:
    address = parse_address(endpoint, keys)
    if address.host == "*":
        raise ConfigError("endpoint", [f"{endpoint!r}: one host is needed here: name it"])
    session_config(address)  # faults of the file are the caller's
    return address


def _keys(host: str, topics: Sequence[str], board: str | None) -> list[str]:
    """Keys to subscribe to: only what is wanted crosses the network, and always the status."""
    part = "*" if board is None else chunk_of(topic_of(board, "").split("/")[1])
    wanted = sorted({*topics, "status"}) if topics else ["*"]
    keys = [f"tactile/{host}/{part}/{topic}" for topic in wanted]
    return keys if board is None else [*keys, f"tactile/{host}/-/status"]


class ZenohTransport:
    """Subscriber to some keys, and requests to one; a `Transport` of `tactiled.client`.

    A router that does not answer yet is tried again in a thread, as ZeroMQ does with a daemon.
    """

    def __init__(self, address: ZenohAddress, keys: Sequence[str], request_key: str) -> None:
        self._address, self._keys, self._request_key = address, keys, request_key
        self.thinned: frozenset[str] = frozenset()
        self.fault = ""
        self._arrived: deque[tuple[str, bytes, bytes]] = deque()
        self._replies: deque[bytes] = deque()
        self._unreached: deque[tuple[bytes, float, float]] = deque()  # request, when again, until when
        self._wakeup = WakeUp()
        self.pollables = [self._wakeup.fileno()]
        self._session: zenoh.Session | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._connect, name="tactiled-zenoh-session", daemon=True)
        self._thread.start()
        # A thread that is within zenoh when the interpreter ends would abort the process.
        atexit.register(self._stop, _EXIT_S)

    def _connect(self) -> None:
        """Open the session as soon as a router answers; closed in this thread, too."""
        while not self._closed.is_set():
            try:
                session = open_session(self._address)
            except OperatorError as error:
                if self.fault != (fault := str(error)):
                    logger.warning("%s; tried again every %g s", fault, _RETRY_S)
                self.fault = fault
                self._closed.wait(_RETRY_S)
                continue
            with session:
                # Called in zenoh's thread of the connection: threads of their own would change the order.
                came = zenoh.handlers.Callback(self._came, indirect=False)
                for key in self._keys:
                    session.declare_subscriber(key, came)
                self._session = session
                self._closed.wait()

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""
        if not self._arrived:
            self._clear()
            if not self._arrived:
                return []
        key, payload, thinned = self._arrived.popleft()
        self.thinned = frozenset(thinned.decode(errors="replace").split(",")) if thinned else frozenset()
        root, _, board, topic = key.split("/", 3)
        return [f"{root}/{board}/{topic}".encode(), payload]

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none. Repeats requests that reached no host."""
        now_s = time.monotonic()
        while self._unreached and now_s >= self._unreached[0][1]:
            payload, _, until_s = self._unreached.popleft()
            if now_s < until_s:
                self.send(payload, until_s)
        if not self._replies and not self._arrived:
            self._clear()
        return self._replies.popleft() if self._replies else None

    def _clear(self) -> None:
        """Be not readable until something arrives."""
        self._wakeup.clear()
        if self._arrived or self._replies:
            self._wakeup.set()

    def send(self, payload: bytes, until_s: float) -> bool:
        """Send a request; False while no router answers.

        A question that reaches no host is sent again until then. A command is sent once: a bridge that ends
        while it has the command looks the same from here.
        """
        if self._session is None or not self._request_key:
            return False
        sent_s = time.monotonic()
        may_repeat, is_answered = msgpack.unpackb(payload)["do"] in QUESTIONS, False

        def take(reply: "zenoh.Reply") -> None:
            nonlocal is_answered
            if (sample := reply.ok) is not None:
                is_answered = True
                self._replies.append(sample.payload.to_bytes())
                self._wakeup.set()

        def end() -> None:
            # Of a request that ends later without a reply, nobody knows whether it was carried out.
            now_s = time.monotonic()
            if may_repeat and not is_answered and now_s < sent_s + _REACHES_NONE_S:
                self._unreached.append((payload, now_s + _AGAIN_S, until_s))

        with suppress(zenoh.ZError):  # the session has closed
            self._session.get(
                self._request_key,
                zenoh.handlers.Callback(take, end),
                payload=payload,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                timeout=_QUERY_TIMEOUT_S,
            )
        return True

    def close(self) -> None:
        """Close the session."""
        atexit.unregister(self._stop)
        self._stop(_CLOSE_S)
        self._wakeup.close()

    def _stop(self, wait_s: float) -> None:
        self._closed.set()
        self._thread.join(wait_s)

    def _came(self, sample: "zenoh.Sample") -> None:
        if len(self._arrived) < _RECEIVE_HIGH_WATER:
            attachment = sample.attachment
            thinned = b"" if attachment is None else attachment.to_bytes()
            self._arrived.append((str(sample.key_expr), sample.payload.to_bytes(), thinned))
        self._wakeup.set()


class WakeUp:
    """Descriptor that is readable from `set` to `clear`, for pollers of another thread."""

    def __init__(self) -> None:
        self._reader, self._writer = socket.socketpair()
        self._reader.setblocking(False)
        self._writer.setblocking(False)

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._reader.fileno()

    def set(self) -> None:
        """Make it readable; from any thread."""
        with suppress(OSError):  # full, so that it is readable, or closed meanwhile
            self._writer.send(b"\0")

    def clear(self) -> None:
        """Make it not readable, before looking at what was set."""
        with suppress(BlockingIOError):
            while self._reader.recv(4096):
                pass

    def close(self) -> None:
        """Close it."""
        self._reader.close()
        self._writer.close()

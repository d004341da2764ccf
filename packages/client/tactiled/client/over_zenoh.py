"""Subscription and requests through a zenoh network, for endpoints such as ``zenoh://router:7447/robot7``.

`tactiled zenoh` on the host of a daemon publishes its messages under ``tactile/HOST/BOARD/TOPIC``, answers
questions at ``tactile/HOST/control`` and takes commands at ``tactile/HOST/command``. Payloads are those of
ZeroMQ (protocols/events.md, control.md).

zenoh calls back from its own threads. They fill bounded queues, and a socket pair wakes the reader.
"""

import atexit
import json
import logging
import queue
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgpack

from tactiled.client.catchup import PATIENT_HOLD_S
from tactiled.errors import ConfigError, OperatorError, UnavailableError, install_command
from tactiled.events.codec import topic_of
from tactiled.events.endpoints import ZENOH_SCHEME

logger = logging.getLogger(__name__)

try:
    import zenoh
except ModuleNotFoundError:
    command = install_command("zenoh", "tactiled-client")
    raise OperatorError(f"zenoh:// endpoints need zenoh: {command}") from None

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
_RECEIVE_HIGH_WATER = 2000  # messages, as over ZeroMQ; further ones are dropped, and recovered later
_QUERY_TIMEOUT_S = 5.0
# A request that reached no host is repeated while it may be of use: right after a cut, routes are missing.
_AGAIN_S = 0.1
_REACHES_NONE_S = 1.0  # a request that no host takes ends within some milliseconds, a lost one after 5 s
_TRIES = round(PATIENT_HOLD_S / _AGAIN_S)
_RETRY_S = 0.5  # period of looking for a router
_CLOSE_S = 2.0  # a host that drops packets keeps a connection attempt waiting for longer; it ends by itself
_EXIT_S = 10.0  # for the same at the end of a program that did not close its client
_LONGEST_CHUNK = 128


@dataclass(frozen=True)
class ZenohAddress:
    """Parts of an endpoint ``zenoh://ROUTER:PORT/HOST?config=FILE``."""

    router: str  # locator, such as ``tcp/router:7447``; empty: the file of the configuration has it
    host: str  # name under which `tactiled zenoh` publishes; ``*`` for all hosts
    config: Path | None  # configuration of zenoh (JSON5)

    @property
    def control(self) -> str:
        """Key of the questions."""
        return f"tactile/{self.host}/control"

    @property
    def command(self) -> str:
        """Key of the commands: one of its own, so that routers can tell who may use it."""
        return f"tactile/{self.host}/command"


def parse_address(endpoint: str, keys: Path | None = None) -> ZenohAddress:
    """Parse an endpoint.

    `keys` is a configuration of zenoh with the certificates of this client; the endpoint may name it instead.
    With it, the router is reached over TLS.

    Raises
    ------
    ConfigError
        It names no host, or has other faults.
    """
    form = f"it should look like {ZENOH_SCHEME}ROUTER:7447/HOST"
    try:
        url = urlsplit(endpoint)
        port = url.port
    except ValueError as error:
        raise ConfigError("endpoint", [f"{endpoint!r}: {error}; {form}"]) from None
    if not endpoint.startswith(ZENOH_SCHEME):
        raise ConfigError("endpoint", [f"{endpoint!r} is none of zenoh; {form}"])
    host = url.path.strip("/")
    if not is_chunk(host) and host != "*":
        raise ConfigError("endpoint", [f"{endpoint!r} names no host; {form}"])
    named = parse_qs(url.query).get("config", [])
    config = keys or (Path(named[0]) if named else None)
    router = ""
    if url.hostname:
        name = f"[{url.hostname}]" if ":" in url.hostname else url.hostname
        router = f"{'tcp' if config is None else 'tls'}/{name}:{port or 7447}"
    elif config is None:
        router = DEFAULT_ROUTER
    return ZenohAddress(router, host, config)


def is_chunk(name: str) -> bool:
    """Return True for a name that can stand between two slashes of a key of zenoh."""
    return 0 < len(name) <= _LONGEST_CHUNK and name.isprintable() and not set(name) & set("/*$?# @")


def quiet_config(file: Path | None) -> "zenoh.Config":
    """Read a configuration of zenoh; where it does not say otherwise, a client that looks for nobody.

    Raises
    ------
    zenoh.ZError
        The file cannot be read.
    """
    config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
    for key, value in (("mode", '"client"'), ("scouting/multicast/enabled", "false")):
        if config.get_json(key) == "null":
            config.insert_json5(key, value)
    config.insert_json5("transport/shared_memory/enabled", "false")  # for payloads far larger than ours
    return config


def session_config(address: ZenohAddress) -> "zenoh.Config":
    """Make the configuration of a session in the mode `client`, which listens nowhere.

    Raises
    ------
    ConfigError
        The file cannot be read.
    """
    try:
        config = quiet_config(address.config)
        config.insert_json5("mode", '"client"')
        if address.router:
            config.insert_json5("connect/endpoints", json.dumps([address.router]))
    except zenoh.ZError as error:
        raise ConfigError(str(address.config or "endpoint"), [words_of(error)]) from None
    return config


def open_session(address: ZenohAddress) -> "zenoh.Session":
    """Open a session.

    Raises
    ------
    ConfigError
        The configuration cannot be read.
    UnavailableError
        The router does not answer.
    """
    try:
        return zenoh.open(session_config(address))
    except zenoh.ZError as error:
        where = address.router or str(address.config)
        raise UnavailableError(
            f"{where}: no session with a router of zenoh there: {words_of(error)}"
        ) from None


def words_of(error: "zenoh.ZError") -> str:
    """Return the message of an error of zenoh, without the places in its source."""
    return re.sub(r"\s+at /\S+", "", str(error)).strip()


class ZenohTransport:
    """Subscriber of one host, and requests to it; a `Transport`.

    A router that does not answer yet is tried again in a thread, as ZeroMQ does with a daemon.

    Raises
    ------
    ConfigError
        As for `parse_address` and `session_config`.
    """

    def __init__(
        self, endpoint: str, topics: Sequence[str], board: str | None, keys: Path | None, *, can_ask: bool
    ) -> None:
        self._address = parse_address(endpoint, keys)
        if self._address.host == "*":
            raise ConfigError("endpoint", [f"{endpoint!r}: a subscription is for one host: name it"])
        session_config(self._address)  # faults of the file are the caller's
        self.thinned: frozenset[str] = frozenset()
        self._can_ask = can_ask
        self._keys = _keys(self._address.host, topics, board)
        self._arrived: deque[tuple[str, bytes, bytes]] = deque()
        self._replies: deque[bytes] = deque()
        self._wakeup = WakeUp()
        self.pollables = [self._wakeup.fileno()]
        self._session: zenoh.Session | None = None
        self._closed = threading.Event()
        self._unreached: queue.SimpleQueue[tuple[float, bytes, int] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._connect, name="tactiled-zenoh-session", daemon=True)
        self._thread.start()
        # A thread that is within zenoh when the interpreter ends would abort the process.
        atexit.register(self._stop, _EXIT_S)

    def _connect(self) -> None:
        """Open the session as soon as a router answers, and serve it; closed in this thread, too."""
        fault = ""
        while not self._closed.is_set():
            try:
                session = open_session(self._address)
            except OperatorError as error:
                if fault != (fault := str(error)):
                    logger.warning("%s; tried again every %g s", fault, _RETRY_S)
                self._closed.wait(_RETRY_S)
                continue
            with session:
                self._serve(session)

    def _serve(self, session: "zenoh.Session") -> None:
        """Subscribe, and repeat the requests that reached no host until closed."""
        # Called in zenoh's thread of the connection: threads of their own would change the order of topics.
        came = zenoh.handlers.Callback(self._came, indirect=False)
        for key in self._keys:
            session.declare_subscriber(key, came)
        self._session = session
        while (entry := self._unreached.get()) is not None:
            due_s, payload, tries = entry
            if self._closed.wait(max(0.0, due_s - time.monotonic())):
                return
            self._ask(session, payload, tries)

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""
        if not self._arrived:
            self._wakeup.clear()
            if self._replies:
                self._wakeup.set()
            if not self._arrived:
                return []
        key, payload, thinned = self._arrived.popleft()
        self.thinned = frozenset(thinned.decode(errors="replace").split(",")) if thinned else frozenset()
        root, _, board, topic = key.split("/", 3)
        return [f"{root}/{board}/{topic}".encode(), payload]

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none."""
        return self._replies.popleft() if self._replies else None

    def send(self, payload: bytes) -> bool:
        """Send a request, again and again while it reaches no host; False while no router answers."""
        if self._session is None or not self._can_ask:
            return False
        self._ask(self._session, payload, _TRIES)
        return True

    def close(self) -> None:
        """Close the session."""
        atexit.unregister(self._stop)
        self._stop(_CLOSE_S)
        self._wakeup.close()

    def _stop(self, wait_s: float) -> None:
        self._closed.set()
        self._unreached.put(None)
        self._thread.join(wait_s)

    def _ask(self, session: "zenoh.Session", payload: bytes, tries: int) -> None:
        def repeat() -> None:
            if tries > 0:
                self._unreached.put((time.monotonic() + _AGAIN_S, payload, tries - 1))

        ask(session, self._address.control, payload, self._answered, repeat)

    def _came(self, sample: "zenoh.Sample") -> None:
        if len(self._arrived) < _RECEIVE_HIGH_WATER:
            attachment = sample.attachment
            thinned = b"" if attachment is None else attachment.to_bytes()
            self._arrived.append((str(sample.key_expr), sample.payload.to_bytes(), thinned))
        self._wakeup.set()

    def _answered(self, payload: bytes) -> None:
        self._replies.append(payload)
        self._wakeup.set()


def ask(
    session: "zenoh.Session",
    key: str,
    payload: bytes,
    answered: Callable[[bytes], None],
    unreached: Callable[[], None],
) -> None:
    """Send a request; zenoh's threads call `answered` with each reply, or `unreached` where there is none."""
    replied: list[bool] = []

    def take(reply: "zenoh.Reply") -> None:
        if (sample := reply.ok) is not None:
            replied.append(True)
            answered(sample.payload.to_bytes())

    with suppress(zenoh.ZError):  # the session has closed
        session.get(
            key,
            zenoh.handlers.Callback(take, lambda: None if replied else unreached()),
            payload=payload,
            consolidation=zenoh.ConsolidationMode.NONE,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            timeout=_QUERY_TIMEOUT_S,
        )


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


class Caller:
    """Requests with one reply each, for commands."""

    def __init__(self, endpoint: str, keys: Path | None) -> None:
        address = parse_address(endpoint, keys)
        self._key = address.command
        self._session = open_session(address)

    def call(self, payload: bytes, timeout_s: float) -> bytes | None:
        """Send a request, and return its reply; None after `timeout_s`, or where the reply was lost.

        A request that ends at once without a reply has reached no host, and is sent again. Of one that ends
        later, nobody knows whether it was carried out.
        """
        until_s = time.monotonic() + timeout_s
        replies: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        while (left_s := until_s - (sent_s := time.monotonic())) > 0:
            ask(self._session, self._key, payload, replies.put, lambda: replies.put(b""))
            with suppress(queue.Empty):
                if reply := replies.get(timeout=left_s):
                    return reply
                if time.monotonic() > sent_s + _REACHES_NONE_S:
                    return None
                time.sleep(_AGAIN_S)
        return None

    def close(self) -> None:
        """Close the session."""
        self._session.close()


def states(endpoint: str, keys: Path | None, timeout_s: float) -> dict[str, dict[str, Any] | None]:
    """Return the replies of all hosts to ``state`` (protocols/control.md); None for a host that is silent.

    The endpoint is ``zenoh://ROUTER:7447/*``, or has one host. `timeout_s` is for the slowest host. Tokens of
    bridge and boards make a host known.
    """
    address = parse_address(endpoint, keys)
    with open_session(address) as session:
        found: dict[str, dict[str, Any] | None] = {}
        for reply in session.liveliness().get(f"tactile/{address.host}/*", timeout=timeout_s):
            if (sample := reply.ok) is not None:
                found.setdefault(str(sample.key_expr).split("/")[1], None)
        request = msgpack.packb({"v": 1, "id": f"state-{session.zid()}", "do": "state"})
        for reply in session.get(
            address.control,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=request,
            timeout=timeout_s,
        ):
            if (sample := reply.ok) is not None:
                with suppress(ValueError, msgpack.exceptions.UnpackException):
                    found[str(sample.key_expr).split("/")[1]] = msgpack.unpackb(sample.payload.to_bytes())
        return found


def spread(endpoints: Sequence[str], keys: Path | None, timeout_s: float) -> tuple[str, ...]:
    """Replace endpoints of all hosts (``zenoh://ROUTER:7447/*``) by one for each host that is there now.

    Raises
    ------
    UnavailableError
        There is none, or the router does not answer.
    """
    found: list[str] = []
    for endpoint in endpoints:
        path, query, options = endpoint.partition("?")
        if not (endpoint.startswith(ZENOH_SCHEME) and path.endswith("/*")):
            found.append(endpoint)
            continue
        hosts = sorted(states(endpoint, keys, timeout_s))
        if not hosts:
            raise UnavailableError(f"{endpoint}: no host of tactiled is on this network")
        found += [f"{path[:-1]}{host}{query}{options}" for host in hosts]
    return tuple(found)


def _keys(host: str, topics: Sequence[str], board: str | None) -> list[str]:
    """Keys to subscribe to: only what is wanted crosses the network, and always the status."""
    boards = ["*"] if board is None else [zenoh_chunk(topic_of(board, "").split("/")[1]), "-"]
    if not topics:
        return [f"tactile/{host}/{one}/{'*' if one != '-' else 'status'}" for one in boards]
    wanted = sorted({*topics, "status"})
    keys = [f"tactile/{host}/{boards[0]}/{topic}" for topic in wanted]
    return keys if board is None else [*keys, f"tactile/{host}/-/status"]


def zenoh_chunk(name: str) -> str:
    """Return a name with ``-`` for the characters that have a meaning in keys of zenoh."""
    return "".join("-" if c in "*$?#@" else c for c in name)

"""Transports of subscriptions and commands, and the ZeroMQ sockets of clients, with keys where a daemon asks.

`ZmqTransport` is the connection to a daemon over ZeroMQ; the distribution tactiled-zenoh has that over zenoh.
Both carry the same payloads, so that an `Inbox` cannot tell them apart.
"""

import importlib
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import zmq

from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.events.codec import topic_of
from tactiled.events.endpoints import DEAD_PEER_OPTIONS, DEFAULT_ENDPOINT, ZENOH_SCHEME
from tactiled.outside import read_secret

RETRY_MS = 10  # interval of sending a request while the daemon is not connected
_RECEIVE_HIGH_WATER = 2000  # as the publisher's: a pause of some 18 s loses nothing
# The largest message has some 40 kB (4096 channels); libzmq disconnects from larger ones.
_LARGEST_BYTES = 1 << 20
_REQUEST_HIGH_WATER = 64
_RECONNECT_MS = 30  # requests wait for the connection to a daemon that restarts; libzmq's default is 100


class Transport(Protocol):
    """Connection of one subscription or of commands; no method waits."""

    thinned: frozenset[str]
    """Topics of which the newest received message says that not every message is sent."""
    fault: str
    """Words on why there is no connection; empty where nobody knows."""

    @property
    def pollables(self) -> Sequence[Any]:
        """Sockets or descriptors that become readable when something has arrived."""

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none."""

    def send(self, payload: bytes, until_s: float) -> bool:
        """Send a request, of use until then (``time.monotonic()``); False where that is not possible now."""

    def close(self) -> None:
        """Close the connection."""


def open_transport(
    make_context: type[zmq.Context[Any]],
    endpoint: str,
    control: str,
    topics: Sequence[str],
    board: str | None,
    keys: Path | None,
) -> Transport:
    """Connect to a daemon; parameters and errors as for `Client`.

    An empty `control` means that no requests are sent. `make_context` is the kind of ZeroMQ's context, for
    asyncio or not.
    """
    if not endpoint.startswith(ZENOH_SCHEME):
        return ZmqTransport(make_context(), endpoint, control or None, topics, board, keys)
    if control not in ("", endpoint):
        raise OperatorError(
            "control: requests over zenoh go to the host that the endpoint names: leave it out"
        )
    return over_zenoh().subscription(endpoint, topics, board, keys, can_ask=bool(control))  # type: ignore[no-any-return]


def open_requests(make_context: type[zmq.Context[Any]], control: str, keys: Path | None) -> Transport:
    """Connect to a daemon for commands; `make_context` as for `open_transport`, errors as for `Client`."""
    if control.startswith(ZENOH_SCHEME):
        return over_zenoh().requests(control, keys)  # type: ignore[no-any-return]
    return ZmqTransport(make_context(), None, control, (), None, keys)


def over_zenoh() -> Any:
    """Import what serves ``zenoh://`` endpoints; `OperatorError` where that distribution is not installed."""
    try:
        return importlib.import_module("tactiled.zenoh.transport")
    except ModuleNotFoundError as error:
        words = f"install tactiled-zenoh, as in pip install ./packages/client ./packages/zenoh ({error})"
        raise OperatorError(f"{ZENOH_SCHEME} endpoints: {words}") from None


class ZmqTransport:
    """SUB socket for events, and DEALER for requests; `close` terminates their context.

    Where the endpoint of events is None, or that of requests (`control`), there is no such socket.
    """

    thinned: frozenset[str] = frozenset()
    fault = ""

    def __init__(
        self,
        context: zmq.Context[Any],
        endpoint: str | None,
        control: str | None,
        topics: Sequence[str],
        board: str | None,
        keys: Path | None,
    ) -> None:
        self._context = context
        self.pollables: list[zmq.Socket[Any]] = []
        # Blocking shadows read without waiting, also from the sockets of asyncio.
        self._events: zmq.Socket[bytes] | None = None
        self._control: zmq.Socket[bytes] | None = None
        try:
            if endpoint is not None:
                self._events = self._socket(zmq.SUB)
                _connect_events(self._events, endpoint, topics, board, keys)
            if control is not None:
                self._control = self._socket(zmq.DEALER)
                _connect_requests(self._control, control, keys)
        except BaseException:
            self.close()
            raise

    def _socket(self, kind: int) -> "zmq.Socket[bytes]":
        self.pollables.append(self._context.socket(kind))
        return zmq.Socket.shadow(self.pollables[-1].underlying)

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""
        return _take(self._events)

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none."""
        parts = _take(self._control)
        return parts[-1] if parts else None

    def send(self, payload: bytes, until_s: float) -> bool:  # noqa: ARG002  a request that was sent arrives
        """Send a request; False while the daemon is not connected."""
        if self._control is None:
            return False
        try:
            self._control.send(payload, zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def close(self) -> None:
        """Close the sockets."""
        for sock in self.pollables:
            sock.close(linger=0)
        self._context.term()


def _take(sock: "zmq.Socket[bytes] | None") -> list[bytes]:
    """Return the parts of a message that has arrived; empty for none, and without a socket."""
    try:
        part = None if sock is None else sock.recv(zmq.NOBLOCK, copy=False)
        parts = []
        while part is not None:  # a frame knows whether another follows: to ask the socket takes longer
            parts.append(part.bytes)
            part = sock.recv(zmq.NOBLOCK, copy=False) if sock is not None and part.more else None
    except zmq.Again:
        return []
    return parts


def _connect_events(
    sock: zmq.Socket[Any], endpoint: str, topics: Sequence[str], board: str | None, keys: Path | None
) -> None:
    """Set up a SUB socket and connect it; parameters and errors as for `Client`."""
    sock.setsockopt(zmq.RCVHWM, _RECEIVE_HIGH_WATER)
    if board is None:
        prefixes = ["tactile/"]  # the topic comes after the board, so the inbox filters by it
    else:
        wanted = {*topics, "status"} if topics else {""}
        prefixes = [topic_of(board, topic) for topic in sorted(wanted)] + [topic_of("", "status")]
    for prefix in prefixes:
        sock.setsockopt(zmq.SUBSCRIBE, prefix.encode())
    _connect(sock, endpoint, keys)


def _connect_requests(sock: zmq.Socket[Any], endpoint: str, keys: Path | None) -> None:
    """Set up a DEALER socket and connect it; it accepts requests only while it is connected."""
    sock.setsockopt(zmq.SNDHWM, _REQUEST_HIGH_WATER)
    sock.setsockopt(zmq.RCVHWM, _REQUEST_HIGH_WATER)
    sock.setsockopt(zmq.IMMEDIATE, 1)
    sock.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS)
    _connect(sock, endpoint, keys)


def _connect(sock: zmq.Socket[Any], endpoint: str, keys: Path | None) -> None:
    sock.setsockopt(zmq.MAXMSGSIZE, _LARGEST_BYTES)
    sock.setsockopt(zmq.IPV6, 1)
    sock.setsockopt(zmq.LINGER, 0)
    for name, value in DEAD_PEER_OPTIONS.items():
        sock.setsockopt(getattr(zmq, name), value)
    if keys is not None:
        options = (zmq.CURVE_PUBLICKEY, zmq.CURVE_SECRETKEY, zmq.CURVE_SERVERKEY)
        try:
            for option, key in zip(options, _read_keys(keys), strict=True):
                sock.setsockopt(option, key)
        except zmq.ZMQError:
            raise ConfigError(str(keys), ["a key is no text in Z85"]) from None
    try:
        sock.connect(endpoint)
    except zmq.ZMQError as error:
        fault = f"{endpoint!r}: {error.strerror}; it should look like {DEFAULT_ENDPOINT}"
        raise ConfigError("endpoint", [fault]) from None


def _read_keys(path: Path) -> list[bytes]:
    """Keys in a file of `tactiled keys make`: public and secret of the client, public of the daemon."""
    try:
        document = tomllib.loads(read_secret(path))
        names = ("public_key", "secret_key", "daemon_key")
        keys = [str(document[name]).encode("ascii") for name in names]
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except (DataError, ValueError, KeyError, RecursionError) as error:  # no TOML, no ASCII, a key is missing
        raise ConfigError(str(path), [f"is no file of `tactiled keys make`: {error}"]) from None
    if any(len(key) != 40 for key in keys):
        raise ConfigError(str(path), ["a key has 40 characters"])
    return keys

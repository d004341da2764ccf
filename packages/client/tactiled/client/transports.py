"""Transports of a subscription: what arrives, what is asked, and what to wait for.

`ZmqTransport` is the connection to a daemon over ZeroMQ; `tactiled.client.over_zenoh` has that over zenoh.
Both carry the same payloads, so that an `Inbox` cannot tell them apart.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import zmq

from tactiled.client import connect
from tactiled.client.catchup import HOLD_S
from tactiled.errors import OperatorError
from tactiled.events.endpoints import ZENOH_SCHEME, control_endpoint


class Transport(Protocol):
    """Connection of one subscription; no method waits."""

    thinned: frozenset[str]
    """Topics of which the newest received message says that not every message is sent."""
    is_patient: bool
    """True where topics overtake each other, and requests are repeated while nothing is received."""
    hold_s: float
    """Longest delay of a message behind a hole, seconds."""

    @property
    def pollables(self) -> Sequence[Any]:
        """Sockets or descriptors that become readable when something has arrived."""

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none."""

    def send(self, payload: bytes) -> bool:
        """Send a request; False where that is not possible now."""

    def close(self) -> None:
        """Close the connection."""


class ZmqTransport:
    """SUB socket for events, and DEALER for requests.

    Parameters
    ----------
    context : zmq.Context
        Of the sockets; terminated by `close`.
    control : str
        Endpoint for requests; empty: none are sent.
    topics, board, keys
        As for `Client`.
    """

    thinned: frozenset[str] = frozenset()
    is_patient = False
    hold_s = HOLD_S

    def __init__(
        self,
        context: zmq.Context[Any],
        endpoint: str,
        control: str,
        topics: Sequence[str],
        board: str | None,
        keys: Path | None,
    ) -> None:
        self._context = context
        self.pollables: list[zmq.Socket[Any]] = [context.socket(zmq.SUB)]
        if control:
            self.pollables.append(context.socket(zmq.DEALER))
        try:
            connect.subscribe(self.pollables[0], endpoint, topics, board, keys)
            if control:
                connect.ask(self.pollables[1], control, keys)
        except BaseException:
            self.close()
            raise
        # Blocking shadows read without waiting, also from the sockets of asyncio.
        shadows: list[zmq.Socket[bytes]] = [zmq.Socket.shadow(sock.underlying) for sock in self.pollables]
        self._events = shadows[0]
        self._control = shadows[1] if control else None

    def receive(self) -> list[bytes]:
        """Return topic and payload of a message that has arrived; empty for none."""
        return take(self._events)

    def take_reply(self) -> bytes | None:
        """Return a reply that has arrived; None for none."""
        parts = [] if self._control is None else take(self._control)
        return parts[-1] if parts else None

    def send(self, payload: bytes) -> bool:
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


def open_transport(
    make_context: type[zmq.Context[Any]],
    endpoint: str,
    control: str | None,
    topics: Sequence[str],
    board: str | None,
    keys: Path | None,
) -> Transport:
    """Connect to a daemon; parameters and errors as for `Client`.

    Parameters
    ----------
    make_context : type
        Kind of ZeroMQ's context, for asyncio or not.
    """
    if endpoint.startswith(ZENOH_SCHEME):
        return _over_zenoh(endpoint, control, topics, board, keys)
    requests = control_endpoint(endpoint) if control is None else control
    return ZmqTransport(make_context(), endpoint, requests, topics, board, keys)


def _over_zenoh(
    endpoint: str, control: str | None, topics: Sequence[str], board: str | None, keys: Path | None
) -> Transport:
    if control:
        raise OperatorError(
            "control: requests over zenoh go to the host that the endpoint names: leave it out"
        )
    from tactiled.client.over_zenoh import ZenohTransport  # zenoh is an extra

    return ZenohTransport(endpoint, topics, board, keys, can_ask=control is None)


def take(sock: zmq.Socket[bytes]) -> list[bytes]:
    """Return the parts of a message that has arrived; empty for none."""
    try:
        return sock.recv_multipart(zmq.NOBLOCK)
    except zmq.Again:
        return []

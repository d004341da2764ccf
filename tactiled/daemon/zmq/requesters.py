"""ROUTER endpoints without keys: requests of any program of this host, in turn, and replies to each."""

import itertools
import time
from dataclasses import dataclass, field

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.control import REPLY_BYTES, Control
from tactiled.daemon.zmq.peers import Bounds, Peer, PeerServer, Queued
from tactiled.daemon.zmq.requests import LONGEST_BYTES, Requester
from tactiled.daemon.zmq.zmtp import Part, Value

# Four of the longest replies. A request costs at most some 0.3 ms.
BOUNDS = Bounds(LONGEST_BYTES, 4 * REPLY_BYTES, turns_per_s=500.0)
# Parts of a request: number of a correlating REQ, empty part of a REQ, payload.
_MOST_PARTS = 3


@dataclass
class _Connection:
    name: str
    parts: list[bytes] = field(default_factory=list)
    n_parts: int = 0


class Requesters(PeerServer):
    """Pass requests to a `Control`.

    Parameters
    ----------
    commands_over_tcp : bool
        Take commands over TCP too.
    """

    def __init__(self, control: Control, *, commands_over_tcp: bool) -> None:
        super().__init__("ROUTER", ("DEALER", "REQ", "ROUTER"), BOUNDS)
        self._control = control
        self._commands_over_tcp = commands_over_tcp
        self._numbers = itertools.count()
        self._connections: dict[Peer, _Connection] = {}

    def _take(self, peer: Peer, value: Value) -> bool:
        if not isinstance(value, Part):
            return False
        peer.is_idle = False
        connection = self._connections.get(peer)
        if connection is None:
            # A client that chose its identity keeps its connection when it comes back.
            own = f"identity {peer.identity.hex()}" if peer.identity else f"number {next(self._numbers)}"
            connection = self._connections[peer] = _Connection(f"{own} of {peer} {peer.pid}")
        connection.n_parts += 1
        if connection.n_parts <= _MOST_PARTS:
            connection.parts.append(value.body)
        if value.more:
            return False
        self._answer(peer, connection)
        connection.parts, connection.n_parts = [], 0
        return True

    def _answer(self, peer: Peer, connection: _Connection) -> None:
        now_s = time.monotonic()
        *envelope, payload = connection.parts
        if connection.n_parts > _MOST_PARTS or (envelope and envelope[-1]):
            self._control.bad.add(f"{connection.n_parts} frames: send one", now_s)
            return

        def respond(reply: bytes) -> None:
            self._send(peer, Queued("", zmtp.message(*envelope, reply)))

        requester = Requester(
            connection=connection.name,
            uid=peer.uid,
            address=peer.address,
            may_command=peer.uid >= 0 or self._commands_over_tcp,
        )
        try:
            self._control.take(payload, requester, now_s, respond)
        except Exception as error:  # a bug in the control channel must not stop sensing
            self._control.bad.add(f"a fault of tactiled, please report it: {error!r}", now_s)

    def _gone(self, peer: Peer) -> None:
        self._connections.pop(peer, None)

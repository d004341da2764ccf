"""All endpoints of the daemon: for events, for requests, and for the authentication of other hosts.

Plain endpoints are served by `EventServer` and `RequestServer`, in which everything of a peer is bounded.
Those with keys are sockets of libzmq, which does not bound the subscriptions of a peer, nor the frames of a
message before the last one has arrived: a client with a key can exhaust the memory (protocols/control.md).

A request costs at most some 0.3 ms, and their rate is limited. Nothing here is on the path from board to
subscriber.
"""

import asyncio
import contextlib
import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import zmq
import zmq.asyncio

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.control import LONGEST_REPLY_BYTES, CommandedBoard, Control
from tactiled.daemon.zmq.endpoints import bind
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.peers import HANDSHAKE_S, Bounds, Peer, PeerServer, Queued, StepLimit
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import LONGEST_BYTES, Requester
from tactiled.daemon.zmq.security import CurveAuthenticator, KeyFolder
from tactiled.daemon.zmq.zmtp import Part, Value

_LOG_PERIOD_S = 1.0  # of the counts of repeated conditions
# Length of the queues of each client: 16 requests of at most 16 KiB, 16 replies of at most some 140 kB.
_HIGH_WATER = 16
# Parts of a request: number of a correlating REQ, empty part of a REQ, payload.
_MOST_PARTS = 3
# The longest reply is kept for a client, or eight with missed messages. A request costs some 0.3 ms at most.
BOUNDS = Bounds(LONGEST_BYTES, LONGEST_REPLY_BYTES + 1024, steps_per_s=500.0)


@dataclass
class _Connection:
    name: str
    parts: list[bytes] = field(default_factory=list)  # of a request that is not complete


class RequestServer(PeerServer):
    """ROUTER endpoints without keys: requests of any program of this host, in turn, and replies to each."""

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
            connection = self._connections[peer] = _Connection(f"{next(self._numbers)} of {peer}")
        if len(connection.parts) <= _MOST_PARTS:  # with one more, there are too many
            connection.parts.append(value.body)
        if value.more:
            return False
        self._answer(peer, connection)
        connection.parts = []
        return True

    def _answer(self, peer: Peer, connection: _Connection) -> None:
        requester = Requester(
            connection=connection.name,
            uid=peer.uid,
            address=peer.address,
            may_command=peer.uid >= 0 or self._commands_over_tcp,
        )
        if reply := _reply(self._control, connection.parts, requester):
            self._send(peer, Queued(zmtp.message(*reply)))

    def _gone(self, peer: Peer) -> None:
        self._connections.pop(peer, None)


class Network:
    """Publisher and control server of boards that share endpoints, with one authenticator.

    `ConfigError` or `OperatorError` if an endpoint can never be bound, or there are no keys;
    `UnavailableError` if one cannot be bound now.
    """

    def __init__(
        self,
        params: PublishParams,
        boards: Sequence[CommandedBoard],
        n_boards: int = 1,
    ) -> None:
        plain = [endpoint for endpoint in params.control if not params.is_guarded(endpoint)]
        guarded = [endpoint for endpoint in params.control if params.is_guarded(endpoint)]
        with contextlib.ExitStack() as opened:
            authenticator = None
            if guarded or any(map(params.is_guarded, params.endpoints)):
                context = zmq.Context()
                opened.callback(context.term)
                authenticator = CurveAuthenticator(context, KeyFolder(Path(params.keys or "")))
                opened.callback(authenticator.close)
            self.publisher = Publisher(params, authenticator, n_boards)
            opened.callback(self.publisher.close)
            self.control = Control(self.publisher, boards)
            requests = RequestServer(self.control, commands_over_tcp=params.allow_commands_over_tcp)
            opened.callback(requests.close)
            for endpoint in plain:
                requests.listen(endpoint)
            events = self.publisher.server
            self._servers = [requests.run, events.run]
            self._logs = [self.control.bad, self.control.commanded, requests.refused, events.refused]
            if authenticator is not None:
                guarded_requests = GuardedRequestServer(guarded, self.control, authenticator)
                opened.callback(guarded_requests.close)
                self._servers += [guarded_requests.run, authenticator.run]
                self._logs += [authenticator.denied, authenticator.accepted]
            self._opened = opened.pop_all()

    async def run(self) -> None:
        """Serve until cancelled."""
        async with asyncio.TaskGroup() as group:
            for run in self._servers:
                group.create_task(run())
            while True:  # also without endpoints
                for log in self._logs:
                    log.write_counts(time.monotonic())
                await asyncio.sleep(_LOG_PERIOD_S)

    def close(self) -> None:
        """Send queued events, then close all sockets."""
        self._opened.close()


class GuardedRequestServer:
    """ROUTER socket of libzmq that passes requests of clients with keys to a `Control`."""

    def __init__(self, endpoints: Sequence[str], control: Control, authenticator: CurveAuthenticator) -> None:
        self._control = control
        sock = self._socket = zmq.asyncio.Socket(authenticator.context, zmq.ROUTER)
        sock.setsockopt(zmq.RCVHWM, _HIGH_WATER)
        sock.setsockopt(zmq.SNDHWM, _HIGH_WATER)
        sock.setsockopt(zmq.HANDSHAKE_IVL, round(1000 * HANDSHAKE_S))
        sock.setsockopt(zmq.LINGER, 0)
        authenticator.guard(sock, LONGEST_BYTES)
        try:
            for endpoint in endpoints:
                bind(sock, endpoint)
        except BaseException:
            self.close()
            raise

    async def run(self) -> None:
        """Serve until cancelled."""
        plain: zmq.Socket[bytes] = zmq.Socket.shadow(self._socket.underlying)
        limit = StepLimit(BOUNDS.steps_per_s)
        while True:
            await self._socket.poll()
            frames = await _receive(plain)
            if frames:
                self._take(plain, frames)
            await limit.wait()

    def close(self) -> None:
        """Close the socket, without sending queued replies."""
        self._socket.close(0)

    def _take(self, sock: zmq.Socket[bytes], frames: list[zmq.Frame]) -> None:
        identity, *parts = (frame.bytes for frame in frames)  # libzmq puts the identity first
        if parts and (reply := _reply(self._control, parts, self._requester(identity, frames[-1]))):
            # A reply to a client that has left, or does not read its replies, libzmq drops by itself.
            sock.send_multipart([identity, *reply], zmq.NOBLOCK)

    def _requester(self, routing_id: bytes, frame: zmq.Frame) -> Requester:
        key, peer = _property(frame, "User-Id"), _property(frame, "Peer-Address")
        return Requester(
            connection=f"{routing_id.hex()} {peer}",
            key=key,
            address=peer.removeprefix("::ffff:"),  # an IPv4 address in IPv6 notation
            may_command=bool(key),
        )


def _reply(control: Control, parts: list[bytes], requester: Requester) -> list[bytes]:
    """Return the parts of the reply to a request; none to parts that are no request."""
    now_s = time.monotonic()
    *envelope, payload = parts
    if len(envelope) >= _MOST_PARTS or (envelope and envelope[-1]):
        control.bad.add("a request of several frames: send one", now_s)
        return []
    return [*envelope, control.answer(payload, requester, now_s)]


async def _receive(sock: zmq.Socket[bytes]) -> list[zmq.Frame]:
    """Receive a message, cut to the identity and one frame more than a request has; empty for none."""
    frames: list[zmq.Frame] = []
    dropped = 0
    try:
        while not frames or frames[-1].more:
            frame = sock.recv(zmq.NOBLOCK, copy=False)
            if len(frames) == 2 + _MOST_PARTS:
                frames.pop()
                dropped += 1
                if dropped % 100 == 0:
                    await asyncio.sleep(0)  # a million frames must not block the event loop
            frames.append(frame)
    except zmq.Again:
        pass
    return frames


def _property(frame: zmq.Frame, name: str) -> str:
    """Property of the sender as libzmq has it, empty for none; User-Id is the name of its key."""
    try:
        return str(frame.get(name))
    except zmq.ZMQError:
        return ""

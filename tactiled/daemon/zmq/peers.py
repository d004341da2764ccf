"""Connections of peers that speak ZMTP to an endpoint of ours, in asyncio; bounded in every way.

A server never waits for a peer, and what one peer sends or leaves unread costs the others nothing:

- The peers of a server take steps one after another, some hundred a second in all. In one step at most
  `READ_BYTES` are read, some values are handled, and at most one request is answered. A flood fills the
  kernel's buffer of its own connection and no more.
- An endpoint has at most `MOST_PEERS` peers. A new one takes the place of the oldest that has sent no request
  and has no subscription; where there is none, it is refused.
- A peer that is not ready after `HANDSHAKE_S`, or sends what the protocol does not have, is closed.
- What waits to be sent to a peer is bounded; older messages are dropped for newer ones.
"""

import asyncio
import contextlib
import logging
import math
import selectors
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.endpoints import listen, stop_listening
from tactiled.daemon.zmq.zmtp import Greeted, Ping, Ready, Refused, Value, ZmtpDecoder
from tactiled.limited_log import RateLimitedLog
from tactiled.outside import shown

logger = logging.getLogger(__name__)

MOST_PEERS = 64  # of an endpoint; a robot has some ten: controller, recorder, page, viewers, bridges
HANDSHAKE_S = 5.0  # a handshake takes milliseconds, or as long as the peer's host is stopped
READ_BYTES = 512
_VALUES_A_STEP = 16  # of the 256 that a read may hold: 0.1 ms instead of 1 ms
# Steps at once before their rate is limited: a dozen peers that start together, or a client that catches up
# on every topic.
_BURST = 50
# Messages that are handed to the kernel at once. The rest of a piece that the kernel took in part is kept
# beside the queue, because a message that was begun must be finished.
_PIECE_BYTES = 64 * 1024
# Of the kernel, for each peer, which doubles it: without a limit it grows to some megabytes.
_SEND_BUFFER_BYTES = 128 * 1024
_NO_DESCRIPTOR_S = 1.0  # pause when no connection can be accepted, mostly for want of descriptors
_TCP_OPTIONS = {
    socket.TCP_NODELAY: 1,
    socket.TCP_KEEPIDLE: 1,  # seconds
    socket.TCP_KEEPINTVL: 1,
    socket.TCP_KEEPCNT: 3,
    socket.TCP_USER_TIMEOUT: 4000,  # ms
}
"""Options of TCP: no delay, and those of `DEAD_PEER_OPTIONS` by their names in the kernel."""
_UCRED = struct.Struct("3i")  # process, user and group of a peer over ipc, unix(7)


@dataclass(frozen=True)
class Bounds:
    """Limits of a server."""

    frame_bytes: int  # of a frame from a peer
    queue_bytes: int  # of what waits to be sent to a peer
    steps_per_s: float  # of all peers together: a read, a request, or a new connection


class StepLimit:
    """Limit of the rate of steps, after some that may come at once."""

    def __init__(self, steps_per_s: float) -> None:
        self._step_s = 1 / steps_per_s
        self._next_s = -math.inf

    async def wait(self) -> None:
        """Wait until the next step may begin; the event loop runs in any case."""
        now_s = asyncio.get_running_loop().time()
        self._next_s = max(self._next_s, now_s - _BURST * self._step_s) + self._step_s
        await asyncio.sleep(max(0.0, self._next_s - now_s))


class Queued(NamedTuple):
    """Encoded message that waits to be sent, and what it is counted under if dropped; None: it is not."""

    wire: bytes
    counted_as: str | None = None


class Peer:
    """One connection; `dropped` counts its messages that newer ones displaced, by `Queued.counted_as`."""

    def __init__(self, sock: socket.socket, bounds: Bounds, dropped: Counter[str]) -> None:
        self.sock = sock
        self.uid = -1
        """User of a peer over ipc, from the kernel; -1 over TCP."""
        self.address = ""
        """Address of a peer over TCP."""
        if sock.family == socket.AF_UNIX:
            _, self.uid, _ = _UCRED.unpack(
                sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
            )
        else:
            self.address = str(sock.getpeername()[0])
        self.decoder = ZmtpDecoder(bounds.frame_bytes)
        self.values: deque[Value] = deque()
        """Values that wait for the next step of this peer."""
        self.is_ready = False
        self.is_idle = True
        """True while the peer has nothing here: its place may be given to another."""
        self.is_blocked = False
        """True while the kernel takes no more; then it says when it does."""
        self._queue_bytes = bounds.queue_bytes
        self._dropped = dropped
        self._queue: deque[Queued] = deque()
        self._n_queued = 0
        self._begun = b""

    def __str__(self) -> str:
        return self.address or f"uid {self.uid}"

    def add(self, message: Queued) -> None:
        """Queue a message; the oldest ones make room for it."""
        self._queue.append(message)
        self._n_queued += len(message.wire)
        while self._n_queued > self._queue_bytes:
            oldest = self._queue.popleft()
            self._n_queued -= len(oldest.wire)
            if oldest.counted_as is not None:
                self._dropped[oldest.counted_as] += 1

    def flush(self) -> None:
        """Send what the kernel takes now; an `OSError` says that the connection is lost."""
        self.is_blocked = False
        try:
            while self._begun or self._queue:
                if not self._begun:
                    self._begin()
                self._begun = self._begun[self.sock.send(self._begun) :]
        except BlockingIOError:
            self.is_blocked = True

    def _begin(self) -> None:
        """Take the oldest messages from the queue, as many as make a piece."""
        piece: list[bytes] = []
        size = 0
        while self._queue and (not piece or size + len(self._queue[0].wire) <= _PIECE_BYTES):
            piece.append(self._queue.popleft().wire)
            size += len(piece[-1])
        self._n_queued -= size
        self._begun = b"".join(piece)


class PeerServer:
    """Serve the peers of some endpoints, of which some types may connect; a subclass says what they mean."""

    def __init__(self, socket_type: str, peer_types: Collection[str], bounds: Bounds) -> None:
        self.dropped: Counter[str] = Counter()
        """Number of messages dropped for peers that do not keep up, by `Queued.counted_as`."""
        self.refused = RateLimitedLog(logger, "connection refused")
        self._ready = Queued(zmtp.ready(socket_type))
        self._peer_types = frozenset(peer_types)
        self._bounds = bounds
        # The peers of an endpoint, the oldest first, by each of its listeners.
        self._listeners: dict[socket.socket, dict[Peer, None]] = {}
        self._readable: asyncio.Queue[socket.socket | Peer] = asyncio.Queue()
        self._unsent: dict[Peer, None] = {}
        self.is_held = False
        """True while the owner queues messages and will call `flush`: that saves a turn of the loop."""
        self._loop: asyncio.AbstractEventLoop | None = None

    def listen(self, endpoint: str) -> None:
        """Listen at an endpoint; raises as `endpoints.listen`."""
        peers: dict[Peer, None] = {}  # one limit for all addresses of the endpoint
        self._listeners.update(dict.fromkeys(listen(endpoint), peers))

    async def run(self) -> None:
        """Serve until cancelled; then `close` may still send what waits."""
        self._loop = asyncio.get_running_loop()
        for listener in self._listeners:
            self._watch(listener)
        limit = StepLimit(self._bounds.steps_per_s)
        while True:
            source = await self._readable.get()
            if isinstance(source, Peer):
                self._step(source)
            else:
                self._accept(source)
            await limit.wait()

    def flush(self) -> None:
        """Send what was queued in this turn of the event loop; it is done at its end unless `is_held`."""
        unsent, self._unsent = self._unsent, {}
        for peer in unsent:
            if not peer.is_blocked:
                self._flush(peer)

    def close(self, linger_s: float = 0.0) -> None:
        """Send what waits, within `linger_s`; then close all connections."""
        end_s = time.monotonic() + linger_s
        with selectors.DefaultSelector() as selector:
            for peer in self._peers():
                with contextlib.suppress(OSError):  # it has left already
                    peer.flush()
                if peer.is_blocked:
                    selector.register(peer.sock, selectors.EVENT_WRITE, peer)
            while selector.get_map() and (left_s := end_s - time.monotonic()) > 0:
                for key, _ in selector.select(left_s):
                    with contextlib.suppress(OSError):
                        key.data.flush()
                    if not key.data.is_blocked:
                        selector.unregister(key.fileobj)
        for peer in self._peers():
            self._close_peer(peer)
        for listener in self._listeners:
            self._unwatch(listener)
            stop_listening(listener)
        self._listeners.clear()

    def _take(self, peer: Peer, value: Value) -> bool:
        """Handle what a peer says when it is ready; returns True when this was all for one step."""
        raise NotImplementedError

    def _gone(self, peer: Peer) -> None:
        """Forget a peer that is closed."""

    def _send(self, peer: Peer, message: Queued) -> None:
        """Queue a message, which is sent at the end of this turn of the event loop with those that follow."""
        peer.add(message)
        if not (self._unsent or self.is_held) and self._loop is not None:
            self._loop.call_soon(self.flush)
        self._unsent[peer] = None

    def _peers(self) -> list[Peer]:
        return list(dict.fromkeys(peer for peers in self._listeners.values() for peer in peers))

    def _accept(self, listener: socket.socket) -> None:
        assert self._loop is not None  # `run` sets it
        if listener.fileno() < 0:
            return
        try:
            sock, _ = listener.accept()
        except (BlockingIOError, ConnectionError):  # it has left already
            self._watch(listener)
            return
        except OSError as error:
            self._refuse("connections", f"none can be accepted: {error.strerror}")
            self._loop.call_later(_NO_DESCRIPTOR_S, self._watch, listener)
            return
        self._watch(listener)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            if sock.family != socket.AF_UNIX:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                for option, value in _TCP_OPTIONS.items():
                    sock.setsockopt(socket.IPPROTO_TCP, option, value)
            peer = Peer(sock, self._bounds, self.dropped)
        except OSError:  # it has left already
            sock.close()
            return
        peers = self._listeners[listener]
        if len(peers) >= MOST_PEERS:
            idle = next((other for other in peers if other.is_idle), None)
            self._refuse(str(idle or peer), f"{MOST_PEERS} connections are open already")
            if idle is None:
                sock.close()
                return
            self._close_peer(idle)
        peers[peer] = None
        self._loop.call_later(HANDSHAKE_S, self._check_ready, peer)
        self._watch(peer)
        self._send(peer, Queued(zmtp.GREETING))

    def _step(self, peer: Peer) -> None:
        """Handle what is left of the last read, or read."""
        if not peer.values and not self._read(peer):
            return
        for _ in range(_VALUES_A_STEP):
            if not peer.values or self._handle(peer, peer.values.popleft()):
                break
        if peer.values:
            self._readable.put_nowait(peer)  # behind the other peers
        else:
            self._watch(peer)

    def _read(self, peer: Peer) -> bool:
        """Read some bytes; returns False where the peer has left."""
        if peer.sock.fileno() < 0:
            return False
        try:
            data = peer.sock.recv(READ_BYTES)
        except BlockingIOError:
            return True
        except OSError:
            data = b""
        if not data:
            self._close_peer(peer)
            return False
        peer.values.extend(peer.decoder.receive(data))
        return True

    def _handle(self, peer: Peer, value: Value) -> bool:
        if isinstance(value, Greeted):
            self._send(peer, self._ready)
        elif isinstance(value, Ping):
            self._send(peer, Queued(zmtp.pong(value.context)))
        elif isinstance(value, Refused):
            self._refuse(str(peer), value.reason)
            self._close_peer(peer)
        elif not isinstance(value, Ready):
            return self._take(peer, value)
        elif value.socket_type in self._peer_types:
            peer.is_ready = True
        else:
            wanted = " or ".join(sorted(self._peer_types))
            reason = f"a socket {shown(value.socket_type)} where {wanted} may connect"
            self._refuse(str(peer), reason)
            peer.add(Queued(zmtp.error(reason)))
            self._flush(peer)
            self._close_peer(peer)
        return False

    def _check_ready(self, peer: Peer) -> None:
        if not peer.is_ready and peer.sock.fileno() >= 0:
            self._refuse(str(peer), f"no handshake within {HANDSHAKE_S:g} s")
            self._close_peer(peer)

    def _refuse(self, who: str, reason: str) -> None:
        self.refused.add(f"{who}: {reason}", time.monotonic())

    def _flush(self, peer: Peer) -> None:
        """Send what can be sent now, and the rest when the kernel takes more."""
        if peer.sock.fileno() < 0:
            return
        assert self._loop is not None  # there is no peer before `run`
        was_blocked = peer.is_blocked
        try:
            peer.flush()
        except OSError:
            self._close_peer(peer)
            return
        if peer.is_blocked and not was_blocked:
            self._loop.add_writer(peer.sock, self._flush, peer)
        elif was_blocked and not peer.is_blocked:
            self._loop.remove_writer(peer.sock)

    def _watch(self, source: socket.socket | Peer) -> None:
        """Queue a source when it can be read, once."""
        sock = source.sock if isinstance(source, Peer) else source
        if sock.fileno() >= 0 and self._loop is not None:
            self._loop.add_reader(sock, self._found_readable, source)

    def _unwatch(self, sock: socket.socket) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(sock)
            self._loop.remove_writer(sock)

    def _found_readable(self, source: socket.socket | Peer) -> None:
        assert self._loop is not None  # `_watch` has used it
        self._loop.remove_reader(source.sock if isinstance(source, Peer) else source)
        self._readable.put_nowait(source)

    def _close_peer(self, peer: Peer) -> None:
        if peer.sock.fileno() < 0:
            return
        self._unwatch(peer.sock)
        peer.sock.close()
        peer.values.clear()
        for peers in self._listeners.values():
            peers.pop(peer, None)
        self._gone(peer)

"""Publisher: events to ZeroMQ messages of two frames, without ever blocking.

Messages are dropped for a subscriber that does not keep up. Every message therefore carries the sequence
number of its topic, so that the subscriber sees its losses and can request them from the store (`control`).

Plain endpoints are served here (`EventServer`), because libzmq does not bound the subscriptions of a peer.
Endpoints with keys are PUB sockets of libzmq.
"""

import secrets
import time
from collections import Counter, OrderedDict, defaultdict, deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import zmq

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.endpoints import bind
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.peers import Bounds, Peer, PeerServer, Queued
from tactiled.daemon.zmq.security import CurveAuthenticator
from tactiled.daemon.zmq.zmtp import Cancel, Part, Subscribe, Value
from tactiled.events import codec
from tactiled.events.types import Event, Sent

# With a key: a stalled subscriber loses nothing for 2000 / (100 scans + 10 status per second) = 18 s, and
# occupies at most about 2 MB.
_SEND_HIGH_WATER = 2000
_LINGER_S = 0.3  # enough to send queued events over loopback; a dead subscriber delays the end by no more
# Longest message of a subscriber: a topic is some 30 bytes, the largest step of a CURVE handshake some 600.
_LONGEST_SUBSCRIPTION = 1024

QUEUE_BYTES = 2**20  # 7 s of scans, force, grip and status of one board in contact; the store has the rest
# A step costs 0.05 ms, and 0.6 ms where a peer fills its read with the shortest messages.
BOUNDS = Bounds(zmtp.LONGEST_BYTES, QUEUE_BYTES, steps_per_s=200.0)
MOST_SUBSCRIPTIONS = 100  # of a subscriber: ten topics of ten boards by name; prefixes need fewer
_MOST_TOPICS = 1000  # whose subscribers are remembered: ten of each of 100 boards
# Boards in the store beside those that the daemon reads: another after an exchange, and one without a name
# before any hello.
MORE_BOARDS = 2
# A bytes object (33) and its entry in the deque (8), rounded up to the granularity of malloc.
_OVERHEAD_BYTES = 64


class EventServer(PeerServer):
    """Send each message to the subscribers that want its topic.

    A subscriber that does not keep up loses the oldest messages, which the store still has.
    """

    def __init__(self) -> None:
        super().__init__("PUB", ("SUB", "XSUB"), BOUNDS)
        self._wanted: dict[Peer, Counter[bytes]] = {}
        # Subscribers of each topic, until a subscription changes: comparing a topic with 100 prefixes of
        # each of 64 peers takes 0.1 ms.
        self._audience: dict[bytes, list[Peer]] = {}

    def send(self, topic: bytes, payload: bytes, board: str) -> None:
        """Queue a message for everyone who wants it, counted under `board` if it is dropped; never waits."""
        audience = self._audience.get(topic)
        if audience is None:
            if len(self._audience) >= _MOST_TOPICS:
                self._audience.clear()
            audience = [peer for peer, wanted in self._wanted.items() if topic.startswith((*wanted,))]
            self._audience[topic] = audience
        if audience:
            message = Queued(zmtp.message(topic, payload), board)
            for peer in audience:
                self._send(peer, message)

    def _take(self, peer: Peer, value: Value) -> bool:
        asked = zmtp.subscription(value) if isinstance(value, Part) else value
        wanted = self._wanted.setdefault(peer, Counter())
        if isinstance(asked, Subscribe):
            if asked.prefix not in wanted and len(wanted) >= MOST_SUBSCRIPTIONS:
                reason = f"{peer}: {MOST_SUBSCRIPTIONS} subscriptions are the most, further ones are ignored"
                self.refused.add(reason, time.monotonic())
                return False
            wanted[asked.prefix] += 1
        elif isinstance(asked, Cancel) and asked.prefix in wanted:
            wanted[asked.prefix] -= 1
            if not wanted[asked.prefix]:
                del wanted[asked.prefix]
        else:
            return False
        self._audience.clear()
        peer.is_idle = not wanted
        return False

    def _gone(self, peer: Peer) -> None:
        self._wanted.pop(peer, None)
        self._audience.clear()


@dataclass(frozen=True)
class Span:
    """Consecutive messages of one topic."""

    payloads: list[bytes]  # as they were published, in order
    next_seq: int  # requested messages before this number are among the payloads, or no longer stored
    more: bool  # there are further messages from `next_seq` on


@dataclass
class _Ring:
    first_seq: int
    payloads: deque[bytes] = field(default_factory=deque)
    n_bytes: int = 0


class Store:
    """Keep the newest encoded messages of each topic, for subscribers that connect late or missed some.

    The limit in bytes, including Python's overhead, holds for each topic of a board, so that scans never
    displace a slip: 4 MB are a minute of 100 Hz scans of 36 channels, ten minutes of status, or some ten
    thousand slips.
    """

    def __init__(self, bytes_per_topic: int, n_boards: int = 1) -> None:
        self._bytes_per_topic = bytes_per_topic
        self._most_boards = n_boards + MORE_BOARDS
        self._boards: OrderedDict[str, dict[str, _Ring]] = OrderedDict()

    def add(self, board: str, topic: str, seq: int, payload: bytes) -> None:
        """Store a message; the sequence numbers of a topic are consecutive."""
        rings = self._boards.get(board)
        if rings is None:
            rings = self._boards[board] = {}
            if len(self._boards) > self._most_boards:
                self._boards.popitem(last=False)
        self._boards.move_to_end(board)
        ring = rings.setdefault(topic, _Ring(seq))
        ring.payloads.append(payload)
        ring.n_bytes += len(payload) + _OVERHEAD_BYTES
        while ring.n_bytes > self._bytes_per_topic and len(ring.payloads) > 1:  # the newest is always kept
            ring.n_bytes -= len(ring.payloads.popleft()) + _OVERHEAD_BYTES
            ring.first_seq += 1

    def latest(self) -> dict[str, bytes]:
        """Return the newest message of each topic, by full topic; the last board is last."""
        return {
            codec.topic_of(board, topic): ring.payloads[-1]
            for board, rings in self._boards.items()
            for topic, ring in rings.items()
        }

    def span(self, board: str, topic: str, first_seq: int, end_seq: int | None, max_bytes: int) -> Span:
        """Return stored messages with ``first_seq <= seq < end_seq``, at most `max_bytes` of them.

        Without `end_seq`, the newest message is the last one. At least one message is returned where there
        is any, so that repeated requests always come to an end.
        """
        ring = self._boards.get(board, {}).get(topic)
        if ring is None:
            return Span([], max(first_seq, end_seq or 0), False)
        newest_end = ring.first_seq + len(ring.payloads)
        end_seq = newest_end if end_seq is None else min(end_seq, newest_end)
        begin = max(0, first_seq - ring.first_seq)
        payloads: list[bytes] = []
        size = 0
        for payload in islice(ring.payloads, begin, max(begin, end_seq - ring.first_seq)):
            size += len(payload)
            if payloads and size > max_bytes:
                break
            payloads.append(payload)
        if not payloads:
            return Span([], max(first_seq, end_seq), False)
        next_seq = ring.first_seq + begin + len(payloads)
        return Span(payloads, next_seq, next_seq < end_seq)


class Publisher:
    """PUB endpoints, sequence number of each topic, and store of recent messages.

    `authenticator` is for endpoints with keys.
    """

    def __init__(
        self,
        params: PublishParams,
        authenticator: CurveAuthenticator | None = None,
        n_boards: int = 1,
    ) -> None:
        self.run = secrets.randbits(53)
        """Random number of this run of the daemon; a float64, as viewers use, holds it exactly."""
        self.store = Store(round(params.history_mb * 1e6), n_boards)
        self.server = EventServer()
        """Server of the plain endpoints; it serves while its `run` does."""
        self._next_seq: defaultdict[tuple[str, str], int] = defaultdict(int)
        self._guarded: zmq.Socket[Any] | None = None
        try:
            for endpoint in params.endpoints:
                if not params.is_guarded(endpoint):
                    self.server.listen(endpoint)
                    continue
                if self._guarded is None:
                    assert authenticator is not None  # `Network` has made it for these endpoints
                    self._guarded = authenticator.context.socket(zmq.PUB, socket_class=zmq.Socket)
                    self._guarded.setsockopt(zmq.SNDHWM, _SEND_HIGH_WATER)
                    self._guarded.setsockopt(zmq.LINGER, round(1000 * _LINGER_S))
                    authenticator.guard(self._guarded, _LONGEST_SUBSCRIPTION)
                bind(self._guarded, endpoint)
        except BaseException:
            self.close()
            raise

    def send(self, event: Event, *, board: str, unix_offset_s: float) -> None:
        """Publish one event; never waits."""
        key = (board, event.topic)
        seq = self._next_seq[key]
        self._next_seq[key] = seq + 1
        frames = codec.encode(event, seq=seq, board=board, unix_offset_s=unix_offset_s, run=self.run)
        self.server.send(*frames, board)
        if self._guarded is not None:
            self._guarded.send_multipart(frames, zmq.NOBLOCK)
        self.store.add(board, event.topic, seq, frames[1])

    def sent(self, board: str) -> Sent:
        """Return the numbers of messages of a board so far, by topic."""
        topics = Sent.__dataclass_fields__
        return Sent(**{topic: self._next_seq.get((board, topic), 0) for topic in topics})

    def close(self) -> None:
        """Send queued events, then close."""
        self.server.close(_LINGER_S)
        if self._guarded is not None:
            self._guarded.close()

"""PUB endpoints: each subscriber with its subscriptions, which are bounded, as libzmq's are not."""

import time
from collections import Counter

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.peers import Bounds, Peer, PeerServer, Queued
from tactiled.daemon.zmq.zmtp import Cancel, Part, Subscribe, Value

QUEUE_BYTES = 2**20  # 7 s of scans, force, grip and status of one board in contact; the store has the rest
# A turn costs 0.05 ms, and 0.6 ms where a peer fills its read with the shortest messages.
BOUNDS = Bounds(zmtp.LONGEST_BYTES, QUEUE_BYTES, turns_per_s=200.0)
MOST_SUBSCRIPTIONS = 100  # of a subscriber: ten topics of ten boards by name; prefixes need fewer
_MOST_TOPICS = 1000  # whose subscribers are remembered: ten of each of 100 boards


class Subscribers(PeerServer):
    """Send each message to the subscribers that want its topic.

    A subscriber that does not keep up loses the oldest messages, which the store still has.
    """

    def __init__(self) -> None:
        super().__init__("PUB", ("SUB", "XSUB"), BOUNDS)
        self._wanted: dict[Peer, Counter[bytes]] = {}
        self._audience: dict[bytes, tuple[Peer, ...]] = {}

    def send(self, topic: bytes, payload: bytes, name: str) -> None:
        """Queue a message for everyone who wants it; never waits.

        Parameters
        ----------
        name : str
            What the message is counted under in `dropped`.
        """
        audience = self._audience.get(topic)
        if audience is None:
            if len(self._audience) >= _MOST_TOPICS:
                self._audience.clear()
            audience = tuple(peer for peer, wanted in self._wanted.items() if topic.startswith((*wanted,)))
            self._audience[topic] = audience
        if audience:
            message = Queued(name, zmtp.message(topic, payload))
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
        peer.is_idle = not wanted
        self._audience.clear()
        return False

    def _gone(self, peer: Peer) -> None:
        if self._wanted.pop(peer, None):
            self._audience.clear()

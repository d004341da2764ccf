"""Store of recent messages, for subscribers that connect late or missed some.

The limit in bytes holds for each topic of a board, so that scans never displace a slip: the default of 4 MB
is a minute of 100 Hz scans of 36 channels, ten minutes of status, or some ten thousand slips. The number of
boards is limited too: those that the daemon reads, another after an exchange, and one without a name before
any hello.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from itertools import islice

from tactiled.events.codec import topic_of

MORE_BOARDS = 2  # after an exchange, and without a name
# A bytes object (33) and its entry in the deque (8), rounded up to the granularity of malloc.
_OVERHEAD_BYTES = 64


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
    """Keep the newest encoded messages of each topic of the last boards.

    Parameters
    ----------
    bytes_per_topic : int
        Limit, including Python's overhead. The total is at most this times topics times
        (`n_boards` + `MORE_BOARDS`).
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
        if seq != ring.first_seq + len(ring.payloads):  # the board was removed from the store meanwhile
            ring.payloads.clear()
            ring.first_seq, ring.n_bytes = seq, 0
        ring.payloads.append(payload)
        ring.n_bytes += len(payload) + _OVERHEAD_BYTES
        while ring.n_bytes > self._bytes_per_topic and len(ring.payloads) > 1:  # the newest is always kept
            ring.n_bytes -= len(ring.payloads.popleft()) + _OVERHEAD_BYTES
            ring.first_seq += 1

    def latest(self) -> dict[str, bytes]:
        """Return the newest message of each topic, by full topic; the last board is last."""
        return {
            topic_of(board, topic): ring.payloads[-1]
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

    @property
    def n_bytes(self) -> int:
        """Bytes in the store, including overhead."""
        return sum(ring.n_bytes for rings in self._boards.values() for ring in rings.values())

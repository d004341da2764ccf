"""The last messages of each topic, for those who come late or were away.

Bounded by bytes for each topic of a board, so that scans can never push a slip out: with the default of
4 MB that is a minute of 100 Hz scans of 36 channels, ten minutes of status, and some ten thousand slips.
Boards are bounded too: a daemon sees one, another one after a swap, and the nameless one before any hello.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from itertools import islice

from tactiled.events.codec import topic_of

KEPT_BOARDS = 3
_OVERHEAD_BYTES = 64  # a bytes object (33) and its place in the deque (8), rounded up to what malloc gives


@dataclass(frozen=True)
class Span:
    """Consecutive messages of one topic.

    Attributes
    ----------
    payloads : list of bytes
        As they were published, in order.
    next_seq : int
        Everything asked for before this number is either among the payloads or gone for ever.
    more : bool
        Whether to ask again from there.
    """

    payloads: list[bytes]
    next_seq: int
    more: bool


@dataclass
class _Ring:
    first_seq: int
    payloads: deque[bytes] = field(default_factory=deque)
    n_bytes: int = 0


class Store:
    """Encoded messages, the newest of each topic of the boards seen last.

    Parameters
    ----------
    bytes_per_topic : int
        Python's own overhead counted in. All in all at most this times topics times `KEPT_BOARDS`.
    """

    def __init__(self, bytes_per_topic: int) -> None:
        self._bytes_per_topic = bytes_per_topic
        self._boards: OrderedDict[str, dict[str, _Ring]] = OrderedDict()

    def add(self, board: str, topic: str, seq: int, payload: bytes) -> None:
        """Keep a message; numbers of a topic follow one another."""
        rings = self._boards.get(board)
        if rings is None:
            rings = self._boards[board] = {}
            if len(self._boards) > KEPT_BOARDS:
                self._boards.popitem(last=False)
        self._boards.move_to_end(board)
        ring = rings.setdefault(topic, _Ring(seq))
        if seq != ring.first_seq + len(ring.payloads):  # the board was forgotten meanwhile, or comes back
            ring.payloads.clear()
            ring.first_seq, ring.n_bytes = seq, 0
        ring.payloads.append(payload)
        ring.n_bytes += len(payload) + _OVERHEAD_BYTES
        while ring.n_bytes > self._bytes_per_topic and len(ring.payloads) > 1:  # the newest is always kept
            ring.n_bytes -= len(ring.payloads.popleft()) + _OVERHEAD_BYTES
            ring.first_seq += 1

    def latest(self) -> dict[str, bytes]:
        """Newest message of each topic, by full topic; the board seen last comes last."""
        return {
            topic_of(board, topic): ring.payloads[-1]
            for board, rings in self._boards.items()
            for topic, ring in rings.items()
        }

    def span(self, board: str, topic: str, first_seq: int, end_seq: int, max_bytes: int) -> Span:
        """Messages with ``first_seq <= seq < end_seq`` that are still here, at most `max_bytes` of them.

        At least one is given where there is any, so that whoever asks again always comes to an end.
        """
        ring = self._boards.get(board, {}).get(topic)
        if ring is None:
            return Span([], max(first_seq, end_seq), False)
        end_seq = min(end_seq, ring.first_seq + len(ring.payloads))
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

    def end_seq(self, board: str, topic: str) -> int:
        """Number that the next message will have; 0 where none is known."""
        ring = self._boards.get(board, {}).get(topic)
        return 0 if ring is None else ring.first_seq + len(ring.payloads)

    @property
    def n_bytes(self) -> int:
        """What is kept, with overhead."""
        return sum(ring.n_bytes for rings in self._boards.values() for ring in rings.values())

"""Store of messages: bounded, in order, and scans never displace a slip."""

import sys

from hypothesis import given
from hypothesis import strategies as st

from tactiled.daemon.zmq.publisher import MORE_BOARDS, Span, Store


def payload(seq: int, size: int = 20) -> bytes:
    return str(seq).encode().ljust(size)


def filled(n: int, bytes_per_topic: int = 10**6, topic: str = "scan") -> Store:
    store = Store(bytes_per_topic)
    for seq in range(n):
        store.add("b", topic, seq, payload(seq))
    return store


def ask_all(store: Store, first_seq: int, end_seq: int, max_bytes: int) -> tuple[list[int], int]:
    """Numbers that a client gets by asking again and again, and how often it asked."""
    got: list[int] = []
    asked = 0
    while True:
        span = store.span("b", "scan", first_seq, end_seq, max_bytes)
        asked += 1
        got += [int(p) for p in span.payloads]
        if not span.more:
            return got, asked
        assert span.next_seq > first_seq
        first_seq = span.next_seq


@given(
    n=st.integers(1, 60), first=st.integers(0, 70), length=st.integers(0, 70), kept=st.integers(84, 3000),
    max_bytes=st.integers(0, 500),
)  # fmt: skip
def test_stored_messages_come_in_order_and_once(
    n: int, first: int, length: int, kept: int, max_bytes: int
) -> None:
    store = filled(n, kept)
    oldest = max(0, n - max(1, kept // 84))
    got, _ = ask_all(store, first, first + length, max_bytes)
    assert got == list(range(max(first, oldest), min(first + length, n)))


@given(n=st.integers(1, 40), first=st.integers(0, 50), end=st.integers(0, 50), max_bytes=st.integers(0, 500))
def test_a_span_holds_every_stored_message_before_next_seq(
    n: int, first: int, end: int, max_bytes: int
) -> None:
    span = filled(n).span("b", "scan", first, end, max_bytes)
    assert span.next_seq >= first
    assert span.more == (span.next_seq < min(end, n))
    assert [int(p) for p in span.payloads] == list(range(first, first + len(span.payloads)))


def test_the_stored_size_is_the_stated_one() -> None:
    store = Store(50_000)
    for seq in range(5000):
        store.add("b", "scan", seq, payload(seq, 600))
    ring = store._boards["b"]["scan"]  # noqa: SLF001  the bound on memory
    real = sum(sys.getsizeof(p) for p in ring.payloads) + sys.getsizeof(ring.payloads)
    assert real <= ring.n_bytes <= 50_000


def test_scans_never_evict_a_slip() -> None:
    store = Store(10_000)
    store.add("b", "slip", 0, payload(0))
    for seq in range(1000):
        store.add("b", "scan", seq, payload(seq, 600))
    assert store.span("b", "slip", 0, 1, 1000).payloads == [payload(0)]


def test_a_message_larger_than_the_store_is_kept_alone() -> None:
    store = Store(100)
    store.add("b", "info", 0, payload(0, 500))
    store.add("b", "info", 1, payload(1, 500))
    assert store.span("b", "info", 0, 2, 10).payloads == [payload(1, 500)]


def test_the_number_of_boards_is_bounded_and_the_oldest_is_evicted() -> None:
    store = Store(1000)
    for number in range(MORE_BOARDS + 2):
        store.add(f"b{number}", "info", 0, payload(number))
    store.add("b1", "info", 1, payload(1))
    store.add("new", "info", 0, payload(9))
    assert set(store.latest()) == {"tactile/b1/info", "tactile/b3/info", "tactile/new/info"}
    assert store.span("b0", "info", 0, 1, 1000).payloads == []
    store.add("b0", "info", 7, payload(7))  # it comes back: numbers went on
    assert store.span("b0", "info", 0, 8, 1000).payloads == [payload(7)]
    assert store.span("b0", "info", 0, None, 1000).next_seq == 8


def test_the_newest_of_each_topic() -> None:
    store = filled(5)
    store.add("b", "slip", 3, payload(3))
    assert store.latest() == {"tactile/b/scan": payload(4), "tactile/b/slip": payload(3)}
    assert store.span("b", "scan", 0, None, 1000) == store.span("b", "scan", 0, 5, 1000)
    assert store.span("b", "nothing", 3, None, 1000) == Span([], 3, False)

"""Subscribing: `Client` for asyncio, `Subscription` for plain loops; both are a socket around an `Inbox`."""

import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, Self

import zmq
import zmq.asyncio

from tactiled.client.inbox import Inbox, Item
from tactiled.errors import ConfigError
from tactiled.events.codec import topic_of

DEFAULT_ENDPOINT = "tcp://127.0.0.1:9872"
STALE_AFTER_S = 0.5  # five statuses in a row
_RECEIVE_HIGH_WATER = 2000  # as the publisher's: a sleep of some 18 s loses nothing
_LARGEST_BYTES = 1 << 20  # our largest message is some 40 kB (4096 channels); libzmq drops who sends more


class _Judged:
    """What both kinds of subscription know of what they have read."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._items: deque[Item] = deque()

    @property
    def fresh(self) -> bool:
        """Whether touch may be acted on, now: true between `Fresh` and `Stale`, and never while asleep."""
        return self._inbox.is_fresh(time.monotonic())

    @property
    def lost(self) -> int:
        """Messages known to be lost so far."""
        return self._inbox.lost

    @property
    def malformed(self) -> int:
        """Messages so far that were none of ours."""
        return self._inbox.malformed


class Client(_Judged):
    """Items from a daemon, as they come.

    Parameters
    ----------
    endpoint : str
        Where the daemon publishes.
    topics : sequence of str
        ``"slip"``, ``"texture"``, ``"contact"``, ``"scan"``, ``"status"``, ``"info"``; empty for all.
    board : str, optional
        Only this board; spares the others' messages the way here.
    stale_after_s : float
        Silence, or age of the newest status, that is reported as `Stale`.

    Raises
    ------
    ConfigError
        The endpoint is none.
    """

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        topics: Sequence[str] = (),
        board: str | None = None,
        stale_after_s: float = STALE_AFTER_S,
    ) -> None:
        self._endpoint = endpoint
        self._topics = tuple(topics)
        self._board = board
        super().__init__(Inbox(topics, board, stale_after_s, time.monotonic()))

    async def __aenter__(self) -> Self:
        self._context = zmq.asyncio.Context()
        self._socket = self._context.socket(zmq.SUB)
        try:
            _connect(self._socket, self._endpoint, self._topics, self._board)
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self._socket.close(linger=0)
        self._context.term()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Item:
        while not self._items:
            # Poll, then take without waiting: a cancelled wait cannot take a message with it.
            if await self._socket.poll(_wait_ms(self._inbox)):
                parts = await self._socket.recv_multipart(zmq.NOBLOCK)
                self._items += self._inbox.receive(parts, time.monotonic(), time.time())
            self._items += self._inbox.tick(time.monotonic())
        return self._items.popleft()


class Subscription(_Judged):
    """The same without asyncio; parameters and errors as `Client`'s.

    `next_item` can wait for a limited time, which a control loop without threads needs.
    """

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        topics: Sequence[str] = (),
        board: str | None = None,
        stale_after_s: float = STALE_AFTER_S,
    ) -> None:
        super().__init__(Inbox(topics, board, stale_after_s, time.monotonic()))
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        try:
            _connect(self._socket, endpoint, topics, board)
        except BaseException:
            self.close()
            raise

    def next_item(self, until_s: float | None = None) -> Item | None:
        """The next item, or None when there is none before `until_s` (``time.monotonic()``)."""
        while not self._items:
            if self._socket.poll(_wait_ms(self._inbox, until_s)):
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
                self._items += self._inbox.receive(parts, time.monotonic(), time.time())
            self._items += self._inbox.tick(time.monotonic())
            if until_s is not None and not self._items and time.monotonic() >= until_s:
                return None
        return self._items.popleft()

    def close(self) -> None:
        self._socket.close(linger=0)
        self._context.term()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def subscribe(
    endpoint: str = DEFAULT_ENDPOINT,
    topics: Sequence[str] = (),
    board: str | None = None,
    stale_after_s: float = STALE_AFTER_S,
) -> Iterator[Item]:
    """Items from a daemon, as they come, for ever; parameters and errors as `Client`'s.

    Connects when iteration begins; the socket is closed with the iterator.
    """
    with Subscription(endpoint, topics, board, stale_after_s) as subscription:
        while (item := subscription.next_item()) is not None:
            yield item


def _connect(socket: zmq.Socket[Any], endpoint: str, topics: Sequence[str], board: str | None) -> None:
    socket.setsockopt(zmq.RCVHWM, _RECEIVE_HIGH_WATER)
    socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST_BYTES)
    socket.setsockopt(zmq.IPV6, 1)
    socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)  # a half-dead connection is dropped and made anew in 3 s
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 3000)
    socket.setsockopt(zmq.LINGER, 0)
    if board is None:
        prefixes = ["tactile/"]  # the board comes before the topic: which topic it is, the inbox sees
    else:
        wanted = {*topics, "status"} if topics else {""}
        prefixes = [topic_of(board, topic) for topic in sorted(wanted)] + [topic_of("", "status")]
    for prefix in prefixes:
        socket.subscribe(prefix)
    try:
        socket.connect(endpoint)
    except zmq.ZMQError as error:
        fault = f"{endpoint!r}: {error.strerror}; it should look like {DEFAULT_ENDPOINT}"
        raise ConfigError("endpoint", [fault]) from None


def _wait_ms(inbox: Inbox, until_s: float | None = None) -> int:
    """How long to wait for a message before something else is due; -1 for ever."""
    due_s = min(inbox.deadline_s, math.inf if until_s is None else until_s)
    return -1 if due_s == math.inf else max(0, math.ceil(1000 * (due_s - time.monotonic())))

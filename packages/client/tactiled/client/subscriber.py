"""Subscriptions: `Client` for asyncio, `Subscription` without; both are a `Transport` around an `Inbox`."""

import itertools
import math
import time
from collections import deque
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, Self

import msgpack
import zmq
import zmq.asyncio

from tactiled.client.catchup import PATIENT_HOLD_S
from tactiled.client.inbox import Inbox
from tactiled.client.items import Item, Message
from tactiled.client.transports import RETRY_MS, Transport, open_transport
from tactiled.client.typed import MESSAGE_TYPES, Topic
from tactiled.errors import ConfigError, DataError
from tactiled.events.endpoints import DEFAULT_ENDPOINT, ZENOH_SCHEME, control_endpoint

STALE_AFTER_S = 0.5  # five periods of the status
_INFO_S = 5.0  # a daemon publishes the description of a board once a second


class _SubscriptionBase:
    """Common part of both kinds of subscription; `_transport` is there while it is open."""

    _transport: Transport

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        topics: Sequence[Topic] = (),
        board: str | None = None,
        stale_after_s: float = STALE_AFTER_S,
        control: str | None = None,
        keys: Path | str | None = None,
    ) -> None:
        control = control_endpoint(endpoint) if control is None else control
        topics = _checked_topics(topics)
        self._address = endpoint, control, topics, board, None if keys is None else Path(keys)
        is_patient = endpoint.startswith(ZENOH_SCHEME)
        now_s = time.monotonic()
        self._inbox = Inbox(topics, board, stale_after_s, now_s, bool(control), is_patient=is_patient)
        self._items: deque[Item] = deque()
        self._unread: list[tuple[list[bytes], frozenset[str]]] = []
        self._start()

    def _start(self) -> None:
        """Connect at once, where the kind of subscription does that."""

    @property
    def fresh(self) -> bool:
        """True while tactile data may be acted on: between `Fresh` and `Stale`, and with a recent status."""
        return self._inbox.is_fresh(time.monotonic())

    @property
    def lost(self) -> int:
        """Number of messages so far that cannot be recovered."""
        return self._inbox.catch_up.lost

    @property
    def recovered(self) -> int:
        """Number of messages so far that were missed and recovered."""
        return self._inbox.catch_up.recovered

    @property
    def malformed(self) -> int:
        """Number of malformed messages so far."""
        return self._inbox.malformed

    def _open(self, make_context: type[zmq.Context[Any]], poller: zmq.Poller) -> None:
        self._transport = open_transport(make_context, *self._address)
        for pollable in self._transport.pollables:
            poller.register(pollable, zmq.POLLIN)

    def _received(self, most: int) -> list[tuple[list[bytes], frozenset[str]]]:
        """Messages that have arrived, at most `most`, each with the topics of which not every one is sent."""
        arrived = itertools.islice(iter(self._transport.receive, []), max(0, most))
        return [(parts, self._transport.thinned) for parts in arrived]

    def _read(self, most: int = 1, newest_of: AbstractSet[str] = frozenset()) -> None:
        """Read the replies and at most `most` messages, then act on passed deadlines."""
        while (reply := self._transport.take_reply()) is not None:
            self._items += self._inbox.answer(reply, time.monotonic(), time.time())
        received, self._unread = self._unread + self._received(most - len(self._unread)), []
        newest, replaced = {parts[0]: parts for parts, _ in received}, _endings(newest_of)
        for parts, thinned in received:
            if parts is newest[parts[0]] or not parts[0].endswith(replaced):
                self._items += self._inbox.receive(parts, time.monotonic(), time.time(), thinned | newest_of)
        self._items += self._inbox.tick(time.monotonic())
        for request in self._inbox.catch_up.unsent:
            if not self._transport.send(msgpack.packb(request), time.monotonic() + PATIENT_HOLD_S):
                return
            self._inbox.catch_up.sent(request)

    def _wait_ms(self, until_s: float = math.inf) -> int:
        """Time to wait for a message before the next deadline, milliseconds; -1 without a deadline."""
        if self._unread:
            return 0
        due_s = min(self._inbox.deadline_s, until_s)
        wait_ms = -1 if due_s == math.inf else max(0, math.ceil(1000 * (due_s - time.monotonic())))
        if self._inbox.catch_up.unsent and not 0 <= wait_ms < RETRY_MS:
            return RETRY_MS
        return wait_ms


class Client(_SubscriptionBase):
    """Receive items from a daemon in asyncio.

    Parameters
    ----------
    endpoint : str
        Endpoint for events of the daemon; ``zenoh://ROUTER:7447/HOST`` reaches it through zenoh
        (docs/fleet.md).
    topics : sequence of Topic
        ``"slip"``, ``"texture"``, ``"contact"``, ``"scan"``, ``"status"``, ``"info"``, ``"command"``, ...;
        empty for all.
    board : str, optional
        Receive messages of this board only; the others are not sent. Without it, data are fresh while all
        boards of the daemon run.
    stale_after_s : float
        Silence, or age of the newest status, that is reported as `Stale`.
    control : str, optional
        Endpoint for requests, by which missed messages are recovered. Left out: derived from `endpoint`
        (`control_endpoint`). Empty: nothing is recovered, losses are only reported.
    keys : path, optional
        File of this client, for endpoints that other hosts can reach: from `tactiled keys make`, or for zenoh
        from `tactiled keys fleet`.

    Raises
    ------
    ConfigError
        The endpoint is invalid, a topic is unknown, or the file has no keys.
    """

    async def __aenter__(self) -> Self:
        self._poller = zmq.asyncio.Poller()
        self._open(zmq.asyncio.Context, self._poller)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._transport.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Item:
        while not self._items:
            # Polling first, then reading without waiting: a cancelled wait cannot lose a message.
            await self._poller.poll(self._wait_ms())
            self._read()
        return self._items.popleft()


class Subscription(_SubscriptionBase):
    """Receive items from a daemon without asyncio; parameters and errors as for `Client`.

    `next_item` can wait for a limited time, for a control loop without threads.
    """

    def _start(self) -> None:
        self._poller = zmq.Poller()
        self._open(zmq.Context, self._poller)

    def next_item(self, until_s: float | None = None) -> Item | None:
        """Return the next item, or None when there is none before `until_s` (``time.monotonic()``)."""
        end_s = math.inf if until_s is None else until_s
        while not self._items:
            self._poller.poll(self._wait_ms(end_s))
            self._read()
            if not self._items and time.monotonic() >= end_s:
                return None
        return self._items.popleft()

    def arrived(
        self,
        most: int,
        newest_of: AbstractSet[Topic] = frozenset(),
        only_with: AbstractSet[Topic] = frozenset(),
    ) -> list[Item]:
        """Return the items of the messages that have arrived, at most `most` of these, without waiting.

        Of the topics `newest_of`, whose messages replace one another, only the newest message of each board
        is read: a program that draws now and then saves the time of the others. It does not learn which of
        these topics were lost. With `only_with`, what has arrived waits for another call while none of these
        topics is in it, and fewer than `most`: that costs a fifth of reading it. They must
        be the same in each call.
        """
        if only_with:
            received, asked = self._received(most - len(self._unread)), _endings(only_with)
            self._unread += received
            if len(self._unread) < most and not any(parts[0].endswith(asked) for parts, _ in received):
                return []
        self._read(most, newest_of)
        items = list(self._items)
        self._items.clear()
        return items

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _checked_topics(topics: Sequence[Topic]) -> tuple[Topic, ...]:
    """Return the topics; `ConfigError` for an unknown one, and for a string, whose items are letters."""
    if isinstance(topics, str):
        raise ConfigError("topics", [f"{topics!r} is a string; write a tuple of topics: ({topics!r},)"])
    topics = tuple(topics)
    if faults := [f"no topic {topic!r}" for topic in topics if topic not in MESSAGE_TYPES]:
        raise ConfigError("topics", [f"{', '.join(faults)}; there are: {', '.join(MESSAGE_TYPES)}"])
    return topics


def _endings(topics: AbstractSet[str]) -> tuple[bytes, ...]:
    """Ends of the first part of a message on these topics."""
    return tuple(f"/{topic}".encode() for topic in topics)


def first_info(subscription: Subscription, endpoint: str) -> Message:
    """Wait for the daemon's description of its board, the first of several; `DataError` where none comes."""
    until_s = time.monotonic() + _INFO_S
    while (item := subscription.next_item(until_s)) is not None:
        if isinstance(item, Message) and item.topic == "info":
            return item
    raise DataError(
        f"no board at {endpoint} within {_INFO_S:g} s; check the daemon (tactiled run) and the board "
        "(tactiled doctor)"
    )

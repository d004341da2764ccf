"""What a subscription yields."""

import time
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Message:
    """One event, as it was published.

    Attributes
    ----------
    topic : str
        ``"slip"``, ``"texture"``, ``"contact"``, ``"scan"``, ``"status"``, ``"info"``, ``"command"``, ...
    board : str
        Serial number.
    seq : int
        Running number within board and topic.
    timestamp : float
        Instant that the event is about, epoch seconds.
    data : dict
        The whole map, as protocols/events/ describes it.
    received_s : float
        When we took it out of the socket, ``time.monotonic()``.
    """

    topic: str
    board: str
    seq: int
    timestamp: float
    data: dict[str, Any] = field(repr=False)
    received_s: float
    _age_received_s: float = field(repr=False)

    @property
    def age_s(self) -> float:
        """How long ago the event was, now: it grows while the message is held."""
        return self._age_received_s + time.monotonic() - self.received_s


@dataclass(frozen=True)
class Recovered:
    """A message that did not reach us when it was sent, fetched since: old news, in its place before newer.

    Not a `Message`, so that no controller takes it for something that happens now; `message.age_s` tells.
    """

    message: Message


@dataclass(frozen=True)
class Lost:
    """Messages of a topic that were sent, never arrived, and are beyond recovery."""

    topic: str
    board: str
    count: int


@dataclass(frozen=True)
class Restarted:
    """The daemon was started anew. How many messages the run before still sent cannot be known."""

    board: str


@dataclass(frozen=True)
class Stale:
    """From here on what is known may be old: do not act on touch until `Fresh`."""

    reason: str
    silent_s: float
    """Age of what is newest."""


@dataclass(frozen=True)
class Fresh:
    """The board runs, and what arrives is new."""


@dataclass(frozen=True)
class Malformed:
    """Something arrived that is not one of our messages."""

    reason: str


Item = Message | Recovered | Lost | Restarted | Stale | Fresh | Malformed
Key = tuple[str, str]
"""Board and topic: what numbers count within."""

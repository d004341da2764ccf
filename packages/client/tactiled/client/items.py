"""Items of a subscription."""

import time
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Message:
    """Published event; `typed` has a subclass for each topic, whose fields type checkers know."""

    topic: str  # "slip", "texture", "contact", "scan", "status", "info", "command", ...
    board: str  # serial number of the board
    seq: int  # sequence number within board and topic
    timestamp: float  # physical instant that it is about, epoch seconds: of a slip, its onset or its end
    data: dict[str, Any] = field(repr=False)  # the whole map (protocols/events.md)
    received_s: float  # time at which it was read from the socket, `time.monotonic()`
    _age_received_s: float = field(repr=False)
    _evidence_age_s: float = field(repr=False)

    @property
    def age_s(self) -> float:
        """Present age in seconds of the evidence: of `detected` for a slip, `answered` for a texture.

        For all other topics that is the age of `timestamp`. It grows while the message is held. Act on a
        message by this age: a slip may have begun long before anything could show it.
        """
        return self._evidence_age_s + time.monotonic() - self.received_s

    @property
    def onset_age_s(self) -> float:
        """Present age in seconds of `timestamp`: of the beginning of a slip, or of its end."""
        return self._age_received_s + time.monotonic() - self.received_s


@dataclass(frozen=True)
class Recovered:
    """Message that was missed and requested again, or waited for over 0.2 s for such a one of its topic.

    It is not a `Message`, so that no controller takes it for a present event; `message.age_s` is its age.
    """

    message: Message


@dataclass(frozen=True)
class Lost:
    """Number of messages of a topic that were sent, did not arrive, and cannot be recovered."""

    topic: str
    board: str
    count: int


@dataclass(frozen=True)
class Restarted:
    """Restart of the daemon; the number of messages lost at the end of its last run is not known."""

    board: str


@dataclass(frozen=True)
class Stale:
    """Begin of a time in which data may be old; do not act on tactile data until `Fresh`."""

    reason: str
    silent_s: float  # age of the newest data, seconds


@dataclass(frozen=True)
class Fresh:
    """Begin of a time in which the board runs and arriving data are new."""


@dataclass(frozen=True)
class Malformed:
    """Received data that are no message of tactiled."""

    reason: str


Item = Message | Recovered | Lost | Restarted | Stale | Fresh | Malformed
Key = tuple[str, str]
"""Board and topic; sequence numbers count within this pair."""

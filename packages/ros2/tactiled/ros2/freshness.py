"""Decision which messages of a daemon are fresh enough to be published to ROS 2. No I/O, no clock.

Messages about the skin are passed on only while the newest status of their board says that it is valid, is
young by both clocks, and the message itself is young. Silence of the daemon therefore is silence on ROS 2.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from tactiled.events.codec import evidence_key

FRESH_S = 0.5  # five periods of the status, as in tactiled.client
ABOUT_THE_SKIN = frozenset(("scan", "slip", "contact", "texture", "grip", "force"))
Level = Literal["ok", "warn", "error", "stale"]


@dataclass
class BoardFreshness:
    """State of one board."""

    status: Mapping[str, Any] = field(default_factory=dict)  # newest status; empty before the first one
    dropped: int = 0  # number of messages that were too old to be published
    _status_s: float = float("-inf")
    _status_age_s: float = 0.0

    def admit(self, topic: str, data: Mapping[str, Any], now_s: float, unix_s: float) -> bool:
        """Take a message that was received now, by both clocks; return True where it may be published."""
        age_s = abs(unix_s - data[evidence_key(topic)])  # from the future: a clock was set
        if topic == "status":
            self.status, self._status_s, self._status_age_s = data, now_s, age_s
        young = age_s <= FRESH_S
        fresh = young and (topic not in ABOUT_THE_SKIN or self.is_fresh(now_s))
        self.dropped += not fresh
        return fresh

    def is_fresh(self, now_s: float) -> bool:
        """Return True while messages about the skin may be published."""
        return bool(self.status.get("valid")) and self.is_heard(now_s)

    def is_heard(self, now_s: float) -> bool:
        """Return True while a young status is known, whatever it says."""
        return now_s - self._status_s <= FRESH_S and self._status_age_s <= FRESH_S

    def level(self, now_s: float) -> tuple[Level, str]:
        """Return level and text for diagnostics."""
        if not self.status:
            return "stale", "no status was received: is tactiled running?"
        silent_s = now_s - self._status_s
        if silent_s > FRESH_S:
            return "stale", f"no status for {silent_s:.1f} s: is tactiled running?"
        if self._status_age_s > FRESH_S:
            return "stale", f"status is {self._status_age_s:.1f} s off: messages wait, or the clocks differ"
        if not self.status["valid"]:
            return "error", self.status["reason"] or self.status["state"]
        if self.status["warning"]:
            return "warn", self.status["warning"]
        return "ok", self.status["state"]

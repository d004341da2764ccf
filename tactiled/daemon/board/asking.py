"""Commands on their way to a board: one at a time, sent again until it is answered. No I/O."""

import math
from dataclasses import dataclass, replace

from tactiled.wire.frames import Acknowledge, Command

ANSWER_S = 0.2  # a hello takes 15 ms at 115200 baud, behind a backlog of FTDI buckets some 50: a lost answer
MAX_TRIES = 5  # commands unanswered: the board may have rebooted, so who is it?


@dataclass(frozen=True)
class _Pending:
    """A command that was sent and not answered yet."""

    name: str
    token: int
    tries: int
    again_s: float


class Asking:
    """What was asked, when to ask again, and what is never answered.

    Parameters
    ----------
    token_bits : int
        Width on the wire of the tokens that tell answers apart.
    """

    def __init__(self, token_bits: int) -> None:
        self._token_limit = 1 << token_bits
        self._token = 0  # goes on over lost ports: an answer that comes late is not taken for another
        self.reset(0.0)

    def reset(self, now_s: float) -> None:
        """Nothing is on its way."""
        self._pending: _Pending | None = None
        self._quiet_until_s = now_s
        self.asked_s = now_s
        """When something was last asked or answered."""
        self.unanswered = ""
        """Name of a command that the board does not answer; empty while it answers all."""
        self.put_off = ""
        """Name of a command to which the board last answered that it is busy."""

    def drop(self) -> None:
        """Wait for no answer any more."""
        self._pending = None

    def keep_quiet(self, until_s: float) -> None:
        """Ask nothing before."""
        self._quiet_until_s = until_s

    @property
    def due_s(self) -> float:
        """When the next command may go."""
        return max(self._quiet_until_s, self._pending.again_s if self._pending is not None else -math.inf)

    def is_due(self, name: str, now_s: float) -> bool:
        """Whether `name` may go now: it is not on its way already, and nothing forbids it."""
        pending = self._on_its_way(name)
        return now_s >= self._quiet_until_s and (pending is None or now_s >= pending.again_s)

    def is_exhausted(self, name: str) -> bool:
        """Whether `name` was sent so often without an answer that something else must be tried."""
        pending = self._on_its_way(name)
        return pending is not None and pending.tries >= MAX_TRIES

    def ask(self, name: str, rate_hz: float | None, now_s: float) -> Command:
        """Send `name`, and expect an answer; `rate_hz` is for set_rate."""
        before = self._on_its_way(name)
        tries = before.tries if before is not None else 0
        command = self.command(name, rate_hz)
        self.asked_s = now_s
        self._pending = _Pending(name, command.token, tries + 1, now_s + ANSWER_S)
        return command

    def command(self, name: str, rate_hz: float | None = None) -> Command:
        """A command with a new token, of which no answer is expected."""
        self._token = (self._token + 1) % self._token_limit
        return Command(name, self._token, rate_hz=rate_hz if name == "set_rate" else None)

    def awaits(self, answer: Acknowledge) -> bool:
        """Whether this is the answer to what is on its way."""
        pending = self._pending
        return pending is not None and (pending.token, pending.name) == (answer.token, answer.command)

    def answered_busy(self, name: str, now_s: float) -> None:
        """The board answered, but not now: `name` is asked again in a while, as often as it takes."""
        self.asked_s = now_s
        self.put_off = name
        if (pending := self._on_its_way(name)) is not None:
            self._pending = replace(pending, tries=0)

    def answered(self, name: str, now_s: float) -> None:
        """`name` was answered."""
        self.asked_s = now_s
        self.put_off = ""
        if self._on_its_way(name):
            self._pending = None
        if self.unanswered == name:
            self.unanswered = ""

    def _on_its_way(self, name: str) -> _Pending | None:
        return self._pending if self._pending is not None and self._pending.name == name else None

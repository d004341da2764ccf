"""Commands to a board: one at a time, each repeated until the board answers; and when to ping it. No I/O."""

import math

from tactiled.wire.frames import Acknowledge, Command

# Time after which an answer counts as lost. A hello takes 15 ms at 115200 baud, and some 50 ms behind a
# backlog of FTDI buckets.
ANSWER_S = 0.2
# After so many unanswered commands the board may have rebooted, and is asked to identify itself.
MAX_TRIES = 5
# Mean time between two pings. Ping and answer take 20 octets, 0.2 % of a line at 115200 baud; 120 s of the
# clock's fit hold some 120 of them, of which the fastest bounds the fit.
PING_S = 1.0
# The first comes as soon as some scans have arrived: until it is answered, instants on a bunched line are
# known to some ms only, and a board that was switched off and on may look like one with a backlog.
FIRST_S = 0.05
# The golden ratio spreads the intervals evenly between 0.5 and 1.5 times `PING_S`. So pings are not in step
# with scans, adapter timers or the daemon's own ticks, and some find the line and the adapter idle.
_GOLDEN = (math.sqrt(5) - 1) / 2


class Asking:
    """Track the command that awaits an answer, and the time at which it is repeated.

    `token_bits` is the width on the wire of the tokens by which an answer is matched to its command.
    """

    def __init__(self, token_bits: int) -> None:
        self._token_limit = 1 << token_bits
        self._token = 0  # not reset when a port is lost: a late answer must not match a newer command
        self.reset(0.0)

    def reset(self, now_s: float) -> None:
        """Forget the command that awaits an answer."""
        self._awaited, self._awaited_token = "", 0
        self._tries, self._again_s = 0, -math.inf
        self._quiet_until_s = now_s
        self.asked_s = now_s
        """Time of the newest command or answer, host monotonic seconds."""
        self.unanswered = ""
        """Name of a command that was repeated `MAX_TRIES` times without an answer; empty for none."""
        self.put_off = ""
        """Name of the command to which the board answered ``busy``; empty after any other answer."""

    def drop(self) -> None:
        """Stop waiting for an answer."""
        self._awaited, self._tries, self._again_s = "", 0, -math.inf

    def keep_quiet(self, until_s: float) -> None:
        """Send no command before `until_s`."""
        self._quiet_until_s = until_s

    @property
    def due_s(self) -> float:
        """Earliest time of the next command."""
        return max(self._quiet_until_s, self._again_s)

    def is_due(self, name: str, now_s: float) -> bool:
        """Return True when `name` may be sent now: not awaiting an answer, and not in a quiet time."""
        return now_s >= self._quiet_until_s and (name != self._awaited or now_s >= self._again_s)

    def is_exhausted(self, name: str) -> bool:
        """Return True when `name` was sent `MAX_TRIES` times without an answer."""
        return name == self._awaited and self._tries >= MAX_TRIES

    def ask(self, name: str, rate_hz: float | None, now_s: float) -> Command:
        """Make the command `name` and await its answer; `rate_hz` is used by set_rate only."""
        if name != self._awaited:
            self._tries = 0
        command = self.new_command(name, rate_hz)
        self.asked_s, self._again_s = now_s, now_s + ANSWER_S
        self._awaited, self._awaited_token, self._tries = name, command.token, self._tries + 1
        return command

    def new_command(self, name: str, rate_hz: float | None = None) -> Command:
        """Make a command with a new token, without awaiting its answer."""
        self._token = (self._token + 1) % self._token_limit
        return Command(name, self._token, rate_hz=rate_hz if name == "set_rate" else None)

    def awaits(self, answer: Acknowledge) -> bool:
        """Return True for the answer to the command that awaits one."""
        return (answer.command, answer.token) == (self._awaited, self._awaited_token)

    def answered_busy(self, name: str, now_s: float) -> None:
        """Handle the answer ``busy``: `name` is repeated after `ANSWER_S`, as often as needed."""
        self.asked_s, self.put_off, self._tries = now_s, name, 0

    def answered(self, name: str, now_s: float) -> None:
        """Handle an answer to `name` other than ``busy``."""
        self.asked_s, self.put_off = now_s, ""
        if self._awaited == name:
            self.drop()
        if self.unanswered == name:
            self.unanswered = ""


class Pinging:
    """Time of the next ping; possible where the protocol has pings whose answers carry ticks."""

    def __init__(self, is_possible: bool) -> None:
        self._is_possible = is_possible
        self._count = 0
        self.reset(0.0)

    def reset(self, now_s: float) -> None:
        """Begin with a board that has just begun to run; whether it answers pings is not known."""
        self.due_s = now_s + FIRST_S if self._is_possible else math.inf
        """Time of the next ping; inf where there is none."""

    def refused(self) -> None:
        """Send no ping until `reset`: the board does not know the command."""
        self.due_s = math.inf

    def sent(self, now_s: float) -> None:
        """Set the time of the next ping; it does not depend on an answer to this one."""
        self._count += 1
        self.due_s = now_s + PING_S * (0.5 + self._count * _GOLDEN % 1.0)

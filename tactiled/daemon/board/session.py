"""The conversation with a board, with no I/O: what it told us, what it should do, what to say next.

::

    no-device --opened--> syncing --hello fits, settings made, scans--> running
        ^                  |   ^                                        |   ^
        |                  |   '---- rebooted, stopped, new rate -------'   |
        |                  '-- wrong board, refused command --> fault       |
        '---- lost, from anywhere                 silence --> stalled ------'

There is no script to be at some line of. Whatever happens, what the board needs next follows from what is
known of it (`Terms.wanted`): identify what is unknown, then make the rate right, then start it. A reboot, a
lost answer or a replug only makes something unknown again, so every setting comes back by itself, and no
command but ``identify`` ever goes to a board that did not say it is ours. A board that we started is asked
once more when its scans come: it may have rebooted between its hello and our start, without its settings.

A running board that needs nothing is pinged now and then, for the pipeline's clock. Nothing waits for the
answer: a ping goes only while no command is on its way, and a command goes whether a ping is answered or not.

Every input takes ``now_s`` and returns the commands to send; `deadline_s` says when `tick` is due.
"""

import math

from tactiled.daemon.board.asking import ANSWER_S, Asking
from tactiled.daemon.board.diagnosis import LineWatch
from tactiled.daemon.board.pinging import Pinging
from tactiled.daemon.board.terms import SessionParams, Terms
from tactiled.events.types import BoardState
from tactiled.wire.frames import Acknowledge, Command, Hello

FOREIGN_S = 1.0  # how often a wrong or refusing board is asked again: it may be swapped or mended
SILENT_PERIODS = 5.0  # scans in a row that a board in order does not lose
SILENT_LEAST_S = 0.05  # and never less than a few FTDI buckets of 16 ms


class Session:
    """State of the board and the line.

    Parameters
    ----------
    terms : Terms
        What the board must be.
    line : LineWatch
        Names the likely cause when nothing comes through.
    """

    def __init__(self, terms: Terms, line: LineWatch) -> None:
        self.terms = terms
        self._line = line
        self.reset()

    def reset(self) -> None:
        """As new: no port, no board known."""
        self._asking = Asking(self.terms.token_bits)
        self._pinging = Pinging(self.terms.has_ping)
        self.hello: Hello | None = self.terms.assumed_hello()
        """What the last good board said; kept when it leaves, as the name to speak of it."""
        self.lost("opening the port")

    def configure(self, params: SessionParams) -> None:
        """Take new parameters; the board is asked again who it is, and what follows from that is done."""
        self.terms.configure(params)
        self._refused = ""  # what was refused is not what is asked now
        self._asking.keep_quiet(0.0)
        if self.terms.confirms:
            self._known = False

    # ---- what happens ------------------------------------------------------------------------------

    def opened(self, now_s: float) -> list[Command]:
        """The port is open."""
        self._open, self._leaving = True, False
        self._scan_s = now_s
        self._asking.reset(now_s)
        # Firmware that never introduces itself is taken at its word, and started if it can be.
        self._known = not self.terms.introduces
        return self._step(now_s)

    def lost(self, reason: str) -> None:
        """The port is gone, or could not be opened."""
        self._open = self._known = self._streaming = self._running = self._stalled = self._leaving = False
        self._foreign = self._refused = ""
        self._rate_taken = self._confirmed = False
        self._gone, self._scan_s = reason, 0.0
        self._asking.reset(0.0)

    def greeted(self, hello: Hello, now_s: float) -> list[Command]:
        """The board introduced itself."""
        self._asking.answered("identify", now_s)
        if (foreign := self.terms.foreign_because(hello)) is not None:
            self._foreign = foreign
            self._known = self._running = self._stalled = False
            self._asking.keep_quiet(now_s + FOREIGN_S)
            return []
        if self.hello is None or _boot(self.hello) != _boot(hello):
            self._refused = ""  # another board, or the same one anew: let it decide again
        self._foreign = ""
        self.hello, self._known, self._streaming = hello, True, hello.streaming
        wanted = self._wanted()
        self._running = self._running and wanted is None
        self._confirmed = hello.streaming and wanted is None
        if self._rate_taken and wanted in ("stop", "set_rate"):
            self._refuse(
                f"the board took set_rate to {self.terms.params.rate_hz:g} Hz but says {hello.rate_hz:g} Hz: "
                "choose a rate that its timer can make",
                now_s,
            )
        self._rate_taken = False
        return self._step(now_s)

    def answered(self, answer: Acknowledge, now_s: float) -> list[Command]:
        """The board acknowledged a command."""
        if answer.command == "ping" and answer.result == "unknown_command":
            self._pinging.refuse()
        if not self._asking.awaits(answer):
            return []
        if answer.result == "busy":
            self._asking.answered_busy(answer.command, now_s)
            return []
        if answer.command == "identify" and answer.result == "ok":
            return []  # what answers identify is the hello
        self._asking.answered(answer.command, now_s)
        if answer.result != "ok":
            rate = f" to {self.terms.params.rate_hz:g} Hz" if answer.command == "set_rate" else ""
            self._refuse(f"the board refused {answer.command}{rate}: {answer.result}", now_s)
            return []
        self._refused = ""
        if answer.command == "set_rate":
            self._rate_taken, self._known = True, False  # the next hello says what rate it has become
        else:
            self._streaming, self._confirmed = answer.command == "start", False
        return self._step(now_s)

    def scanned(self, now_s: float) -> list[Command]:
        """Scans of our board came."""
        if self._foreign or not self._open:
            return []
        self._scan_s = now_s
        self._streaming = True
        if self._stalled and not self._known:
            self._known = True  # the line came back by itself: no board was changed on an open port
        if not self._running and self._known and self._wanted() is None:
            self._running, self._stalled = True, False
            self._pinging.reset(now_s)
            self._refused = self._asking.unanswered = ""
            self._known = self._confirmed or not self.terms.confirms
        return self._step(now_s)

    def tick(self, now_s: float) -> list[Command]:
        """Time passed: see what is overdue."""
        if self._leaving:
            return []
        if self._running and now_s >= self._scan_s + self.silence_s:
            self._running, self._stalled = False, True
            self._streaming, self._confirmed, self._known = False, False, not self.terms.confirms
            self._asking.asked_s = now_s
        if self._open and self._streaming and not self._running and now_s >= self._overdue_s:
            self._streaming = False  # it says it streams and is not heard: start it again
        # Only here: sent when scans come, pings would be in step with the adapter's hand-overs.
        return self._step(now_s) or self._ping(now_s)

    def stop(self) -> list[Command]:
        """We are leaving: what to tell the board; from now on nothing is restored."""
        self._leaving = True
        if not (self._open and (self._known or self._running or self._stalled) and self.terms.has_stop):
            return []
        return [self._asking.command("stop")]

    # ---- what follows ------------------------------------------------------------------------------

    @property
    def state(self) -> BoardState:
        if not self._open:
            return "no-device"
        if self._foreign or self._refused:
            return "fault"
        if self._running:
            return "running"
        return "stalled" if self._stalled else "syncing"

    @property
    def accepted(self) -> bool:
        """Whether scans that come now are those of our board."""
        return self._open and not self._foreign and self.hello is not None

    @property
    def board_serial(self) -> str:
        """Name of the board, also of one that left; empty while none is known."""
        return self.hello.board_serial if self.hello is not None else self.terms.params.board_serial or ""

    @property
    def rate_hz(self) -> float:
        """Scan rate as the board said it; 0.0 before it did."""
        return self.hello.rate_hz if self.hello is not None else 0.0

    @property
    def silence_s(self) -> float:
        """How long without a scan is a stall."""
        return max(SILENT_LEAST_S, SILENT_PERIODS / self.rate_hz) if self.rate_hz else math.inf

    @property
    def deadline_s(self) -> float:
        """When `tick` must be called if nothing happens before; inf where only the board can act."""
        if not self._open or self._leaving:
            return math.inf
        if self._running:
            silent_s = self._scan_s + self.silence_s
            return silent_s if self._wanted() is not None else min(silent_s, self._pinging.due_s)
        if self._wanted() is not None:
            return self._asking.due_s
        return self._overdue_s if self._streaming else math.inf

    def reason(self, now_s: float) -> str:
        """Why it is not running and what to look at; empty while it is."""
        if not self._open:
            return self._gone
        if self._foreign or self._refused or self._running:
            return self._foreign or self._refused
        if fault := self._line.fault(now_s):
            return fault
        if put_off := self._asking.put_off:
            return f"the board is busy and puts off {put_off}: it is asked again until it is ready"
        if (unanswered := self._asking.unanswered) and self._line.is_overloaded:
            return f"the board does not answer {unanswered} in time: {self._line.overload}"
        if unanswered:
            return f"the board sends but does not answer {unanswered}: is the line to it broken?"
        if self._stalled:
            return f"no scan for {self.silence_s * 1000:.0f} ms or more"
        return "waiting for scans" if self._known else "waiting for the board to introduce itself"

    # ---- how it is decided -------------------------------------------------------------------------

    def _wanted(self) -> str | None:
        """Name of the command that the board needs next, from all that is known of it."""
        if not self._open or self._leaving:
            return None
        return self.terms.wanted(self._known, self._streaming, self.rate_hz)

    def _step(self, now_s: float) -> list[Command]:
        """The wanted command, unless it is on its way or must wait."""
        if (name := self._wanted()) is None:
            self._asking.drop()
            return []
        if not self._asking.is_due(name, now_s):
            return []
        if self._asking.is_exhausted(name):
            self._asking.unanswered = name
            if name != "identify" and self.terms.confirms:
                self._known, name = False, "identify"
        return [self._asking.ask(name, self.terms.params.rate_hz, now_s)]

    def _ping(self, now_s: float) -> list[Command]:
        """A ping, if one is due to a board that needs nothing else."""
        if not self._running or self._wanted() is not None or now_s < self._pinging.due_s:
            return []
        self._pinging.sent(now_s)
        return [self._asking.command("ping")]

    def _refuse(self, reason: str, now_s: float) -> None:
        """The board will not do what it must: say so, and look afresh in a while."""
        self._refused, self._running = reason, False
        self._known = not self.terms.introduces
        self._asking.keep_quiet(now_s + FOREIGN_S)

    @property
    def _overdue_s(self) -> float:
        """When a board that says it streams should have been heard."""
        return max(self._asking.asked_s, self._scan_s) + max(ANSWER_S, self.silence_s)


def _boot(hello: Hello) -> tuple[str, int]:
    """Which board, and which of its lives."""
    return hello.board_serial, hello.boot_count

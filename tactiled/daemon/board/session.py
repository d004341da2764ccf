"""Session with a board, without I/O: its state, the commands it needs, and their deadlines.

::

    no-device --opened--> syncing --hello fits, settings made, scans--> running
        ^                  |   ^                                        |   ^
        |                  |   '---- rebooted, stopped, new rate -------'   |
        |                  '-- wrong board, refused command --> fault       |
        '---- lost, from anywhere                 silence --> stalled ------'

The next command follows from what is known of the board alone (`Session._wanted`), not from a
sequence of steps: an unknown board is asked to identify itself, then its rate is set, then it is started. A
reboot, a lost answer or a replug makes something unknown again, so every setting is restored by the same
rule. A board that has not identified itself as the configured one gets no command but ``identify``. A
started board is identified once more when its scans arrive, because it may have rebooted between its hello
and the start and lost its settings.

A running board that needs no command is pinged about once a second, for the clock fit of the pipeline.
Nothing waits for the answer: a ping is sent only while no command awaits an answer, and a command is sent
whether a ping was answered or not.

Every input takes ``now_s`` and returns the commands to send; `deadline_s` says when `tick` is due.
"""

import math
from collections.abc import Callable

from pydantic import Field

from tactiled.daemon.board.asking import ANSWER_S, Asking, Pinging
from tactiled.daemon.board.diagnosis import LineWatch
from tactiled.errors import ConfigError
from tactiled.events.types import BoardState
from tactiled.pipeline import RATES_HZ
from tactiled.tomlfile import Params
from tactiled.wire.frames import Acknowledge, Command, Hello
from tactiled.wire.layout import Layout

# Period of asking a wrong or refusing board again, which may have been replaced or reconfigured.
FOREIGN_S = 1.0
# A stall is a silence of this many scan periods, which a healthy board does not lose in a row, and of at
# least a few FTDI buckets of 16 ms.
SILENT_PERIODS = 5.0
SILENT_LEAST_S = 0.05
_SAME_RATE = 1e-3  # relative: board timers divide, and the wire rounds to millihertz


class SessionParams(Params):
    """Identity and scan rate of the board."""

    board_serial: str | None = Field(
        default=None,
        min_length=1,
        description="Serial number of the only board to accept (`tactiled listen -t info` shows it). Omit it "
        "where only one board can be plugged in.",
    )
    rate_hz: float | None = Field(
        default=None,
        ge=RATES_HZ[0],
        le=RATES_HZ[1],
        description="Scan rate to set, in Hz, after every replug and reset; omit it to keep the board's own.",
    )


class Session:
    """State machine of the board and its line.

    `ConfigError` if a rate is configured that the layout cannot set or confirm.

    Parameters
    ----------
    check : callable
        Returns the reason why a board does not fit layout and array, or None (`pipeline.check_hello`).
    line : LineWatch
        Names the likely cause when no frame arrives.
    """

    def __init__(
        self, params: SessionParams, layout: Layout, check: Callable[[Hello], str | None], line: LineWatch
    ) -> None:
        self._layout = layout
        self._check = check
        self._line = line
        self._has_hello = layout.has("hello")
        # The board sends its hello when asked, so that a setting can be confirmed.
        self._can_identify = self._has_hello and layout.has("identify")
        self._asking = Asking(layout.bits("identify", "token") or layout.bits("start", "token") or 16)
        answers_ticks = layout.bits("acknowledge", "ticks") is not None and layout.tick_s is not None
        self._pinging = Pinging(layout.has("ping") and answers_ticks)
        self.hello: Hello | None = layout.assumed_hello()
        """Hello of the last accepted board; kept after it is unplugged, because events need its name."""
        if params.rate_hz is not None and not (self._can_identify and layout.has("set_rate")):
            fault = f"protocol {layout.name} cannot set and confirm a rate: leave rate_hz out"
            raise ConfigError("session.rate_hz", [fault])
        self.params = params
        self.lost("opening the port")

    # ---- inputs ------------------------------------------------------------------------------------

    def opened(self, now_s: float) -> list[Command]:
        """Handle a port that was just opened."""
        self._open = True
        self._scan_s = now_s
        self._asking.reset(now_s)
        # Firmware without a hello message is accepted unseen, and started if its protocol can do that.
        self._is_identified = not self._has_hello
        return self._step(now_s)

    def lost(self, reason: str) -> None:
        """Handle a port that was lost or could not be opened."""
        # Of these, `_running` and `_stalled` are never true together, nor either of them with `_foreign`.
        self._open = False  # the port is open
        self._is_identified = False  # it has identified itself since it may have changed; see `_wanted`
        self._streaming = False  # the board says that it sends scans, or has sent some
        self._running = False  # scans arrive from the accepted board with all its settings made
        self._stalled = False  # it was running, and its scans have stopped
        self._hello_shows_ready = False  # the newest hello says that it streams with all its settings made
        self._rate_taken = False  # the board has accepted set_rate, and no hello has stated the rate yet
        self._leaving = False  # the daemon ends: nothing is restored
        self._last_stop: Command | None = None  # with which the daemon ends, until it is answered
        self._stop_again_s = math.inf  # when it is repeated
        self._foreign = ""  # why the board is not the configured one
        self._refused = ""  # why a command failed that the board needs
        self._gone = reason  # why the port is not open
        self._scan_s = 0.0  # when scans last arrived, or the port was opened
        self._asking.reset(0.0)

    def greeted(self, hello: Hello, now_s: float) -> list[Command]:
        """Handle a hello of the board."""
        self._asking.answered("identify", now_s)
        if (foreign := self._foreign_because(hello)) is not None:
            self._foreign = foreign
            self._is_identified = self._running = self._stalled = False
            self._asking.keep_quiet(now_s + FOREIGN_S)
            return []
        if self.hello is None or _boot(self.hello) != _boot(hello):
            self._refused = ""  # another board, or a new boot of the same one: the refusal no longer holds
        self._foreign = ""
        self.hello, self._is_identified, self._streaming = hello, True, hello.streaming
        wanted = self._wanted()
        self._running = self._running and wanted is None
        self._hello_shows_ready = hello.streaming and wanted is None
        if self._rate_taken and wanted in ("stop", "set_rate"):
            self._refuse(
                f"the board took set_rate to {self.params.rate_hz:g} Hz but says "
                f"{hello.rate_hz:g} Hz: choose a rate that its timer can make",
                now_s,
            )
        self._rate_taken = False
        return self._step(now_s)

    def answered(self, answer: Acknowledge, now_s: float) -> list[Command]:
        """Handle an answer of the board to a command."""
        stop = self._last_stop
        if stop is not None and (answer.command, answer.token) == ("stop", stop.token):
            if answer.result == "busy":
                self._last_stop = self._asking.new_command("stop")
            else:
                self._last_stop, self._stop_again_s = None, math.inf
            return []
        if answer.command == "ping" and answer.result == "unknown_command":
            self._pinging.refused()
        if not self._asking.awaits(answer):
            return []
        if answer.result == "busy":
            self._asking.answered_busy(answer.command, now_s)
            return []
        if answer.command == "identify" and answer.result == "ok":
            return []  # the hello is the real answer to identify
        self._asking.answered(answer.command, now_s)
        if answer.result != "ok":
            rate = f" to {self.params.rate_hz:g} Hz" if answer.command == "set_rate" else ""
            self._refuse(f"the board refused {answer.command}{rate}: {answer.result}", now_s)
            return []
        self._refused = ""
        if answer.command == "set_rate":
            self._rate_taken, self._is_identified = True, False  # the next hello states the new rate
        else:
            self._streaming, self._hello_shows_ready = answer.command == "start", False
        return self._step(now_s)

    def scanned(self, now_s: float) -> list[Command]:
        """Handle the arrival of scans."""
        if self._foreign or not self._open:
            return []
        self._scan_s = now_s
        self._streaming = True
        if self._stalled and not self._is_identified:
            # The line recovered by itself. Below, the board is identified again: it may have been exchanged.
            self._is_identified = True
        if not self._running and self._is_identified and self._wanted() is None:
            self._running, self._stalled = True, False
            self._pinging.reset(now_s)
            self._refused = self._asking.unanswered = ""
            # It may have rebooted between its hello and the start: it is identified once more while it runs.
            self._is_identified = self._hello_shows_ready or not self._can_identify
        return self._step(now_s)

    def note_streaming(self) -> None:
        """Take note that the board sends scans at a rate that is not known yet: it need not be started."""
        self._streaming = True

    def tick(self, now_s: float) -> list[Command]:
        """Act on passed deadlines."""
        if self._leaving:
            if self._last_stop is None or now_s < self._stop_again_s:
                return []
            self._stop_again_s = now_s + ANSWER_S
            return [self._last_stop]  # with its token where the answer was lost: protocols/board.md
        if self._running and now_s >= self._scan_s + self.silence_s:
            self._running, self._stalled = False, True
            self._streaming = self._hello_shows_ready = False
            self._is_identified = not self._can_identify
        if self._open and self._streaming and not self._running and now_s >= self._overdue_s:
            self._streaming = False  # the board says that it streams, but no scan arrives: start it again
        # Pings are sent on a deadline only: on the arrival of scans they would keep step with the adapter.
        return self._step(now_s) or self._ping(now_s)

    def stop(self, now_s: float) -> list[Command]:
        """Return the command that stops the board when the daemon ends; nothing is restored after it.

        `tick` repeats it until the board answers, and not with ``busy``.
        """
        self._leaving = True
        is_ours = self._is_identified or self._running or self._stalled
        if not (self._open and is_ours and self._layout.has("stop")):
            return []
        command = self._asking.new_command("stop")
        if self._layout.has("acknowledge"):
            self._last_stop, self._stop_again_s = command, now_s + ANSWER_S
        return [command]

    # ---- outputs -----------------------------------------------------------------------------------

    @property
    def state(self) -> BoardState:
        """State as the status event has it."""
        if not self._open:
            return "no-device"
        if self._foreign or self._refused:
            return "fault"
        if self._running:
            return "running"
        return "stalled" if self._stalled else "syncing"

    @property
    def is_stopping(self) -> bool:
        """True from `stop` until the board has answered its command, behind the last scan."""
        return self._last_stop is not None

    @property
    def accepted(self) -> bool:
        """True when arriving scans are those of the accepted board."""
        return self._open and not self._foreign and self.hello is not None

    @property
    def board_serial(self) -> str:
        """Serial number of the board, also after it was unplugged; empty while none is known."""
        return self.hello.board_serial if self.hello is not None else self.params.board_serial or ""

    @property
    def rate_hz(self) -> float:
        """Scan rate of the last hello, hertz; 0.0 before any."""
        return self.hello.rate_hz if self.hello is not None else 0.0

    @property
    def silence_s(self) -> float:
        """Seconds without a scan after which the board counts as stalled; inf while its rate is unknown."""
        return max(SILENT_LEAST_S, SILENT_PERIODS / self.rate_hz) if self.rate_hz else math.inf

    @property
    def deadline_s(self) -> float:
        """Time at which `tick` must be called at the latest; inf when only the board can act."""
        if not self._open or self._leaving:
            return self._stop_again_s
        if self._running:
            silent_s = self._scan_s + self.silence_s
            return silent_s if self._wanted() is not None else min(silent_s, self._pinging.due_s)
        if self._wanted() is not None:
            return self._asking.due_s
        return self._overdue_s if self._streaming else math.inf

    def reason(self, now_s: float) -> str:
        """Reason why the board is not running, and what to check; empty while it runs."""
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
        return "waiting for scans" if self._is_identified else "waiting for the board to introduce itself"

    # ---- decisions ---------------------------------------------------------------------------------

    def _wanted(self) -> str | None:
        """Name of the command that the board needs next; None for none."""
        if not self._open or self._leaving:
            return None
        if not self._is_identified:
            return "identify" if self._layout.has("identify") else None
        asked_hz = self.params.rate_hz
        if asked_hz is not None and not math.isclose(self.rate_hz, asked_hz, rel_tol=_SAME_RATE):
            return "stop" if self._streaming and self._layout.has("stop") else "set_rate"
        if not self._streaming and self._layout.has("start"):
            return "start"
        return None

    def _foreign_because(self, hello: Hello) -> str | None:
        """Reason why this is not the configured board, or None when it is."""
        pinned = self.params.board_serial
        if pinned is not None and hello.board_serial != pinned:
            return (
                f"board {hello.board_serial} is plugged in, board {pinned} is configured: swap them, "
                "or correct session.board_serial"
            )
        return self._check(hello)

    def _step(self, now_s: float) -> list[Command]:
        """Return the command that the board needs, unless it awaits an answer or must wait."""
        if (name := self._wanted()) is None:
            self._asking.drop()
            return []
        if not self._asking.is_due(name, now_s):
            return []
        if self._asking.is_exhausted(name):
            self._asking.unanswered = name
            if name != "identify" and self._can_identify:
                self._is_identified, name = False, "identify"
        return [self._asking.ask(name, self.params.rate_hz, now_s)]

    def _ping(self, now_s: float) -> list[Command]:
        """Return a ping if one is due and the board needs no command."""
        if not self._running or self._wanted() is not None or now_s < self._pinging.due_s:
            return []
        self._pinging.sent(now_s)
        return [self._asking.new_command("ping")]

    def _refuse(self, reason: str, now_s: float) -> None:
        """Enter the state fault for a command that the board refused; it is asked again after `FOREIGN_S`."""
        self._refused, self._running = reason, False
        self._is_identified = not self._has_hello
        self._asking.keep_quiet(now_s + FOREIGN_S)

    @property
    def _overdue_s(self) -> float:
        """Time by which a streaming board must have sent a scan."""
        return max(self._asking.asked_s, self._scan_s) + max(ANSWER_S, self.silence_s)


def _boot(hello: Hello) -> tuple[str, int]:
    """Identity of one boot of one board."""
    return hello.board_serial, hello.boot_count

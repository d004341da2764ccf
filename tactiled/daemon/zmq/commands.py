"""Execution of the commands of clients: detector settings, announced motion, recording. No I/O.

A command of motion states when it was sent, in the sender's own clock. Its arrival in the daemon's clock,
minus that, is the offset of the clocks plus the delay of the command, which is never negative. The smallest
such difference of the last seconds is therefore the best estimate, as in the clock filter of NTP (RFC 5905,
section 10).
"""

import itertools
import json
import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from tactiled.daemon.zmq.requests import CommandRequest, Mark, Motion, Record, Requester
from tactiled.events.types import CommandEvent, Event
from tactiled.pipeline import Pipeline

# Instants lie so far from that of sending at most. A value that is older applies to no scan any more, as it
# holds for 0.1 s; a plan that reaches further ahead is announced in parts.
REACH_S = 1.0
_SENDERS = 8  # whose clocks are kept: a controller, its earlier runs, and some people at a keyboard
# Between two command events of a sender with the same outcome, as between two lines of the log.
EVENT_PERIOD_S = 10.0
# Differences of the last one to two windows count: long enough that a command without much delay is among
# them, short enough that a clock that was set, or stood still, is followed.
WINDOW_S = 5.0
# Two crystals of 100 ppm each. A difference is worth that much less with each second of its age, so that an
# old one never maps an instant to before it was.
DRIFT = 200e-6

Course = dict[str, list[float]]
"""Arguments of the pipeline's command: ``time_s`` in the daemon's clock, and ``acceleration_m_s2``."""


class SenderClock:
    """Offset of a sender's clock from the daemon's.

    While the clocks drift by at most `DRIFT`, instants are never mapped too early. They are too late by at
    most the least of ``delay + 2 * DRIFT * age`` over the commands of the last `WINDOW_S`, this one included.

    Examples
    --------
    A clock 100 s behind, and delays of 3, 1 and 20 ms:

    >>> clock = SenderClock()
    >>> [f"{clock.offset_s(sent_s, 100 + sent_s + delay_s):.4f}"
    ...  for sent_s, delay_s in ((1.0, 0.003), (1.1, 0.001), (1.2, 0.020))]
    ['100.0030', '100.0010', '100.0010']
    """

    def __init__(self) -> None:
        # Smallest differences of this window and the one before, less the drift since the daemon's zero.
        self._least, self._least_before = math.inf, math.inf
        self._until_s = -math.inf

    def offset_s(self, sent_s: float, now_s: float) -> float:
        """Take the instant of sending a command that arrived at `now_s`; return what to add to instants."""
        if now_s >= self._until_s:
            is_next = now_s < self._until_s + WINDOW_S
            self._least_before = self._least if is_next else math.inf
            self._least, self._until_s = math.inf, now_s + WINDOW_S
        self._least = min(self._least, now_s - sent_s - DRIFT * now_s)
        return min(self._least, self._least_before) + DRIFT * now_s


@dataclass
class _Sender:
    """Program that announces motion."""

    clock: SenderClock = field(default_factory=SenderClock)
    told_s: dict[bool, float] = field(default_factory=dict)
    """Host time of its last command event, by outcome."""


class MotionSenders:
    """Programs that announce motion: the courses that their commands mean, and which of these are events."""

    def __init__(self) -> None:
        self._senders: OrderedDict[tuple[str, ...], _Sender] = OrderedDict()

    def course(self, command: Motion, sender: tuple[str, ...], now_s: float) -> tuple[str, Course]:
        """Return the reason for a refusal, or an empty string and the announced course.

        `sender` identifies a program that runs, and so a clock.
        """
        values = command.acceleration_m_s2
        if command.time_s is None or command.sent_s is None:
            reason = ""
            if command.time_s is not None:
                reason = "sent_s: missing: time_s needs your clock when you sent the command"
            elif command.sent_s is not None:
                reason = "time_s: missing: sent_s is of use for instants only"
            elif len(values) > 1:
                reason = f"time_s: missing: {len(values)} values of acceleration_m_s2 need their instants"
            return reason, {"time_s": [now_s], "acceleration_m_s2": values}
        times, sent_s = command.time_s, command.sent_s
        if len(times) != len(values):
            return f"time_s: {len(times)} instants for {len(values)} values of acceleration_m_s2", {}
        if any(after < before for before, after in itertools.pairwise(times)):
            return "time_s: an instant is before the one in front of it", {}
        if times[0] < sent_s - REACH_S or times[-1] > sent_s + REACH_S:
            return f"time_s: an instant is more than {REACH_S:g} s from sent_s", {}
        offset_s = self._find(sender).clock.offset_s(sent_s, now_s)
        late_s = now_s - (sent_s + offset_s)
        if late_s > REACH_S:
            return (
                f"sent_s: the command took {late_s:.1f} s longer than others before, or your clock was set",
                {},
            )
        return "", {"time_s": [time_s + offset_s for time_s in times], "acceleration_m_s2": values}

    def is_event(self, sender: tuple[str, ...], *, ok: bool, now_s: float) -> bool:
        """Return True for the first command of a sender with this outcome within `EVENT_PERIOD_S`.

        A stream of motion would leave nothing else among the stored command events.
        """
        told_s = self._find(sender).told_s
        if now_s < told_s.get(ok, -math.inf) + EVENT_PERIOD_S:
            return False
        told_s[ok] = now_s
        return True

    def _find(self, name: tuple[str, ...]) -> _Sender:
        sender = self._senders.pop(name, None) or _Sender()
        self._senders[name] = sender  # the newest is last
        if len(self._senders) > _SENDERS:
            self._senders.popitem(last=False)
        return sender


def _sender_id(command: Motion, requester: Requester) -> tuple[str, ...]:
    """Return what identifies the program that sends motion: programs behind a bridge share its connection."""
    return requester.key, requester.connection, command.who


class Commands:
    """Carry out the commands of clients.

    Parameters
    ----------
    took_input : callable
        Takes an input of the pipeline, and the events that it has caused: (name, arguments, events, now_s).
    record : callable
        Starts (True) or stops (False) the recording; returns the reason for a refusal.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        took_input: Callable[[str, dict[str, Any], Sequence[Event], float], None],
        record: Callable[[bool], str],
    ) -> None:
        self._pipeline = pipeline
        self._took_input = took_input
        self._record = record
        self._motion = MotionSenders()

    def do(self, command: CommandRequest, requester: Requester, now_s: float) -> str:
        """Carry out a command; return the reason for a refusal, or an empty string."""
        if isinstance(command, Mark):
            return ""
        if isinstance(command, Record):
            return self._record(command.on)
        if isinstance(command, Motion):
            reason, course = self._motion.course(command, _sender_id(command, requester), now_s)
            return reason or self._tune(command.do, course, now_s)
        return self._tune(command.do, command.arguments, now_s)

    def _tune(self, name: str, arguments: dict[str, Any], now_s: float) -> str:
        """Give an input to the pipeline; return the reason for a refusal."""
        reason, events = self._pipeline.command(name, arguments, now_s)
        if not reason:
            self._took_input(name, arguments, events, now_s)
        return reason

    def settings(self, now_s: float) -> dict[str, Any]:
        """Return the present settings, by the names that requests use."""
        tuning = self._pipeline.tuning
        acceleration_m_s2 = tuning.acceleration_m_s2(now_s)
        return {
            "speed_mm_s": tuning.speed_mm_s or 0.0,
            "friction": list(tuning.friction or ()),
            "acceleration_m_s2": [] if math.isnan(acceleration_m_s2) else [acceleration_m_s2],
            "inhibited_s": tuning.inhibited_s(now_s),
            "tared": tuning.baseline_volts is not None,
            "detect": tuning.params.model_dump(mode="json", exclude_none=True),
        }

    def event(
        self, command: CommandRequest, requester: Requester, reason: str, now_s: float
    ) -> CommandEvent | None:
        """Make the command event: the requester, the command and its outcome; None for most of a stream."""
        if isinstance(command, Motion) and not self._motion.is_event(
            _sender_id(command, requester), ok=not reason, now_s=now_s
        ):
            return None
        return CommandEvent(
            time_s=now_s,
            request_id=command.id,
            command=command.do,
            arguments=json.dumps(command.arguments),
            who=command.who,
            key=requester.key,
            uid=requester.uid,
            ok=not reason,
            reason=reason,
            scan_index=self._pipeline.tuning.next_index,
        )

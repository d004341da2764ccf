"""Announced motion of requests, checked and mapped to the daemon's clock. Pure: time is an argument."""

import itertools
import math
from collections import OrderedDict
from dataclasses import dataclass, field

from tactiled.daemon.zmq.requests import Motion
from tactiled.daemon.zmq.sender_clock import SenderClock

# Instants lie so far from that of sending at most. A value that is older applies to no scan any more, as it
# holds for 0.1 s; a plan that reaches further ahead is announced in parts.
REACH_S = 1.0
_SENDERS = 8  # that are known: a controller, those before it, and some at a keyboard
# Between two command events of a sender with the same outcome, as between two lines of the log.
EVENT_PERIOD_S = 10.0

Course = dict[str, list[float]]
"""Arguments of the pipeline's command: ``time_s`` in the daemon's clock, and ``acceleration_m_s2``."""


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

        Parameters
        ----------
        sender : tuple of str
            Identifies a program that runs, and so a clock.
        now_s : float
            Arrival of the command.
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
        offset_s = self._sender(sender).clock.offset_s(sent_s, now_s)
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
        told_s = self._sender(sender).told_s
        if now_s < told_s.get(ok, -math.inf) + EVENT_PERIOD_S:
            return False
        told_s[ok] = now_s
        return True

    def _sender(self, name: tuple[str, ...]) -> _Sender:
        sender = self._senders.pop(name, None) or _Sender()
        self._senders[name] = sender  # the newest is last
        if len(self._senders) > _SENDERS:
            self._senders.popitem(last=False)
        return sender

"""Execution of commands: detector settings, scan rate, recording. No I/O; time is an argument."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tactiled.daemon.board.requirements import SessionParams, is_same_rate
from tactiled.daemon.board.session import Session
from tactiled.daemon.zmq.motion import MotionSenders
from tactiled.daemon.zmq.requests import CommandRequest, Mark, Motion, Rate, Record, Requester, sender_of
from tactiled.errors import ConfigError, TactiledError
from tactiled.events.types import CommandEvent, Event
from tactiled.pipeline import Pipeline

# Time limit of a change of rate: stop, set_rate, identify and start take some 0.1 s, and three lost answers
# 0.6 s more.
RATE_S = 3.0

Done = Callable[[str], None]
"""Takes the reason for a refusal, or an empty string when the command is done."""


@dataclass(frozen=True)
class _RateChange:
    rate_hz: float
    before_hz: float | None
    until_s: float
    done: Done


class Commands:
    """Carry out commands.

    Parameters
    ----------
    tuned : callable
        Takes the events caused by a change of the detectors: (name, arguments, events, now_s).
    record : callable, optional
        Starts (True) or stops (False) the recording; returns the reason for a refusal, or raises a
        TactiledError.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        session: Session,
        tuned: Callable[[str, dict[str, Any], Sequence[Event], float], None],
        record: Callable[[bool], str] | None = None,
    ) -> None:
        self._pipeline = pipeline
        self._session = session
        self._tuned = tuned
        self._record = record
        self._motion = MotionSenders()
        self._rate: _RateChange | None = None
        self._commanded_hz: float | None = None

    def do(self, command: CommandRequest, requester: Requester, now_s: float, done: Done) -> None:
        """Carry out a command; `done` is called at once, or from `poll` when the board has answered."""
        if isinstance(command, Mark):
            done("")
        elif isinstance(command, Record):
            done(self._set_recording(command.on))
        elif isinstance(command, Rate):
            self._set_rate(command.rate_hz, now_s, done)
        elif isinstance(command, Motion):
            reason, course = self._motion.course(command, sender_of(command, requester), now_s)
            done(reason or self._tune(command.do, course, now_s))
        else:
            done(self._tune(command.do, command.arguments, now_s))

    def _tune(self, name: str, arguments: dict[str, Any], now_s: float) -> str:
        """Give a command to the pipeline; return the reason for a refusal."""
        reason, events = self._pipeline.command(name, arguments, now_s)
        if not reason:
            self._tuned(name, arguments, events, now_s)
        return reason

    def poll(self, now_s: float) -> None:
        """Check whether the board has accepted a rate; call it whenever the session may have changed."""
        change, session = self._rate, self._session
        if change is None:
            return
        if session.state == "running" and is_same_rate(session.rate_hz, change.rate_hz):
            self._rate, self._commanded_hz = None, change.rate_hz
            change.done("")
        elif session.state == "no-device":
            self._rate, self._commanded_hz = None, change.rate_hz
            change.done("")  # the session sets it when the board is back, like every setting
        elif session.state == "fault" or now_s >= change.until_s:
            self._rate = None
            reason = session.reason(now_s) or f"not confirmed by the board within {RATE_S:g} s"
            params = session.requirements.params
            # A configuration that was reloaded meanwhile keeps its own rate.
            if params.rate_hz == change.rate_hz:
                params = params.model_copy(update={"rate_hz": change.before_hz})
                session.configure(params)
            kept_hz = params.rate_hz
            kept = (
                "the board keeps the rate that it has"
                if kept_hz is None
                else f"{kept_hz:g} Hz is set instead"
            )
            change.done(f"{reason}; {kept}")

    def give_up(self, reason: str) -> None:
        """Refuse the change of rate that waits for the board, if there is one."""
        if (change := self._rate) is not None:
            self._rate = None
            change.done(reason)

    def configure(self, params: SessionParams) -> None:
        """Apply a configuration that was read again; without a rate in it, a commanded rate stays.

        Raises
        ------
        ConfigError
            A rate is configured that the protocol cannot set.
        """
        if params.rate_hz is None:
            rate_hz = self._commanded_hz if self._rate is None else self._rate.rate_hz
            self._session.configure(params.model_copy(update={"rate_hz": rate_hz}))
        else:
            self._session.configure(params)
            self._commanded_hz = None

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
            "rate_hz": self._session.rate_hz,
            "detect": tuning.params.model_dump(mode="json", exclude_none=True),
        }

    def event(
        self, command: CommandRequest, requester: Requester, reason: str, now_s: float
    ) -> CommandEvent | None:
        """Make the command event: the requester, the command and its outcome; None for most of a stream."""
        if isinstance(command, Motion):
            sender = sender_of(command, requester)
            if not self._motion.is_event(sender, ok=not reason, now_s=now_s):
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

    def _set_rate(self, rate_hz: float, now_s: float, done: Done) -> None:
        if self._rate is not None:
            done(f"{self._rate.rate_hz:g} Hz is being set: wait for it")
            return
        before = self._session.requirements.params
        try:
            self._session.configure(before.model_copy(update={"rate_hz": rate_hz}))
        except ConfigError as error:
            done("; ".join(error.faults))
            return
        self._rate = _RateChange(rate_hz, before.rate_hz, now_s + RATE_S, done)
        self.poll(now_s)

    def _set_recording(self, on: bool) -> str:
        if self._record is None:
            return "this daemon has no recorder: give record.directory in its configuration"
        try:
            return self._record(on)
        except TactiledError as error:
            return str(error)

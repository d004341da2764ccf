"""What a board must be and how it is set, as far as its protocol can say so and be told so. No I/O."""

import math
from collections.abc import Callable

from pydantic import Field

from tactiled.errors import ConfigError
from tactiled.tomlfile import Params
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout

_SAME_RATE = 1e-3  # relative: board timers divide, and the wire rounds to millihertz


def is_same_rate(one_hz: float, other_hz: float) -> bool:
    """Whether a board that was told one of these rates may say the other."""
    return math.isclose(one_hz, other_hz, rel_tol=_SAME_RATE)


class SessionParams(Params):
    """Which board, and how it is set."""

    board_serial: str | None = Field(
        default=None,
        min_length=1,
        description="Serial number of the one board to accept, as its hello says it (see `tactiled listen "
        "--topic info`). Leave it out where only one board can be plugged in; give it where two hands share "
        "a host, because a left board on the right hand's port is a wrong answer, not a missing one.",
    )
    rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="Scan rate to set, restored after every replug and reboot. Leave it out to take the "
        "board's own. Slip is found from 100 Hz; texture needs twice speed / groove period.",
    )


class Terms:
    """What we want of a board, and what its protocol allows.

    Parameters
    ----------
    params : SessionParams
    layout : Layout
    check : callable
        Reason why a board is not the one configured, or None (`pipeline.check_hello`).

    Attributes
    ----------
    params : SessionParams
    introduces : bool
        The board says who it is.
    confirms : bool
        It says so when it is asked, so that what it was told can be confirmed.
    has_stop : bool
    has_ping : bool
        Answers to pings tell when the board read the clock that dates its scans.
    token_bits : int

    Raises
    ------
    ConfigError
        A rate is asked of a layout that cannot set or confirm one.
    """

    def __init__(self, params: SessionParams, layout: Layout, check: Callable[[Hello], str | None]) -> None:
        self._layout = layout
        self._check = check
        self.introduces = layout.has("hello")
        self.confirms = self.introduces and layout.has("identify")
        self.has_stop = layout.has("stop")
        answers = layout.bits("acknowledge", "ticks") is not None
        self.has_ping = layout.has("ping") and answers and layout.tick_s is not None
        self.token_bits = layout.bits("identify", "token") or layout.bits("start", "token") or 16
        self.configure(params)

    def configure(self, params: SessionParams) -> None:
        """Take new parameters, or raise ConfigError and keep the old ones."""
        if params.rate_hz is not None and not (self.confirms and self._layout.has("set_rate")):
            fault = f"protocol {self._layout.name} cannot set and confirm a rate: leave rate_hz out"
            raise ConfigError("session.rate_hz", [fault])
        self.params = params

    def assumed_hello(self) -> Hello | None:
        """What is taken for granted of firmware that never introduces itself; None of other."""
        assumed = self._layout.file.assumed_hello
        if assumed is None:
            return None
        fields = assumed.model_dump() | {"channel_offset_s": tuple(assumed.channel_offset_s)}
        return Hello(protocol_version=self._layout.file.protocol_version, **fields)

    def foreign_because(self, hello: Hello) -> str | None:
        """Why this is not our board; None when it is."""
        pinned = self.params.board_serial
        if pinned is not None and hello.board_serial != pinned:
            return (
                f"board {hello.board_serial} is plugged in, board {pinned} is configured: swap them, "
                "or mend session.board_serial"
            )
        return self._check(hello)

    def wanted(self, known: bool, streaming: bool, rate_hz: float) -> str | None:
        """Name of the command that the board needs next, from all that is known of it."""
        if not known:
            return "identify" if self._layout.has("identify") else None
        asked_hz = self.params.rate_hz
        if asked_hz is not None and not is_same_rate(rate_hz, asked_hz):
            return "stop" if streaming and self.has_stop else "set_rate"
        if not streaming and self._layout.has("start"):
            return "start"
        return None

"""Requirements on a board: identity and scan rate, as far as its protocol can state and set them. No I/O."""

import math
from collections.abc import Callable

from pydantic import Field

from tactiled.errors import ConfigError
from tactiled.tomlfile import Params
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout

_SAME_RATE = 1e-3  # relative: board timers divide, and the wire rounds to millihertz


def is_same_rate(one_hz: float, other_hz: float) -> bool:
    """Return True for rates that are equal within the resolution of board timers."""
    return math.isclose(one_hz, other_hz, rel_tol=_SAME_RATE)


class SessionParams(Params):
    """Identity and scan rate of the board."""

    board_serial: str | None = Field(
        default=None,
        min_length=1,
        description="Serial number of the only board to accept (`tactiled listen -t info` shows it). Omit it "
        "where only one board can be plugged in; give it where a host has two hands, because data of the "
        "left hand on the right hand's port would be accepted and wrong.",
    )
    rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="Scan rate to set, in Hz; it is restored after every replug and reset. Omit it to keep "
        "the board's own rate. Grooves need more than twice (sliding speed / groove period).",
    )


class BoardRequirements:
    """Requirements on a board, combined with what its protocol can do.

    Parameters
    ----------
    check : callable
        Reason why a board is not the one configured, or None (`pipeline.check_hello`).

    Attributes
    ----------
    confirms : bool
        The board sends its hello when asked (``identify``), so that a setting can be confirmed.
    has_ping : bool
        The board answers pings with the ticks of the clock that dates its scans.
    token_bits : int
        Width of the tokens of commands on the wire.

    Raises
    ------
    ConfigError
        A rate is configured, and the layout cannot set or confirm one.
    """

    def __init__(self, params: SessionParams, layout: Layout, check: Callable[[Hello], str | None]) -> None:
        self._layout = layout
        self._check = check
        self.introduces = layout.has("hello")
        self.confirms = self.introduces and layout.has("identify")
        self.acknowledges = layout.has("acknowledge")
        self.has_stop = layout.has("stop")
        answers = layout.bits("acknowledge", "ticks") is not None
        self.has_ping = layout.has("ping") and answers and layout.tick_s is not None
        self.token_bits = layout.bits("identify", "token") or layout.bits("start", "token") or 16
        self.configure(params)

    def configure(self, params: SessionParams) -> None:
        """Take new parameters.

        Raises
        ------
        ConfigError
            A rate is configured, and the layout cannot set or confirm one; the old parameters stay.
        """
        if params.rate_hz is not None and not (self.confirms and self._layout.has("set_rate")):
            fault = f"protocol {self._layout.name} cannot set and confirm a rate: leave rate_hz out"
            raise ConfigError("session.rate_hz", [fault])
        self.params = params

    def assumed_hello(self) -> Hello | None:
        """Return the hello that the layout file states for firmware without one; None for other firmware."""
        return self._layout.assumed_hello()

    def foreign_because(self, hello: Hello) -> str | None:
        """Return the reason why this is not the configured board, or None when it is."""
        pinned = self.params.board_serial
        if pinned is not None and hello.board_serial != pinned:
            return (
                f"board {hello.board_serial} is plugged in, board {pinned} is configured: swap them, "
                "or correct session.board_serial"
            )
        return self._check(hello)

    def wanted(self, known: bool, streaming: bool, rate_hz: float) -> str | None:
        """Return the name of the command that the board needs next, or None.

        Parameters
        ----------
        known : bool
            The board has identified itself since the last event that could have changed it.
        """
        if not known:
            return "identify" if self._layout.has("identify") else None
        asked_hz = self.params.rate_hz
        if asked_hz is not None and not is_same_rate(rate_hz, asked_hz):
            return "stop" if streaming and self.has_stop else "set_rate"
        if not streaming and self._layout.has("start"):
            return "start"
        return None

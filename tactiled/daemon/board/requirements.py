"""Identity and scan rate that the configuration asks of a board."""

import math

from pydantic import Field

from tactiled.tomlfile import Params

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

"""What the codec yields and takes: frames, and the one value that says bytes were not a frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Scan:
    """One pass over all channels, as the board sent it.

    Attributes
    ----------
    sequence : int
        Wraps on the wire.
    counts : (channels,) int64
        ADC counts.
    ticks : int or None
        Board clock when the scan began; wraps on the wire. None where the layout has none.
    flags : int
        Bits named in the layout's ``[flags]``.
    """

    sequence: int
    counts: NDArray[np.int64]
    ticks: int | None = None
    flags: int = 0

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Scan)
            and (self.sequence, self.ticks, self.flags) == (other.sequence, other.ticks, other.flags)
            and np.array_equal(self.counts, other.counts)
        )

    __hash__ = None  # type: ignore[assignment]  # holds an array


@dataclass(frozen=True)
class Hello:
    """The board introduces itself; units as in the names, whatever the wire uses."""

    board_serial: str
    array_id: str
    rate_hz: float
    adc_bits: int
    adc_reference_v: float
    channel_offset_s: tuple[float, ...] = ()
    protocol_version: int = 1
    firmware_version: str = ""
    boot_count: int = 0
    streaming: bool = False
    ticks: int | None = None

    @property
    def volts_per_count(self) -> float:
        return float(self.adc_reference_v / 2**self.adc_bits)


@dataclass(frozen=True)
class Acknowledge:
    """The board's answer to a command: `result` is a name from the layout's ``[results]``."""

    token: int
    command: str
    result: str
    ticks: int | None = None


@dataclass(frozen=True)
class Command:
    """What the host asks of the board: ``start``, ``stop``, ``set_rate``, ``ping``, ``identify``."""

    name: str
    token: int
    rate_hz: float | None = None


Frame = Scan | Hello | Acknowledge | Command


@dataclass(frozen=True)
class Corrupt:
    """Bytes that could have been a frame and are not.

    Attributes
    ----------
    reason : str
        ``"stuffing"`` (not COBS), ``"overlong"`` (no delimiter in time), ``"length"`` and ``"checksum"``
        (damaged), ``"type"`` (intact, but no message of the layout: the other end speaks another
        protocol), or ``"value"`` (intact, but a field holds what it may not).
    n_bytes : int
        How many bytes were given up here, delimiter included.
    body : bytes
        Of an intact frame that is no message of the layout: its type and fields; else empty.
    """

    reason: str
    n_bytes: int
    body: bytes = b""


def values_of(frame: Frame) -> dict[str, Any]:
    """Fields of a frame by name."""
    return dict(vars(frame))

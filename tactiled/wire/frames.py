"""Frames of the codec, and `Corrupt` for bytes that are not a frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True, eq=False)  # not frozen: on cold caches, such an object takes 20 us to make
class Scan:
    """Frame of one pass over all channels."""

    sequence: int  # wraps on the wire. 0 where the layout has none
    # (channels,): ADC counts; float64 in the unit of the array, NaN included, where the layout carries such
    # readings
    counts: NDArray[np.int64] | NDArray[np.float64]
    # Board clock at the beginning of the scan; wraps on the wire. None where the layout has no ticks
    ticks: int | None = None
    flags: int = 0  # bits as named in the layout's ``[flags]``

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Scan)
            and (self.sequence, self.ticks, self.flags) == (other.sequence, other.ticks, other.flags)
            and np.array_equal(self.counts, other.counts, equal_nan=True)
        )

    __hash__ = None  # type: ignore[assignment]  # holds an array


@dataclass(frozen=True)
class Hello:
    """Self-description of a board; units as in the names, converted from those of the wire."""

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
        """Volts of one ADC count."""
        return float(self.adc_reference_v / 2**self.adc_bits)


@dataclass(frozen=True)
class Acknowledge:
    """Answer of the board to a command; `result` is a name from the layout's ``[results]``."""

    token: int
    command: str
    result: str
    ticks: int | None = None


@dataclass(frozen=True)
class Command:
    """Command of the host to the board: ``start``, ``stop``, ``set_rate``, ``ping`` or ``identify``."""

    name: str
    token: int
    rate_hz: float | None = None


Frame = Scan | Hello | Acknowledge | Command


@dataclass(frozen=True)
class Corrupt:
    """Bytes that were rejected as a frame."""

    # ``"stuffing"`` (not COBS), ``"overlong"`` (no delimiter in time), ``"length"`` and ``"checksum"``
    # (damaged), ``"type"`` (intact, but no message of the layout: the other end uses another protocol), or
    # ``"value"`` (intact, but a field has an invalid value), ``"terminator"`` (not in its place) or
    # ``"records"`` (no packet of known records)
    reason: str
    n_bytes: int  # discarded here, including the delimiter
    body: bytes = b""  # type and fields of an intact frame that is no message of the layout; otherwise empty

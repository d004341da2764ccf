"""Frame layouts: ``protocols/*.toml`` compiled into numpy record types.

Other firmware needs such a file, and no change of code.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled import tomlfile, tomltext
from tactiled.wire.frames import Hello
from tactiled.wire.schema import (
    PER_CHANNEL,
    CobsFraming,
    Direction,
    FieldLayout,
    LayoutFile,
    LinesFraming,
    TaggedFraming,
    TerminatorFraming,
)


@dataclass(frozen=True)
class MessageFormat:
    """Compiled message: record type on the wire, and wire value of one unit of each field."""

    name: str
    id: int
    dtype: np.dtype[np.void]
    per_unit: dict[str, int]
    fixed: bytes = b""
    """All bytes of a command without fields; empty for other messages."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Compiled layout; ``file`` is its source."""

    file: LayoutFile
    messages: dict[str, MessageFormat]

    @property
    def name(self) -> str:
        """Name of the layout."""
        return self.file.name

    @property
    def n_channels(self) -> int:
        """Number of channels in a scan."""
        return self.file.channels

    @property
    def terminator(self) -> bytes:
        """Bytes behind each frame or line; empty where the framing has none."""
        framing = self.file.framing
        if isinstance(framing, TerminatorFraming | LinesFraming):
            return bytes.fromhex(framing.terminator_hex)
        return b""

    @property
    def counts_scans(self) -> bool:
        """True when scans carry a sequence number, so that a lost one shows."""
        return self.bits("scan", "sequence") is not None

    @property
    def detects_damage(self) -> bool:
        """True when frames carry a checksum, so that a damaged one shows."""
        return isinstance(self.file.framing, CobsFraming)

    @property
    def carries_units(self) -> bool:
        """True when readings are numbers in the unit of the array, not counts of a converter."""
        return self.messages["scan"].dtype["counts"].base.kind == "f"

    @property
    def measures_rate(self) -> bool:
        """True when the scan rate is not stated and must be measured."""
        return self.file.assumed_hello is not None and self.file.assumed_hello.rate_hz is None

    def assumed_hello(self, measured_hz: float | None = None) -> Hello | None:
        """Return the hello of firmware that sends none; None where there is none, or its rate is not known.

        Parameters
        ----------
        measured_hz : float, optional
            Scan rate, where the layout does not state it.
        """
        assumed = self.file.assumed_hello
        rate_hz = measured_hz if assumed is None else assumed.rate_hz or measured_hz
        if assumed is None or rate_hz is None:
            return None
        return Hello(
            board_serial=assumed.board_serial,
            array_id=assumed.array_id,
            rate_hz=rate_hz,
            adc_bits=assumed.adc_bits,
            adc_reference_v=assumed.adc_reference_v,
            channel_offset_s=tuple(assumed.channel_offset_s),
            protocol_version=self.file.protocol_version,
        )

    @property
    def channel_places(self) -> NDArray[np.int64] | None:
        """Positions of the channels among the values of a scan, (channels,); None where all are channels."""
        (counts,) = (
            f for m in self.file.messages if m.name == "scan" for f in m.fields if f.name == "counts"
        )
        if not counts.left_out:
            return None
        return np.setdiff1d(np.arange(counts.n_values(self.n_channels)), counts.left_out)

    def incoming(self, direction: Direction) -> dict[int, MessageFormat]:
        """Return the messages of one direction by their type on the wire."""
        names = [m.name for m in self.file.messages if m.direction == direction]
        return {self.messages[name].id: self.messages[name] for name in names}

    def has(self, message: str) -> bool:
        """Return True when the layout has this message."""
        return message in self.messages

    def bits(self, message: str, field: str) -> int | None:
        """Return the width in bits of an integer field (for unwrapping), or None for no such field."""
        names = self.messages[message].dtype.fields if message in self.messages else None
        return 8 * names[field][0].base.itemsize if names and field in names else None

    @property
    def leading_token_bytes(self) -> int:
        """Width in bytes of the token that begins every command; 0 unless all have one of equal width."""
        first = [m.fields[0] for m in self.file.messages if m.direction == "host-to-board" and m.fields]
        widths = {f.n_bytes(1) if f.name == "token" else 0 for f in first}
        return widths.pop() if len(widths) == 1 else 0

    @property
    def tick_s(self) -> float | None:
        """Seconds of one tick of the board clock; None where scans carry no ticks."""
        scan = self.messages["scan"]
        return 1.0 / scan.per_unit["ticks"] if "ticks" in scan.per_unit else None

    @property
    def fixed_commands(self) -> dict[bytes, str]:
        """Names of the commands that are fixed bytes, by these bytes."""
        return {m.fixed: m.name for m in self.messages.values() if m.fixed}

    def flag(self, name: str) -> int:
        """Return the mask of a flag bit; 0 where the layout has no such flag."""
        return 1 << self.file.flags[name] if name in self.file.flags else 0

    def wire_bytes(self, message: str) -> int:
        """Return the number of bytes of a message on the wire, including framing and checksum."""
        if self.messages[message].fixed:
            return len(self.messages[message].fixed)
        n_bytes = self.messages[message].dtype.itemsize
        framing = self.file.framing
        if isinstance(framing, CobsFraming):  # type, checksum; a code for each begun run of 254, a delimiter
            return n_bytes + 3 + 1 + (n_bytes + 2) // 254 + 1
        if isinstance(framing, TaggedFraming):
            return len(tagged_packets(framing, bytes(n_bytes)))
        if isinstance(framing, LinesFraming):  # typical: numbers differ in length
            (scan,) = self.file.messages
            n_bytes = sum(f.n_bytes(self.n_channels) for f in scan.fields)
        return n_bytes + len(self.terminator)


def tagged_packets(framing: TaggedFraming, body: bytes) -> bytes:
    """Return the packets of a scan, with all bytes of the records that are no channels 0.

    Parameters
    ----------
    body : bytes
        Channels, in the order of the layout.
    """
    packets, at = [b""], 0  # records of each packet
    for record in framing.records:
        value = body[at : at + record.bytes] if record.channels else bytes(record.bytes)
        at += record.bytes if record.channels else 0
        if len(packets[-1]) + 1 + record.bytes > framing.most_bytes:
            packets.append(b"")
        packets[-1] += bytes([record.tag]) + value
    head = bytes.fromhex(framing.sync_hex) + bytes(framing.skipped)
    return b"".join(head + bytes([len(records)]) + records for records in packets)


def compile_layout(file: LayoutFile) -> Layout:
    """Compile a checked file into record types."""
    order = "<" if file.byte_order == "little" else ">"

    def field(f: FieldLayout) -> tuple[Any, ...]:
        if f.type == "text":
            kind = f"S{f.size}"
        else:  # numpy counts bytes: u2 for u16; a number of a text is a float64
            kind = f"{order}f8" if f.type == "number" else f"{order}{f.type[0]}{int(f.type[1:]) // 8}"
        return (f.name, kind, (f.n_values(file.channels),)) if f.name in PER_CHANNEL else (f.name, kind)

    return Layout(
        file=file,
        messages={
            m.name: MessageFormat(
                name=m.name,
                id=m.id,
                dtype=np.dtype([field(f) for f in m.fields]),
                per_unit={f.name: f.per_unit for f in m.fields},
                fixed=bytes.fromhex(m.hex or ""),
            )
            for m in file.messages
        },
    )


def load_layout(name_or_path: str) -> Layout:
    """Load a layout by shipped name (``board-v1``) or by path; `ConfigError` lists every fault."""
    return compile_layout(tomlfile.load(tomltext.locate(name_or_path, "protocols"), LayoutFile))

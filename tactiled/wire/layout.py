"""The frame layout is data: ``protocols/*.toml`` checked and compiled into numpy record types.

A lab with other firmware writes such a file and no Python. Names of messages and fields are the roles
that `frames` knows; order, width, byte order, framing and checksum are the file's own.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from tactiled import resources, tomlfile
from tactiled.errors import ConfigError
from tactiled.tomlfile import Params
from tactiled.wire.checksum import CHECKSUMS, Checksum

Unsigned = Literal["u8", "u16", "u32"]
FieldType = Literal["u8", "u16", "u32", "i8", "i16", "i32", "f32", "text"]
Direction = Literal["board-to-host", "host-to-board"]
_NUMPY = {"u8": "u1", "u16": "u2", "u32": "u4", "i8": "i1", "i16": "i2", "i32": "i4", "f32": "f4"}

# Roles: which fields each message may have, and which it must.
_COMMANDS = ("start", "stop", "set_rate", "ping", "identify")
_MUST: dict[str, set[str]] = {
    "scan": {"sequence", "counts"},
    "hello": {"board_serial", "array_id", "rate_hz", "adc_bits", "adc_reference_v"},
    "acknowledge": {"token", "command", "result"},
    **{name: {"token"} for name in _COMMANDS},
    "set_rate": {"token", "rate_hz"},
}
_MAY: dict[str, set[str]] = {
    "scan": {"ticks", "flags"},
    "hello": {
        "protocol_version", "firmware_version", "boot_count", "streaming", "ticks", "channel_offset_s",
    },
    "acknowledge": {"ticks"},
}  # fmt: skip
_PER_CHANNEL = {"counts", "channel_offset_s"}
_TEXT = {"board_serial", "array_id", "firmware_version"}
_IN_UNITS = {"rate_hz", "adc_reference_v", "channel_offset_s", "ticks"}


class FieldLayout(Params):
    """One field on the wire."""

    name: str
    type: FieldType
    count: Literal["channels"] | None = Field(default=None, description="an array, one for each channel")
    size: int | None = Field(default=None, ge=1, le=64, description="bytes of a text, padded with NUL")
    per_unit: int = Field(default=1, ge=1, description="wire value of one unit of the named quantity")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.type == "text") != (self.size is not None):
            raise ValueError("size belongs to type = 'text', and to no other type")
        if (self.type == "text") != (self.name in _TEXT):
            raise ValueError(f"{self.name} {'must' if self.name in _TEXT else 'cannot'} be text")
        if (self.count == "channels") != (self.name in _PER_CHANNEL):
            raise ValueError(f"count = 'channels' belongs to {' and '.join(sorted(_PER_CHANNEL))}")
        if self.per_unit != 1 and self.name not in _IN_UNITS:
            raise ValueError(f"per_unit has no meaning for {self.name}")
        return self


class MessageLayout(Params):
    """One message on the wire: its type and its fields in order."""

    name: Literal["scan", "hello", "acknowledge", "start", "stop", "set_rate", "ping", "identify"]
    id: int = Field(default=0, ge=0, le=65535)
    direction: Direction
    fields: list[FieldLayout] = Field(min_length=1)

    @model_validator(mode="after")
    def _roles(self) -> Self:
        names = [field.name for field in self.fields]
        must, may = _MUST[self.name], _MAY.get(self.name, set())
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"{self.name}: field {', '.join(sorted(twice))} is listed twice")
        if lacking := must - set(names):
            raise ValueError(f"{self.name}: lacks the field {', '.join(sorted(lacking))}")
        if unknown := set(names) - must - may:
            known = ", ".join(sorted(must | may))
            raise ValueError(f"{self.name}: no such field as {', '.join(sorted(unknown))}; known: {known}")
        if (self.direction == "host-to-board") != (self.name in _COMMANDS):
            raise ValueError(f"{self.name} cannot go {self.direction}")
        return self


class Framing(Params):
    """How a frame is found in a stream of bytes."""

    kind: Literal["cobs", "sync-length"]
    message_type: Unsigned | None = Field(default=None, description="absent: all is scans")
    sync_hex: str | None = Field(default=None, pattern=r"^([0-9A-Fa-f]{2}){1,8}$")
    length: Unsigned | None = Field(default=None, description="bytes of message type and fields")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        has_sync = (self.sync_hex is not None, self.length is not None)
        if has_sync != ((self.kind == "sync-length"),) * 2:
            raise ValueError("sync_hex and length belong to kind = 'sync-length', both of them")
        return self


def _known_checksum(name: object) -> object:
    if name not in CHECKSUMS:
        raise ValueError(f"no such checksum; known: {', '.join(CHECKSUMS)}")
    return name


class ChecksumLayout(Params):
    """What guards a frame."""

    algorithm: Annotated[str, BeforeValidator(_known_checksum)]
    covers: Literal["body", "length-and-body"] = "body"


class AssumedHello(Params):
    """What a hello would say, for firmware that never says it."""

    board_serial: str
    array_id: str
    rate_hz: float = Field(gt=0)
    adc_bits: int = Field(ge=1, le=32)
    adc_reference_v: float = Field(gt=0)
    channel_offset_s: list[float] = []


def width(kind: Unsigned | None) -> int:
    """Bytes of an optional unsigned field."""
    return int(kind[1:]) // 8 if kind else 0


class LayoutFile(Params):
    """Schema of ``protocols/*.toml``."""

    name: str
    protocol_version: int = Field(ge=0, le=255)
    channels: int = Field(ge=1, le=4096)
    byte_order: Literal["little", "big"]
    baud: int = Field(gt=0)
    framing: Framing
    checksum: ChecksumLayout
    messages: list[MessageLayout] = Field(min_length=1)
    results: dict[str, int] = {}
    flags: dict[str, int] = {}
    assumed_hello: AssumedHello | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [m.name for m in self.messages]
        ids = [(m.direction, m.id) for m in self.messages]
        if len(set(names)) < len(names) or len(set(ids)) < len(ids):
            raise ValueError("messages: a name or an id is used twice in one direction")
        if "scan" not in names:
            raise ValueError("messages: there is no scan")
        if ("hello" in names) == (self.assumed_hello is not None):
            raise ValueError("give either a hello message or [assumed_hello]")
        type_limit = 1 << (8 * width(self.framing.message_type))  # 1, so id 0 only, without a type
        for index, message in enumerate(self.messages):
            if message.id >= type_limit:
                raise ValueError(f"messages[{index}].id: {message.id} does not fit framing.message_type")
        if self.checksum.covers == "length-and-body" and self.framing.length is None:
            raise ValueError("checksum.covers = 'length-and-body', but the framing has no length")
        if any(name in names for name in _COMMANDS) and "ok" not in self.results:
            raise ValueError("results: commands need results, 'ok' among them")
        return self


@dataclass(frozen=True)
class Message:
    """A compiled message: its record type on the wire and what one unit of each field is."""

    name: str
    id: int
    dtype: np.dtype[np.void]
    per_unit: dict[str, int]


@dataclass(frozen=True, eq=False)
class Layout:
    """A compiled layout; ``file`` keeps what it was made of."""

    file: LayoutFile
    byte_order: Literal["little", "big"]
    type_bytes: int
    length_bytes: int
    sync: bytes
    checksum: Checksum
    messages: dict[str, Message]

    @property
    def name(self) -> str:
        return self.file.name

    @property
    def n_channels(self) -> int:
        return self.file.channels

    def incoming(self, direction: Direction) -> dict[int, Message]:
        """Messages of one direction by their type on the wire."""
        names = [m.name for m in self.file.messages if m.direction == direction]
        return {self.messages[name].id: self.messages[name] for name in names}

    def has(self, message: str) -> bool:
        return message in self.messages

    def bits(self, message: str, field: str) -> int | None:
        """Width in bits of an integer field (to unwrap it), or None where there is no such field."""
        names = self.messages[message].dtype.fields if message in self.messages else None
        return 8 * names[field][0].base.itemsize if names and field in names else None

    @property
    def tick_s(self) -> float | None:
        """Seconds of one tick of the board clock, or None where scans carry no ticks."""
        scan = self.messages["scan"]
        return 1.0 / scan.per_unit["ticks"] if "ticks" in scan.per_unit else None

    def flag(self, name: str) -> int:
        """Mask of a flag bit; 0 where the layout does not know the flag."""
        return 1 << self.file.flags[name] if name in self.file.flags else 0

    def body_bytes(self, message: Message) -> int:
        return self.type_bytes + message.dtype.itemsize


def compile_layout(file: LayoutFile) -> Layout:
    """Record types for each message of a checked file."""
    order = "<" if file.byte_order == "little" else ">"

    def field(f: FieldLayout) -> tuple[Any, ...]:
        kind = f"S{f.size}" if f.type == "text" else order + _NUMPY[f.type]
        return (f.name, kind, (file.channels,)) if f.count else (f.name, kind)

    return Layout(
        file=file,
        byte_order=file.byte_order,
        type_bytes=width(file.framing.message_type),
        length_bytes=width(file.framing.length),
        sync=bytes.fromhex(file.framing.sync_hex or ""),
        checksum=CHECKSUMS[file.checksum.algorithm],
        messages={
            m.name: Message(
                name=m.name,
                id=m.id,
                dtype=np.dtype([field(f) for f in m.fields]),
                per_unit={f.name: f.per_unit for f in m.fields},
            )
            for m in file.messages
        },
    )


def load_layout(name_or_path: str) -> Layout:
    """Layout by shipped name (``board-v1``) or by path; `ConfigError` with every fault of the file."""
    path = resources.find(name_or_path, "protocols")
    if not path.exists() and not path.suffix and "/" not in name_or_path:
        known = ", ".join(resources.shipped_names("protocols"))
        raise ConfigError("protocol", [f"no layout named {name_or_path!r}; shipped: {known}"])
    return compile_layout(tomlfile.load(path, LayoutFile))

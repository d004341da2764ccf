"""Schema of the layout files, ``protocols/*.toml``, with checks of their consistency.

Names of messages and fields are those of `frames`; a file chooses their order and width, the byte order and
framing. `layout` compiles a file that passes.
"""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tactiled.tomlfile import Params

FieldType = Literal["u8", "u16", "u32", "i8", "i16", "i32", "f32", "text", "number"]
Direction = Literal["board-to-host", "host-to-board"]

# Required and optional fields of each message.
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
PER_CHANNEL = {"counts", "channel_offset_s"}  # arrays, one value for each channel
UNCHECKED = ("terminator", "lines", "tagged")  # kinds of framing without a checksum
_FIXED = ("start", "stop")  # commands that a board may obey without an answer
# Bytes of a number in a line with its separator: sign, six digits, point. Only times on the line use it.
_TYPICAL_NUMBER = 9
IN_UNITS = {"rate_hz", "adc_reference_v", "channel_offset_s"}  # converted to the unit in the name
# Types of the fields that are more than unsigned integers.
_UNSIGNED = ("u8", "u16", "u32")
_QUANTITY = (*_UNSIGNED, "i8", "i16", "i32", "f32")
_TYPES = {
    **dict.fromkeys(("board_serial", "array_id", "firmware_version"), ("text",)),
    **dict.fromkeys(IN_UNITS, _QUANTITY),
    "counts": (*_QUANTITY, "number"),
}
# Flags that tactiled.samples uses; another name would be a typing error that nobody notices.
_FLAGS = ("first_after_start", "overrun", "reference_fault")


class FieldLayout(Params):
    """Field on the wire."""

    name: str
    type: FieldType
    size: int | None = Field(default=None, ge=1, le=64, description="bytes of a text, padded with NUL")
    per_unit: int = Field(default=1, ge=1, description="wire value of one unit of the named quantity")
    left_out: list[int] = Field(
        default=[],
        description="positions among the values of counts that are no channels, such as temperatures",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        types = _TYPES.get(self.name, _UNSIGNED)
        if self.type not in types:
            raise ValueError(f"{self.name} must be {' or '.join(types)}")
        if (self.type == "text") != (self.size is not None):
            raise ValueError("size belongs to type = 'text', and to no other type")
        if self.per_unit != 1 and self.name not in IN_UNITS | {"ticks"}:
            raise ValueError(f"per_unit has no meaning for {self.name}")
        if self.left_out and self.name != "counts":
            raise ValueError("left_out belongs to counts")
        return self

    def n_bytes(self, channels: int) -> int:
        """Return the number of bytes on the wire."""
        if self.type == "number":
            return _TYPICAL_NUMBER * self.n_values(channels)
        one = self.size if self.size is not None else int(self.type[1:]) // 8
        return one * (self.n_values(channels) if self.name in PER_CHANNEL else 1)

    def n_values(self, channels: int) -> int:
        """Return the number of values of an array of all channels, with those that are left out."""
        return channels + len(self.left_out)


class MessageLayout(Params):
    """Message on the wire: its type and its fields in order."""

    name: Literal["scan", "hello", "acknowledge", "start", "stop", "set_rate", "ping", "identify"]
    id: int = Field(default=0, ge=0, le=255)
    fields: list[FieldLayout] = []
    hex: str | None = Field(
        default=None,
        pattern=r"^([0-9A-Fa-f]{2}){1,64}$",
        description="all bytes of a command that has no fields and is not answered",
    )

    @property
    def direction(self) -> Direction:
        """Way that the message goes."""
        return "host-to-board" if self.name in _COMMANDS else "board-to-host"

    @model_validator(mode="after")
    def _roles(self) -> Self:
        if bool(self.fields) == (self.hex is not None):
            raise ValueError(f"{self.name}: give either fields or, for start and stop, hex")
        if self.hex is not None:
            if self.name not in _FIXED:
                raise ValueError(f"{self.name} cannot be fixed bytes: hex belongs to start and stop")
            return self
        names = [field.name for field in self.fields]
        must, may = _MUST[self.name], _MAY.get(self.name, set())
        if self.name == "scan":  # only framing without a checksum may do without: see `LayoutFile`
            must, may = must - {"sequence"}, may | {"sequence"}
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"{self.name}: field {', '.join(sorted(twice))} is listed twice")
        if lacking := must - set(names):
            raise ValueError(f"{self.name}: lacks the field {', '.join(sorted(lacking))}")
        if unknown := set(names) - must - may:
            known = ", ".join(sorted(must | may))
            raise ValueError(f"{self.name}: no such field as {', '.join(sorted(unknown))}; known: {known}")
        return self


class RecordLayout(Params):
    """Record of a packet of tagged records."""

    tag: int = Field(ge=0, le=255, description="octet that begins the record, after framing.tag_mask")
    bytes: int = Field(ge=1, le=4095, description="bytes behind the tag")
    channels: bool = Field(default=False, description="the next channels of a scan; else skipped")


_Bytes = Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2}){1,8}$")]


class CobsFraming(Params):
    """COBS(message type u8, fields, CRC-16/IBM-3740), then 0x00."""

    kind: Literal["cobs"]


class TerminatorFraming(Params):
    """Fields of a scan, then a terminator."""

    kind: Literal["terminator"]
    terminator_hex: _Bytes


class LinesFraming(Params):
    """Numbers of a scan as text, then a terminator."""

    kind: Literal["lines"]
    terminator_hex: _Bytes
    separator: Literal[",", ";", " ", "\t"] = Field(
        description="between the numbers; a blank stands for any blanks and tabs"
    )


class TaggedFraming(Params):
    """Packets: sync word, skipped bytes, length u8, then records that each begin with a tag."""

    kind: Literal["tagged"]
    sync_hex: _Bytes
    skipped: int = Field(
        default=0, ge=0, le=16, description="bytes between sync word and length that are not read"
    )
    most_bytes: int = Field(default=255, ge=2, le=255, description="largest length of the records")
    tag_mask: int = Field(default=0xFF, ge=1, le=0xFF, description="bits of a tag that say the record")
    records: list[RecordLayout] = Field(min_length=1)

    @model_validator(mode="after")
    def _fit(self) -> Self:
        tags = [record.tag for record in self.records]
        for index, record in enumerate(self.records):
            if tags.index(record.tag) != index:
                raise ValueError(f"records[{index}].tag: {record.tag:#04x} is used twice")
            if record.tag & ~self.tag_mask:
                raise ValueError(f"records[{index}].tag: {record.tag:#04x} has bits outside tag_mask")
            if record.bytes >= self.most_bytes:
                raise ValueError(
                    f"records[{index}].bytes: {record.bytes} and the tag exceed a packet of {self.most_bytes}"
                )
        return self


Framing = Annotated[
    CobsFraming | TerminatorFraming | LinesFraming | TaggedFraming, Field(discriminator="kind")
]


class AssumedHello(Params):
    """Content of a hello, for firmware that never sends one."""

    board_serial: str
    array_id: str
    rate_hz: float | None = Field(default=None, gt=0, description="left out: measured")
    typical_rate_hz: float | None = Field(
        default=None, gt=0, description="rate of the emulated board where rate_hz is left out"
    )
    adc_bits: int = Field(default=16, ge=1, le=32)
    adc_reference_v: float = Field(default=3.0, gt=0)
    channel_offset_s: list[float] = []


class LayoutFile(Params):
    """Schema of ``protocols/*.toml``."""

    name: str
    protocol_version: int = Field(ge=0, le=255)
    channels: int = Field(ge=1, le=4096)
    byte_order: Literal["little", "big"]
    baud: int = Field(gt=0)
    framing: Framing
    messages: list[MessageLayout] = Field(min_length=1)
    results: dict[str, int] = {}
    flags: dict[str, int] = {}
    assumed_hello: AssumedHello | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        faults = [
            *self._message_faults(),
            *self._table_faults(),
            *self._protection_faults(),
            *self._command_faults(),
            *self._record_faults(),
        ]
        if faults:
            raise ValueError("; ".join(faults))
        return self

    def _message_faults(self) -> Iterator[str]:
        names = [m.name for m in self.messages]
        for name in sorted({n for n in names if names.count(n) > 1}):
            yield f"messages: {name} is described twice"
        ids = [(m.direction, m.id) for m in self.messages if m.hex is None]
        for direction, id_ in sorted({i for i in ids if ids.count(i) > 1}):
            yield f"messages: id {id_} is used twice {direction}"
        if "scan" not in names:
            yield "messages: there is no scan"
        if ("hello" in names) == (self.assumed_hello is not None):
            yield "give either a hello message or [assumed_hello]"
        answered = {m.name for m in self.messages if m.hex is None}
        if any(name in answered for name in _COMMANDS) and "acknowledge" not in names:
            yield "messages: commands need an acknowledge"
        ticks = {(f.type, f.per_unit) for m in self.messages for f in m.fields if f.name == "ticks"}
        if len(ticks) > 1:
            yield "messages: ticks must have the same type and per_unit everywhere, for it is one clock"

    def _protection_faults(self) -> Iterator[str]:
        kind = self.framing.kind
        fields = {f.name: f for m in self.messages if m.name == "scan" for f in m.fields}
        if kind not in UNCHECKED:
            if fields and "sequence" not in fields:
                yield "scan: lacks the field sequence"
        else:
            if [m.name for m in self.messages if m.hex is None] != ["scan"]:
                yield f"messages: framing.kind = '{kind}' carries scans, and commands with hex, only"
            if any(m.id for m in self.messages):
                yield f"messages: framing.kind = '{kind}' carries no id: leave it out"
            if "ticks" in fields and "sequence" not in fields:
                yield "scan: ticks without a sequence cannot be counted"
        counts = fields.get("counts")
        if counts is None:
            return
        if counts.type == "f32" and kind not in ("terminator", "tagged"):
            yield "counts must be an integer: f32 belongs to framing.kind = 'terminator' or 'tagged'"
        if (counts.type == "number") != (kind == "lines") or (kind == "lines" and len(fields) > 1):
            yield "type = 'number' belongs to the counts of framing.kind = 'lines', which has no other field"
        if len(set(counts.left_out)) < len(counts.left_out) or any(
            not 0 <= place < counts.n_values(self.channels) for place in counts.left_out
        ):
            yield f"left_out: positions must differ and lie in 0 to {counts.n_values(self.channels) - 1}"
        needed = {"rate_hz"} if kind not in UNCHECKED else set()  # otherwise it is measured
        if counts.type not in ("f32", "number"):
            needed |= {"adc_bits", "adc_reference_v"}
        if self.assumed_hello is not None:
            for name in sorted(needed - self.assumed_hello.model_fields_set):
                yield f"assumed_hello.{name}: missing"

    def _command_faults(self) -> Iterator[str]:
        fixed = {m.name: bytes.fromhex(m.hex) for m in self.messages if m.hex is not None}
        if fixed and self.framing.kind not in UNCHECKED:
            yield f"messages: hex belongs to framing.kind = {', '.join(repr(kind) for kind in UNCHECKED)}"
        if "stop" in fixed and "start" not in fixed:
            yield "messages: stop has hex, so start needs hex, too"
        if len(fixed) == 2 and (
            fixed["start"].startswith(fixed["stop"]) or fixed["stop"].startswith(fixed["start"])
        ):
            yield "messages: the hex of start and stop must differ, and neither begin with the other"

    def _record_faults(self) -> Iterator[str]:
        scan = next((m for m in self.messages if m.name == "scan"), None)
        if not isinstance(self.framing, TaggedFraming) or scan is None:
            return
        if [field.name for field in scan.fields] != ["counts"]:
            yield "scan: framing.kind = 'tagged' has no field but counts"
            return
        (counts,) = scan.fields
        one = counts.n_bytes(self.channels) // counts.n_values(self.channels)
        in_records = 0
        for index, record in enumerate(self.framing.records):
            if record.channels and record.bytes % one:
                yield f"framing.records[{index}].bytes: {record.bytes} is no whole number of {counts.type}"
            in_records += record.bytes if record.channels else 0
        if in_records != counts.n_bytes(self.channels):
            yield (
                f"framing.records: those with channels = true have {in_records} bytes, but {self.channels} "
                f"channels of {counts.type} need {counts.n_bytes(self.channels)}"
            )

    def _table_faults(self) -> Iterator[str]:
        bits = {(m.name, f.name): 8 * f.n_bytes(1) for m in self.messages for f in m.fields}
        for name, bit in self.flags.items():
            if name not in _FLAGS:
                yield f"flags.{name}: no such flag; known: {', '.join(_FLAGS)}"
            if not 0 <= bit < bits.get(("scan", "flags"), 0):
                yield f"flags.{name}: the scan's flags have no bit {bit}"
        codes = list(self.results.values())
        for name, code in self.results.items():
            if not 0 <= code < 1 << bits.get(("acknowledge", "result"), 0):
                yield f"results.{name}: {code} does not fit the acknowledge's result"
            if codes.count(code) > 1:
                yield f"results.{name}: {code} is used twice"
        if ("acknowledge", "result") in bits and "ok" not in self.results:
            yield "results: 'ok' is missing"
        offsets = self.assumed_hello.channel_offset_s if self.assumed_hello else []
        if len(offsets) not in (0, self.channels):
            yield f"assumed_hello.channel_offset_s: {len(offsets)} numbers for {self.channels} channels"
        for name in ("board_serial", "array_id"):  # a recording of others has such a file, too
            if not str(getattr(self.assumed_hello, name, "")).isprintable():
                yield f"assumed_hello.{name}: has characters that are not printable"

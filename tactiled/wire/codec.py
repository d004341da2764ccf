"""Decoder and encoder of frames according to a `Layout`. Pure: no I/O, no clock."""

import math
from dataclasses import fields
from typing import Any

import numpy as np

from tactiled.errors import ContractError
from tactiled.wire import cobs
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Hello, Scan
from tactiled.wire.framing import crc16, make_framer
from tactiled.wire.layout import Layout, MessageFormat, tagged_packets
from tactiled.wire.schema import IN_UNITS, CobsFraming, Direction, LinesFraming, TaggedFraming


class Decoder:
    """Decode the bytes of one direction; `framing` states the rules."""

    def __init__(self, layout: Layout, direction: Direction = "board-to-host") -> None:
        self.layout = layout
        self._direction = direction
        self._messages = layout.incoming(direction)
        self._commands = {m.id: m.name for m in layout.incoming("host-to-board").values()}
        self._fixed = layout.fixed_commands if direction == "host-to-board" else {}
        self._results = {code: name for name, code in layout.file.results.items()}
        self._scan = layout.messages["scan"].dtype
        self._places = layout.channel_places
        self._type_bytes = 1 if layout.detects_damage else 0
        self.reset()

    def reset(self) -> None:
        """Forget pending bytes and counts."""
        self.framer = make_framer(self.layout, self._direction)
        """Splits the stream into frames, and counts its bytes."""

    def interrupted(self) -> None:
        """Discard pending bytes, and find the next frame as on a newly opened port."""
        before = self.framer
        self.reset()
        self.framer.bytes_in, self.framer.bytes_framed = before.bytes_in, before.bytes_framed
        self.framer.bytes_discarded = before.bytes_discarded + before.bytes_pending

    def feed(self, data: bytes) -> list[Frame | Corrupt]:
        """Return the frames and corruptions that `data` completes, in the order of the stream.

        In the direction to the board, an intact frame of an unknown type becomes a `Command` named by its
        type, ``"0x7f"``, because the board must refuse it with its token.
        """
        return [
            item if isinstance(item, Scan) else self._unknown(item) if isinstance(item, Corrupt)
            else self._frame(item)
            for item in self.framer.feed(data)
        ]  # fmt: skip

    def _unknown(self, item: Corrupt) -> Command | Corrupt:
        n_token = self.layout.leading_token_bytes
        if self._direction == "board-to-host" or not n_token or len(item.body) < 1 + n_token:
            return item
        token = int.from_bytes(item.body[1 : 1 + n_token], self.layout.file.byte_order)
        return Command(f"0x{item.body[0]:02x}", token)

    def _frame(self, body: bytes) -> Frame | Corrupt:
        if self._fixed:
            return Command(self._fixed[body], 0)
        message = self._messages[body[0] if self._type_bytes else 0]
        if message.name == "scan":
            return self._read_scan(body)
        row = np.frombuffer(body, message.dtype, 1, 1)[0]
        names = message.dtype.names or ()
        try:
            fields = {name: _from_wire(row[name], message.per_unit[name], name) for name in names}
        except ValueError:
            return Corrupt("value", len(body))
        if message.name == "hello":
            fields["streaming"] = bool(fields.get("streaming", 0))
            hello = Hello(**{"protocol_version": self.layout.file.protocol_version, **fields})
            return hello if _credible(hello) else Corrupt("value", len(body))
        if message.name == "acknowledge":
            fields["command"] = self._commands.get(fields["command"], f"0x{fields['command']:02x}")
            fields["result"] = self._results.get(fields["result"], f"result {fields['result']}")
            return Acknowledge(**fields)
        return Command(name=message.name, **fields)

    def _read_scan(self, body: bytes) -> Scan:
        row = np.frombuffer(body, self._scan, 1, self._type_bytes)[0]
        counts = row["counts"] if self._places is None else row["counts"][self._places]
        numbers = counts.astype(np.float64 if counts.dtype.kind == "f" else np.int64)
        sequence, ticks, flags = [
            int(row[name]) if name in (self._scan.names or ()) else None
            for name in ("sequence", "ticks", "flags")
        ]
        return Scan(sequence or 0, numbers, ticks, flags or 0)


class Encoder:
    """Encode frames of one layout; has no state."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._command_ids = {m.name: m.id for m in layout.incoming("host-to-board").values()}

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes of one frame, including delimiter or sync word.

        `ContractError` if the layout has no such message, or a value does not fit its field.
        """
        name = frame.name if isinstance(frame, Command) else type(frame).__name__.lower()
        if name not in self.layout.messages:
            raise ContractError(f"layout {self.layout.name} has no message {name}")
        message = self.layout.messages[name]
        if message.fixed:
            return message.fixed
        values = {field.name: getattr(frame, field.name) for field in fields(frame)}
        if isinstance(frame, Acknowledge):
            if frame.result not in self.layout.file.results:
                raise ContractError(f"layout {self.layout.name} has no result {frame.result!r}")
            values["command"] = self._command_id(frame.command)
            values["result"] = self.layout.file.results[frame.result]
        return self._wrap(message, self._body(message, values))

    def _command_id(self, name: str) -> int:
        """Type of a command by its name, or by the number that the decoder uses as name of an unknown one."""
        try:
            return self._command_ids[name] if name in self._command_ids else int(name, 16)
        except ValueError:
            raise ContractError(f"layout {self.layout.name} has no command {name!r}") from None

    def _body(self, message: MessageFormat, values: dict[str, Any]) -> bytes:
        row = np.zeros(1, message.dtype)
        for name in message.dtype.names or ():
            per_unit = 1 if name == "ticks" else message.per_unit[name]
            if name == "counts" and (places := self.layout.channel_places) is not None:
                padded = np.zeros(message.dtype[name].shape)
                padded[places] = values[name]
                values[name] = padded
            try:
                row[name] = _to_wire(values[name], per_unit, message.dtype[name], may_lack=name == "counts")
            except (OverflowError, ValueError, TypeError) as error:
                raise ContractError(f"{message.name}.{name}: {error}") from None
        return row.tobytes()

    def _wrap(self, message: MessageFormat, body: bytes) -> bytes:
        framing = self.layout.file.framing
        if isinstance(framing, CobsFraming):
            typed = bytes([message.id]) + body
            return cobs.encode(typed + crc16(typed).to_bytes(2, self.layout.file.byte_order)) + b"\0"
        if isinstance(framing, TaggedFraming):
            return tagged_packets(framing, body)
        if isinstance(framing, LinesFraming):
            values = np.frombuffer(body, message.dtype["counts"].base).tolist()
            body = framing.separator.join(f"{value:.9g}" for value in values).encode()
        return body + self.layout.terminator


def _from_wire(value: Any, per_unit: int, name: str) -> Any:
    """Value of a field in its unit; ValueError where a text is not printable ASCII."""
    if isinstance(value, bytes):
        text = value.decode("ascii")
        if not text.isprintable():
            raise ValueError(f"{name} is not printable")
        return text
    if isinstance(value, np.ndarray):
        return tuple(float(v) / per_unit for v in value)
    return float(value) / per_unit if name in IN_UNITS else int(value)


def _credible(hello: Hello) -> bool:
    """Return True when the numbers of an intact hello are usable: the bounds are those of `AssumedHello`."""
    positive = (hello.rate_hz, hello.adc_reference_v)
    return (
        1 <= hello.adc_bits <= 32
        and all(math.isfinite(value) and value > 0 for value in positive)
        and all(math.isfinite(value) for value in hello.channel_offset_s)
    )


def _to_wire(value: Any, per_unit: int, dtype: np.dtype[Any], *, may_lack: bool) -> Any:
    """Wire value of a field; ValueError where it does not fit, or is NaN where no value may lack."""
    base = dtype.base
    if base.kind == "S":
        text = str(value)
        if not (text.isascii() and text.isprintable()):
            raise ValueError(f"{value!r} is not printable ASCII")
        if len(text) > base.itemsize:
            raise ValueError(f"{value!r} is longer than {base.itemsize} bytes")
        return text.encode("ascii")
    scaled = np.asarray(value, dtype=np.float64) * per_unit
    if scaled.shape != dtype.shape:
        raise ValueError(f"has shape {scaled.shape}, not {dtype.shape}")
    limits = np.finfo(base) if base.kind == "f" else np.iinfo(base)
    wire = scaled if base.kind == "f" else np.rint(scaled)
    fits = (wire >= float(limits.min)) & (wire <= float(limits.max))  # NaN does not fit either
    if not np.all(fits | np.isnan(wire) if may_lack and base.kind == "f" else fits):
        raise ValueError(f"{value!r} does not fit {limits.min}..{limits.max}")
    return wire

"""Layouts, frames and streams for the laws of the wire."""

import itertools
import math
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tactiled import tomlfile
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.framer import LineFramer, TerminatorFramer
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Hello, Scan
from tactiled.wire.layout import Layout, MessageFormat, compile_layout, load_layout
from tactiled.wire.schema import IN_UNITS, Direction, LayoutFile

DIRECTIONS: list[Direction] = ["board-to-host", "host-to-board"]
COMMANDS = ("start", "stop", "set_rate", "ping", "identify")
INTEGERS = ["u8", "u16", "u32", "i8", "i16", "i32"]
UNSIGNED = INTEGERS[:3]
BOARD_V1 = load_layout("board-v1")
LEGACY_9 = load_layout("legacy-9")


def decode(
    layout: Layout, data: bytes, cuts: list[int] | None = None, direction: Direction = "board-to-host"
) -> tuple[list[Frame | Corrupt], Decoder]:
    """Return the output of a decoder for `data` in parts; the byte accounting is checked at every step."""
    decoder = Decoder(layout, direction)
    items: list[Frame | Corrupt] = []
    edges = [0, *sorted(cuts or []), len(data)]
    for start, end in itertools.pairwise(edges):
        items += decoder.feed(data[start:end])
        counted = decoder.framer.bytes_framed + decoder.framer.bytes_discarded + decoder.framer.bytes_pending
        assert decoder.framer.bytes_in == end == counted
        assert decoder.framer.bytes_pending <= longest_pending(layout, direction)
    return items, decoder


def longest_pending(layout: Layout, direction: Direction) -> int:
    """Bytes that a decoder may hold back: two frames or packets, or one frame behind its sync word."""
    framing = layout.file.framing
    if framing.kind == "tagged":
        return 2 * (framing.most_bytes + 4)
    if framing.kind == "terminator":
        return (TerminatorFramer.MOST + 1) * layout.wire_bytes("scan")
    if framing.kind == "lines":
        return LineFramer.LONGEST_NUMBER * layout.n_channels + len(layout.terminator)
    guarded = max((3 + m.dtype.itemsize for m in layout.incoming(direction).values()), default=2)
    return max(2 * (guarded + 1 + (guarded - 1) // 254), 32)


@st.composite
def layouts(draw: st.DrawFn) -> Layout:
    """Draw any valid layout of COBS frames."""
    more = draw(st.sets(st.sampled_from(["hello", *COMMANDS])))
    names = ["scan", *sorted(more)] + (["acknowledge"] if more & set(COMMANDS) else [])
    ids = draw(st.lists(st.integers(0, 255), min_size=len(names), max_size=len(names), unique=True))
    tick = {"type": draw(st.sampled_from(UNSIGNED)), "per_unit": draw(st.sampled_from([1, 1000, 10**6]))}
    document: dict[str, Any] = {
        "name": "random",
        "protocol_version": 1,
        "channels": draw(
            st.one_of(st.integers(1, 40), st.integers(120, 140))
        ),  # the latter beyond one COBS run
        "byte_order": draw(st.sampled_from(["little", "big"])),
        "baud": 115200,
        "framing": {"kind": "cobs"},
        "messages": [
            {
                "name": name,
                "id": id_,
                "fields": draw(_fields(name, tick)),
            }
            for name, id_ in zip(names, ids, strict=True)
        ],
    }
    if "acknowledge" in names:
        document["results"] = {"ok": 0, "busy": 255}
    if "hello" not in names:
        document["assumed_hello"] = {
            "board_serial": "s", "array_id": "a", "rate_hz": 100.0, "adc_bits": 12, "adc_reference_v": 3.0,
        }  # fmt: skip
    return compile_layout(tomlfile.parse(document, LayoutFile, "random"))


@st.composite
def _fields(draw: st.DrawFn, message: str, tick: dict[str, Any]) -> list[dict[str, Any]]:
    must = {
        "scan": ["sequence", "counts"],
        "hello": ["board_serial", "array_id", "rate_hz", "adc_bits", "adc_reference_v"],
        "acknowledge": ["token", "command", "result"],
        "set_rate": ["token", "rate_hz"],
    }.get(message, ["token"])
    may = {
        "scan": ["ticks", "flags"],
        "hello": [
            "protocol_version",
            "firmware_version",
            "boot_count",
            "streaming",
            "ticks",
            "channel_offset_s",
        ],
        "acknowledge": ["ticks"],
    }.get(message, [])
    names = must + draw(st.lists(st.sampled_from(may), unique=True) if may else st.just([]))
    fields = []
    for name in draw(st.permutations(names)):
        field: dict[str, Any] = {"name": name}
        if name == "ticks":
            field |= tick
        elif name in ("board_serial", "array_id", "firmware_version"):
            field |= {"type": "text", "size": draw(st.integers(1, 64))}
        elif name in IN_UNITS:
            field |= {
                "type": draw(st.sampled_from([*INTEGERS, "f32"])),
                "per_unit": draw(st.sampled_from([1, 10, 1000])),
            }
        else:
            field["type"] = draw(st.sampled_from(INTEGERS if name == "counts" else UNSIGNED))
        fields.append(field)
    return fields


@st.composite
def frames(draw: st.DrawFn, layout: Layout, direction: Direction = "board-to-host") -> Frame:
    """A frame of one of the layout's messages, each field over all that its type can hold."""
    message = draw(st.sampled_from(list(layout.incoming(direction).values())))
    values = {name: draw(_values(layout, message, name)) for name in message.dtype.names or ()}
    if message.name == "scan":
        return Scan(
            sequence=values["sequence"],
            counts=np.array(values["counts"], dtype=np.int64),
            ticks=values.get("ticks"),
            flags=values.get("flags", 0),
        )
    if message.name == "hello":
        return Hello(**values)
    if message.name == "acknowledge":
        return Acknowledge(**values)
    return Command(message.name, **values)


def _values(layout: Layout, message: MessageFormat, name: str) -> st.SearchStrategy[Any]:
    dtype = message.dtype[name].base
    per_unit = message.per_unit[name]
    one: st.SearchStrategy[Any]
    if dtype.kind == "S":
        return st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=dtype.itemsize)
    if name == "streaming":
        return st.booleans()
    if name == "command":
        return st.sampled_from([m.name for m in layout.incoming("host-to-board").values()])
    if name == "result":
        return st.sampled_from(sorted(layout.file.results))
    lowest = 1 if name in ("rate_hz", "adc_reference_v") else None
    if dtype.kind == "f":
        one = st.floats(min_value=lowest, max_value=2.0**30, width=32, allow_nan=False)
        one = one.filter(math.isfinite)
    else:
        limits = np.iinfo(dtype)
        top = 32 if name == "adc_bits" else int(limits.max)
        low = 1 if name == "adc_bits" else int(limits.min)
        one = st.one_of(st.sampled_from([lowest or low, top]), st.integers(lowest or low, top))
    if name in IN_UNITS:
        one = one.map(lambda wire: wire / per_unit)
    shape = message.dtype[name].shape
    return st.lists(one, min_size=shape[0], max_size=shape[0]).map(tuple) if shape else one


@st.composite
def streams(draw: st.DrawFn, layout: Layout, direction: Direction = "board-to-host") -> bytes:
    """Bytes as a bad line delivers them: frames, parts of frames, idle, noise."""
    encoder = Encoder(layout)
    whole = frames(layout, direction).map(encoder.encode)
    part = st.tuples(whole, st.integers(0, 200), st.integers(0, 200)).map(lambda t: t[0][t[1] : t[1] + t[2]])
    idle = st.sampled_from([b"\0", b"\0" * 5, b"\x01", b"\xff", b"\x02"])
    return b"".join(draw(st.lists(st.one_of(whole, part, idle, st.binary(max_size=60)), max_size=12)))

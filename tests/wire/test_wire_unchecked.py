"""Frames without checksum and sequence: fixed length with a terminator, and lines of numbers."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_strategies import decode

from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Corrupt, Frame, Scan
from tactiled.wire.layout import load_layout

MAGNETS = load_layout("magnetometers-5")
LINES = load_layout("lines-15")
CRLF = b"\r\n"


def scans_of(items: list[Frame | Corrupt]) -> list[list[float]]:
    return [list(item.counts) for item in items if isinstance(item, Scan)]


def as_sent(rows: list[list[float]]) -> bytes:
    """Bytes of a board that C code would send: temperature 25.0 and the field of each chip, CR LF."""
    out = b""
    for row in rows:
        for chip in range(5):
            out += struct.pack("<4f", 25.0, *row[3 * chip : 3 * chip + 3])
        out += CRLF
    return out


def rows_of(n: int, seed: int) -> list[list[float]]:
    rng = np.random.default_rng(seed)
    return [list(row) for row in rng.normal(0, 300, (n, 15)).astype(np.float32).astype(np.float64)]


def test_the_channels_are_read_without_the_temperatures() -> None:
    rows = rows_of(6, 0)
    items, decoder = decode(MAGNETS, as_sent(rows))
    assert scans_of(items) == rows[1:]  # where the first one begins is not known
    assert (decoder.framer.bytes_framed, decoder.framer.bytes_discarded, decoder.framer.bytes_pending) == (
        5 * 82,
        82,
        0,
    )
    again = b"".join(Encoder(MAGNETS).encode(Scan(0, np.array(row))) for row in rows)
    assert scans_of(decode(MAGNETS, again)[0]) == rows[1:]


@st.composite
def streams(draw: st.DrawFn) -> bytes:
    """Frames, parts of frames, terminators and noise, with readings that hold CR LF."""
    trap = struct.unpack("<f", b"\x00\r\n\x42")[0]
    reading = st.one_of(st.just(trap), st.floats(-5000, 5000, width=32))
    row = st.lists(reading, min_size=15, max_size=15)
    whole = st.lists(row, min_size=1, max_size=6).map(as_sent)
    part = st.tuples(whole, st.integers(0, 300), st.integers(0, 300)).map(lambda t: t[0][t[1] : t[1] + t[2]])
    noise = st.one_of(st.binary(max_size=60), st.just(CRLF), st.just(b"\r"))
    return b"".join(draw(st.lists(st.one_of(whole, part, noise), max_size=8)))


@given(stream=streams(), data=st.data())
@settings(deadline=None, max_examples=60)
def test_any_split_of_terminated_frames_gives_the_same(stream: bytes, data: st.DataObject) -> None:
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8))
    whole, _ = decode(MAGNETS, stream)
    assert decode(MAGNETS, stream, cuts)[0] == whole
    assert decode(MAGNETS, stream, list(range(len(stream))))[0] == whole


@pytest.mark.parametrize("place", [0, 7, 14])
@pytest.mark.parametrize("start", [0, 1, 30, 79, 81])
def test_a_reading_that_holds_the_terminator_does_not_mislead(place: int, start: int) -> None:
    rows = rows_of(40, 1)
    trap = struct.unpack("<f", b"\x00\r\n\x42")[0]
    for row in rows[:25]:  # it looks like a terminator in 25 frames in a row
        row[place] = trap
    got = scans_of(decode(MAGNETS, as_sent(rows)[start:])[0])
    assert got == (rows[1:] if start <= 80 else rows[2:])  # a frame begins behind a terminator


def test_a_constant_rival_is_never_taken_for_the_terminator() -> None:
    rows = rows_of(300, 2)
    trap = struct.unpack("<f", b"\x00\r\n\x42")[0]
    for row in rows:
        row[4] = trap
    assert scans_of(decode(MAGNETS, as_sent(rows))[0]) == []


@given(st.integers(0, 81), st.integers(1, 81), st.booleans())
@settings(deadline=None)
def test_lost_or_added_bytes_cost_one_frame(at: int, n: int, is_lost: bool) -> None:
    rows = rows_of(12, 3)
    parts = [as_sent([row]) for row in rows]
    sound = parts[5]
    parts[5] = sound[:at] + sound[at + n :] if is_lost else sound[:at] + b"\x01" * n + sound[at:]
    got = scans_of(decode(MAGNETS, b"".join(parts))[0])
    left_over = [row for row in rows[1:5] + rows[6:] if row not in got]
    # A frame whose terminator lies in the damage takes its neighbour along, which then has no beginning.
    assert len(left_over) <= 1
    assert all(row in rows for row in got)


@pytest.mark.parametrize("damaged", [b"3o2.0", b"30_2.0"])
def test_lines_give_numbers_and_refuse_what_is_none(damaged: bytes) -> None:
    rows = [[float(i + 100 * k) for i in range(15)] for k in range(6)]
    texts = [",".join(f"{value:.1f}" for value in row).encode() + CRLF for row in rows]
    texts[3] = texts[3].replace(b"302.0", damaged)
    texts.insert(5, b"hello\n")
    items, decoder = decode(LINES, b"".join(texts))
    assert scans_of(items) == [rows[1], rows[2], rows[4], rows[5]]
    assert [item.reason for item in items if isinstance(item, Corrupt)] == ["terminator", "value", "value"]
    assert decoder.framer.bytes_pending == 0


def test_a_line_may_end_with_a_separator() -> None:
    row = [float(k) for k in range(15)]
    line = ",".join(map(str, row)).encode()
    items, _ = decode(LINES, CRLF + line + b"," + CRLF + line + CRLF + line + b",," + CRLF)
    assert scans_of(items) == [row, row]


@given(data=st.data())
@settings(deadline=None)
def test_any_split_of_lines_gives_the_same(data: st.DataObject) -> None:
    line = st.lists(st.floats(-5000, 5000), min_size=14, max_size=16).map(
        lambda row: ",".join(f"{value:.3f}" for value in row).encode() + b"\n"
    )
    stream = b"".join(data.draw(st.lists(st.one_of(line, st.binary(max_size=600)), max_size=6)))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8))
    whole, _ = decode(LINES, stream)
    assert decode(LINES, stream, cuts)[0] == whole
    assert decode(LINES, stream, list(range(len(stream))))[0] == whole


def test_an_encoded_line_is_read_again() -> None:
    row = [round(0.25 * k, 2) for k in range(15)]
    text = Encoder(LINES).encode(Scan(0, np.array(row)))
    assert text == b"0,0.25,0.5,0.75,1,1.25,1.5,1.75,2,2.25,2.5,2.75,3,3.25,3.5\n"
    assert scans_of(decode(LINES, text * 2)[0]) == [row]

"""Packets of tagged records: vectors by hand from the maker's table, and the laws of framing."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_strategies import decode

from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Command, Corrupt, Frame, Scan
from tactiled.wire.layout import Layout, load_layout

STATIC, DYNAMIC = load_layout("tsf-85"), load_layout("tsf-85-dynamic")

# Written by hand from the table of the records: start, checksum, command, length, then tags with values.
IMU = bytes.fromhex(
    "9a 00 58 1c"  # length 28
    "20 fffe"  # dynamic channel of finger 0: -2
    "24 0007"  # of finger 1: 7
    "30 0001 0002 0003"  # accelerometer of finger 0
    "60 00fa"  # temperature
    "70 0000 0000 0001 e240"  # clock
    "64 00fb"
)
FINGER_0 = bytes.fromhex("9a 00 58 3c 10" + "".join(f"{i:04x}" for i in range(1000, 1028)) + "20 8000")
FINGER_1 = bytes.fromhex("9a 00 58 39 14" + "".join(f"{i:04x}" for i in range(2000, 2028)))


def scans_of(items: list[Frame | Corrupt]) -> list[list[int]]:
    return [item.counts.tolist() for item in items if isinstance(item, Scan)]


def packet(records: bytes) -> bytes:
    return struct.pack(">BBBB", 0x9A, 0, 0x58, len(records)) + records


def pair(value: int) -> bytes:
    """Static taxels of both fingers, in a packet each, as C code would send them."""
    one, other = (struct.pack(">B28H", tag, *[value + tag] * 28) for tag in (0x10, 0x14))
    return packet(one) + packet(other)


def test_the_vectors_give_static_and_dynamic_readings() -> None:
    assert (len(IMU), len(FINGER_0), len(FINGER_1)) == (32, 64, 61)
    stream = IMU + FINGER_0 + FINGER_1 + IMU + IMU
    items, decoder = decode(STATIC, stream)
    assert scans_of(items) == [[*range(1000, 1028), *range(2000, 2028)]]
    assert (decoder.framer.bytes_framed, decoder.framer.bytes_discarded, decoder.framer.bytes_pending) == (
        len(stream),
        0,
        0,
    )
    dynamic = scans_of(decode(DYNAMIC, stream)[0])
    assert dynamic == [[-2, 7], [-2, 7], [-2, 7]]  # finger 0 of FINGER_0 has no partner before the next one


def test_low_bits_of_a_tag_do_not_matter_and_checksum_and_command_are_not_read() -> None:
    other = bytearray(FINGER_0)
    other[1:3], other[4] = b"\xab\x61", 0x13
    assert scans_of(decode(STATIC, IMU + bytes(other) + FINGER_1)[0]) == [
        [*range(1000, 1028), *range(2000, 2028)]
    ]


def test_a_damaged_packet_costs_itself_only() -> None:
    packets = [half for k in range(12) for half in (pair(k)[:61], pair(k)[61:])]
    sound = scans_of(decode(STATIC, b"".join(packets) + IMU)[0])
    assert len(sound) == 12
    for broken in range(2, 22):
        for at, value in ((0, 0), (3, 250), (3, 56), (3, 0), (4, 0xF0)):
            damaged = bytearray(packets[broken])
            damaged[at] = value
            stream = b"".join([*packets[:broken], bytes(damaged), *packets[broken + 1 :], IMU])
            items, _ = decode(STATIC, stream)
            assert scans_of(items) == [scan for k, scan in enumerate(sound) if k != broken // 2]
            assert [item.n_bytes for item in items if isinstance(item, Corrupt)] == [61]


@pytest.mark.parametrize("lost", range(1, 61, 7))
def test_lost_bytes_cost_one_packet(lost: int) -> None:
    stream = b"".join(pair(k) for k in range(8))
    at = 3 * 122 + 10
    items, _ = decode(STATIC, stream[:at] + stream[at + lost :] + IMU)
    values = [scan[0] - 0x10 for scan in scans_of(items)]
    assert values == [0, 1, 2, 4, 5, 6, 7]


def test_a_finger_whose_partner_is_lost_is_not_paired_with_a_later_one() -> None:
    whole = [pair(k) for k in range(5)]
    stream = whole[0] + whole[1][:61] + whole[2] + whole[3][61:] + whole[4] + IMU
    scans = scans_of(decode(STATIC, stream)[0])
    assert [scan[0] - 0x10 for scan in scans] == [0, 2, 4]
    assert all(scan[0] - 0x10 == scan[28] - 0x14 for scan in scans)


def test_a_scan_into_which_damage_falls_is_dropped() -> None:
    whole = [pair(k) for k in range(4)]
    stream = whole[0] + whole[1][:61] + b"\x00" + whole[1][61:] + whole[2] + whole[3] + IMU
    assert [scan[0] - 0x10 for scan in scans_of(decode(STATIC, stream)[0])] == [0, 2, 3]


@pytest.mark.parametrize("is_locked", [False, True])
def test_readings_that_look_like_a_packet_are_not_taken_for_one(is_locked: bool) -> None:
    words = bytes.fromhex("9a00 5806 2011 1124 2222")  # a packet with the dynamic channels 0x1111 and 0x2222
    holds_one = bytearray(packet(b"\x10" + bytes(20) + words + bytes(26)))
    holds_one[0] = 0  # its own beginning is damaged
    before = IMU * 3 if is_locked else b""
    items, decoder = decode(DYNAMIC, before + bytes(holds_one) + IMU * 3)
    assert scans_of(items) == [[-2, 7]] * (6 if is_locked else 3)
    assert decoder.framer.bytes_discarded == len(holds_one)


@pytest.mark.parametrize("start", [1, 3, 4, 30, 60])
def test_a_stream_that_begins_in_a_packet_locks_to_the_next(start: int) -> None:
    stream = b"".join(pair(0x9A9A) for _ in range(4)) + IMU  # readings that look like the start of a packet
    assert len(scans_of(decode(STATIC, stream[start:])[0])) == 3


@pytest.mark.parametrize(
    "noise",
    [
        b"\x9a" * 3000,
        b"\x9a\x00\x58\xff" * 800,
        (b"\x9a\x00\x58\xff" + b"\x20\x00\x00" * 85) * 12,  # longer than a packet may be
        bytes(3000),
        b"\x9a\x00\x58\x3c\x10\x10" * 500,
    ],
)
def test_endless_lengths_and_starts_neither_fill_memory_nor_hide_what_follows(noise: bytes) -> None:
    items, decoder = decode(STATIC, noise + pair(5) * 3 + IMU)
    assert len(scans_of(items)) in (2, 3)  # the last bytes of the noise may swallow one packet
    assert decoder.framer.bytes_discarded >= len(noise)


@st.composite
def streams(draw: st.DrawFn) -> bytes:
    """Packets of all kinds, parts of them, and noise with starts of packets."""
    reading = st.sampled_from([0, 0x9A00, 0x009A, 0x1014, 0x2024, 65535])
    static = st.tuples(st.sampled_from([0x10, 0x14, 0x17]), st.lists(reading, min_size=28, max_size=28)).map(
        lambda t: packet(struct.pack(">B28H", t[0], *t[1]))
    )
    small = st.lists(st.sampled_from([b"\x20\x9a\x00", b"\x24\x00\x9a", b"\x60\x58\x03"]), max_size=6).map(
        lambda parts: packet(b"".join(parts))
    )
    whole = st.one_of(static, small, st.just(IMU))
    part = st.tuples(whole, st.integers(0, 64), st.integers(0, 64)).map(lambda t: t[0][t[1] : t[1] + t[2]])
    noise = st.one_of(st.binary(max_size=80), st.just(b"\x9a\x00\x58"), st.just(b"\x9a"))
    return b"".join(draw(st.lists(st.one_of(whole, whole, part, noise), max_size=14)))


@pytest.mark.parametrize("layout", [STATIC, DYNAMIC], ids=["static", "dynamic"])
@given(stream=streams(), data=st.data())
@settings(deadline=None)
def test_any_split_of_packets_gives_the_same(layout: Layout, stream: bytes, data: st.DataObject) -> None:
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8))
    whole, _ = decode(layout, stream)
    assert decode(layout, stream, cuts)[0] == whole
    assert decode(layout, stream, list(range(len(stream))))[0] == whole


@given(st.lists(st.integers(0, 65535), min_size=56, max_size=56), st.integers(0, 255))
@settings(deadline=None)
def test_what_is_encoded_is_decoded(counts: list[int], cut: int) -> None:
    sent = Encoder(STATIC).encode(Scan(0, np.array(counts)))
    assert scans_of(decode(STATIC, sent * 2, [min(cut, len(sent))])[0]) == [counts, counts]


def test_the_host_starts_and_stops_the_board_with_fixed_bytes() -> None:
    encoder = Encoder(DYNAMIC)
    assert encoder.encode(Command("start", 7)) == bytes.fromhex("9a 00 58 01 01")
    assert encoder.encode(Command("stop", 8)) == bytes.fromhex("9a 00 58 01 00")
    board = Decoder(DYNAMIC, "host-to-board")
    stream = (
        b"\x9a"
        + encoder.encode(Command("start", 1))
        + b"\x00\x9a\x00\x58"
        + encoder.encode(Command("stop", 2))
    )
    items = [item for byte in stream for item in board.feed(bytes([byte]))]
    assert items == [Command("start", 0), Command("stop", 0)]
    framer = board.framer
    assert (framer.bytes_framed, framer.bytes_discarded, framer.bytes_pending) == (10, len(stream) - 10, 0)

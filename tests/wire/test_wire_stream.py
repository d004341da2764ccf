"""Rules of `framing`, on both shipped layouts and on random ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_strategies import BOARD_V1, DIRECTIONS, LEGACY_9, decode, frames, layouts, streams

from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Scan
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction

SHIPPED = [
    pytest.param(BOARD_V1, "board-to-host", id="board-v1"),
    pytest.param(BOARD_V1, "host-to-board", id="board-v1-commands"),
    pytest.param(LEGACY_9, "board-to-host", id="legacy-9"),
]


def scans(layout: Layout, n: int, seed: int = 0) -> list[Scan]:
    """Scans that all differ, with counts over the whole range of 12 bits."""
    rng = np.random.default_rng(seed)
    return [Scan(i, rng.integers(0, 4096, layout.n_channels), ticks=i * 10, flags=0) for i in range(n)]


def without(items: list[Frame | Corrupt], wanted: list[Frame]) -> list[Frame | Corrupt]:
    """Return `items` without those of `wanted`, which must be among them in order."""
    rest: list[Frame | Corrupt] = []
    waiting = list(wanted)
    for item in items:
        if waiting and item == waiting[0]:
            waiting.pop(0)
        else:
            rest.append(item)
    assert not waiting, f"lost {waiting[0]} and {len(waiting) - 1} more"
    return rest


@pytest.mark.parametrize(("layout", "direction"), SHIPPED)
@given(data=st.data())
@settings(deadline=None)
def test_any_split_gives_the_same(layout: Layout, direction: Direction, data: st.DataObject) -> None:
    stream = data.draw(streams(layout, direction))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=10))
    whole, _ = decode(layout, stream, [], direction)
    assert decode(layout, stream, cuts, direction)[0] == whole
    assert decode(layout, stream, list(range(len(stream))), direction)[0] == whole


@given(data=st.data())
@settings(deadline=None)
def test_every_layout_round_trips_in_any_split(data: st.DataObject) -> None:
    layout = data.draw(layouts())
    ways = [way for way in DIRECTIONS if layout.incoming(way)]
    way = data.draw(st.sampled_from(ways))
    sent = data.draw(st.lists(frames(layout, way), min_size=1, max_size=4))
    stream = b"".join(Encoder(layout).encode(frame) for frame in sent)
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=5))
    items, decoder = decode(layout, stream, cuts, way)
    assert items == sent
    assert decoder.framer.bytes_framed == len(stream)


@given(data=st.data())
@settings(deadline=None)
def test_any_bytes_on_any_layout_either_way(data: st.DataObject) -> None:
    layout = data.draw(layouts())
    stream = data.draw(st.one_of(streams(layout), st.binary(max_size=200).map(lambda b: b"\x02" * 90 + b)))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=5))
    for direction in DIRECTIONS:  # also one in which the layout has no message
        assert decode(layout, stream, cuts, direction)[0] == decode(layout, stream, [], direction)[0]


def damage(draw: st.DrawFn, frame: bytes) -> bytes:
    """One frame as a bad line may leave it."""
    how = draw(st.sampled_from(["flip", "burst", "cut", "delete", "insert", "repeat", "delimiter", "twice"]))
    at = draw(st.integers(0, len(frame) - 1))
    n = draw(st.integers(1, 8))
    if how == "flip":
        return frame[:at] + bytes([frame[at] ^ (1 << (n - 1))]) + frame[at + 1 :]
    if how == "burst":
        return frame[:at] + draw(st.binary(min_size=n, max_size=n)) + frame[at + n :]
    if how == "cut":
        return frame[:at]
    if how == "delete":
        return frame[:at] + frame[at + n :]
    if how == "insert":
        return frame[:at] + draw(st.binary(min_size=1, max_size=60)) + frame[at:]
    if how == "repeat":
        return frame[: at + n] + frame[at:]
    if how == "delimiter":
        return frame[:-1] + bytes([draw(st.integers(0, 255))])
    return frame + frame


@st.composite
def damaged(draw: st.DrawFn, layout: Layout) -> tuple[list[Frame], bytes]:
    """Good frames, and a stream with one more that was damaged among them."""
    sent: list[Frame] = list(scans(layout, draw(st.integers(2, 6)), draw(st.integers(0, 1000))))
    victim = draw(st.integers(0, len(sent) - 1))
    parts = [Encoder(layout).encode(frame) for frame in sent]
    parts[victim] = damage(draw, parts[victim])
    # What follows in life: the line goes on, so that everything pending is decided.
    return sent[:victim] + sent[victim + 1 :], b"".join(parts) + b"\0" * 700


@pytest.mark.parametrize("layout", [BOARD_V1, LEGACY_9], ids=["board-v1", "legacy-9"])
@given(data=st.data())
@settings(deadline=None, max_examples=100)
def test_a_damaged_frame_costs_itself_only(layout: Layout, data: st.DataObject) -> None:
    others, stream = data.draw(damaged(layout))
    without(decode(layout, stream)[0], others)


@given(data=st.data())
@settings(deadline=None, derandomize=True)  # a false frame hides a true one once in some thousand runs
def test_a_damaged_frame_costs_itself_only_on_any_layout(data: st.DataObject) -> None:
    layout = data.draw(layouts())
    sent = data.draw(st.lists(frames(layout), min_size=2, max_size=5))
    victim = data.draw(st.integers(0, len(sent) - 1))
    parts = [Encoder(layout).encode(frame) for frame in sent]
    parts[victim] = data.draw(st.composite(damage)(parts[victim]))
    stream = b"".join(parts) + b"\0" * 1200
    without(decode(layout, stream)[0], sent[:victim] + sent[victim + 1 :])


@pytest.mark.parametrize("layout", [BOARD_V1, LEGACY_9], ids=["board-v1", "legacy-9"])
def test_a_frame_cut_anywhere_costs_itself_only(layout: Layout) -> None:
    first, second, third = scans(layout, 3)
    encode = Encoder(layout).encode
    for cut in range(len(encode(second))):
        stream = encode(first) + encode(second)[:cut] + encode(third) + b"\0" * 100
        without(decode(layout, stream)[0], [first, third])


@pytest.mark.parametrize("layout", [BOARD_V1, LEGACY_9], ids=["board-v1", "legacy-9"])
def test_damage_does_not_pass_for_a_frame(layout: Layout) -> None:
    """Frames that were never sent, among 4000 damaged: chance lets 1.5e-5 each pass a CRC-16."""
    rng = np.random.default_rng(5)
    sent: list[Frame] = list(scans(layout, 250, 7))
    wrong = 0
    for _ in range(16):
        parts = [bytearray(Encoder(layout).encode(frame)) for frame in sent]
        for part in parts:
            at = rng.integers(0, len(part) - 3)
            part[at : at + 3] = rng.integers(0, 256, 3, dtype=np.uint8).tobytes()
        items, _ = decode(layout, b"".join(bytes(part) for part in parts))
        wrong += sum(not isinstance(item, Corrupt) and item not in sent for item in items)
    assert wrong <= 1


def test_both_frames_around_a_broken_delimiter_are_found() -> None:
    first, second, third = scans(BOARD_V1, 3)
    encode = Encoder(BOARD_V1).encode
    stream = encode(first)[:-1] + b"\x55" + encode(second) + encode(third)
    items, decoder = decode(BOARD_V1, stream)
    assert items == [Corrupt("checksum", 2), first, second, third]
    assert (
        decoder.framer.bytes_discarded == 2
    )  # the broken delimiter, and the next for it closed a corrupt frame


def test_many_frames_without_any_delimiter_are_found() -> None:
    sent: list[Frame] = list(scans(BOARD_V1, 20))
    stream = b"".join(Encoder(BOARD_V1).encode(frame)[:-1] for frame in sent) + b"\0"
    items, _ = decode(BOARD_V1, stream, list(range(0, len(stream), 7)))
    assert all(isinstance(item, Corrupt) for item in without(items, sent))


def test_a_line_without_delimiters_is_reported_while_it_lasts() -> None:
    items, decoder = decode(BOARD_V1, b"\xff" * 10_000)
    assert {item.reason for item in items if isinstance(item, Corrupt)} == {"overlong"}
    assert decoder.framer.bytes_discarded > 9_500


def test_delimiters_alone_are_no_corruption() -> None:
    items, decoder = decode(BOARD_V1, b"\0" * 10)
    assert items == []
    assert decoder.framer.bytes_discarded == 10


def test_reset_equals_new() -> None:
    decoder = Decoder(BOARD_V1)
    data = Encoder(BOARD_V1).encode(scans(BOARD_V1, 1)[0])
    decoder.feed(data + data[:40])
    decoder.reset()
    assert (
        decoder.framer.bytes_in
        == decoder.framer.bytes_pending
        == decoder.framer.bytes_framed
        == decoder.framer.bytes_discarded
        == 0
    )
    assert decoder.feed(data) == scans(BOARD_V1, 1)


def test_an_intact_stranger_is_named_to_each_end() -> None:
    """Type 0x7f with token 5: the board must refuse it by its token, the host must see another protocol."""
    stranger = bytes.fromhex("037f050350c700")
    assert decode(BOARD_V1, stranger, [], "host-to-board")[0] == [Command("0x7f", 5)]
    assert decode(BOARD_V1, stranger)[0] == [Corrupt("type", 7, b"\x7f\x05\x00")]
    refusal = Acknowledge(5, "0x7f", "unknown_command", 0)
    assert decode(BOARD_V1, Encoder(BOARD_V1).encode(refusal))[0] == [refusal]


@pytest.mark.parametrize("layout", [BOARD_V1, LEGACY_9], ids=["board-v1", "legacy-9"])
def test_a_frame_that_lost_its_last_byte_does_not_take_the_next_ones_first(layout: Layout) -> None:
    """With probability 1/256 the missing byte equals the byte that follows."""
    encode = Encoder(layout).encode
    second = scans(layout, 1)[0]
    after = encode(second)
    cut = 2  # the delimiter goes too
    hits = 0
    for first in (scan for seed in range(15) for scan in scans(layout, 200, seed + 1)):
        whole = encode(first)
        if whole[-cut] == after[0]:
            hits += 1
            items, decoder = decode(layout, whole[:-cut] + after)
            assert items[-1] == second
            assert (
                decoder.framer.bytes_in
                == decoder.framer.bytes_framed + decoder.framer.bytes_discarded + decoder.framer.bytes_pending
            )
    assert hits > 2

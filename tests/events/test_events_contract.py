"""Contract with PlotJuggler and all other readers: two frames, a plain map, fixed types."""

import dataclasses
import typing
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import instances, walk

from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event

KINDS = pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}
HEAD = {"v": "int", "timestamp": "float64", "seq": "int", "board": "str", "run": "int"}


@pytest.mark.parametrize(
    "payload",
    [
        msgpack.packb({"a": None}),
        msgpack.packb({"a": b"\x01"}),
        msgpack.packb({"a": msgpack.ExtType(1, b"\x01")}),
        msgpack.packb({"a": 1.0}, use_single_float=True),
        msgpack.packb({"a": -1}),  # one sign for ever: some readers fix a column's type by the first message
        msgpack.packb({1: 1}),
        msgpack.packb({"a": [1, 1.0]}),
        msgpack.packb({"a": 1}) + b"\x01",
        b"\x82\xa1a\x01\xa1a\x01",
    ],
    ids=["nil", "bin", "ext", "float32", "negative", "int-key", "mixed-array", "trailing", "twice"],
)
def test_the_strict_reader_rejects_other_payloads(payload: bytes) -> None:
    with pytest.raises(AssertionError):
        walk(payload)


def shape_of(kind: Any) -> Any:
    """Wire type that a declared type must always have."""
    if kind in (float, int, bool, str):
        return {float: "float64", int: "int", bool: "bool", str: "str"}[kind]
    if typing.get_origin(kind) is typing.Literal:
        return "str"
    if typing.get_origin(kind) is tuple:
        return [shape_of(typing.get_args(kind)[0])]
    return {RENAMED.get(f.name, f.name): shape_of(f.type) for f in dataclasses.fields(kind)}


@KINDS
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_each_field_has_one_fixed_type(kind: type[Event], data: st.DataObject) -> None:
    event = data.draw(instances(kind))
    board = data.draw(st.text(max_size=30))
    frames = codec.encode(event, seq=data.draw(st.integers(0, 2**63)), board=board, unix_offset_s=1.7e9)
    assert len(frames) == 2
    topic, payload = frames
    value, shape = walk(payload)
    wanted = HEAD | shape_of(kind)
    for name, field in wanted.items():
        # An empty array has no inner type to be wrong.
        assert shape[name] == field or (shape[name] == [] and isinstance(field, list)), name
    assert list(shape) == list(wanted)
    assert isinstance(value["timestamp"], float)
    name = topic.decode()
    assert name.startswith("tactile/")
    assert name.endswith(f"/{kind.topic}")
    assert not set(name) & set(" ,;\t\n\0")


@KINDS
@given(data=st.data())
@settings(deadline=None, max_examples=30)
def test_messages_come_back_as_they_were(kind: type[Event], data: st.DataObject) -> None:
    event = data.draw(instances(kind))
    topic, payload = codec.encode(event, seq=7, board="hand", unix_offset_s=0.0)
    message = codec.to_map(event, seq=7, board="hand", unix_offset_s=0.0)
    assert topic.decode() == codec.topic_of("hand", kind.topic)
    assert walk(payload)[0] == message


@given(time_s=st.floats(0, 1e7), offset_s=st.floats(1.6e9, 2e9))
def test_every_instant_becomes_epoch_seconds(time_s: float, offset_s: float) -> None:
    kind = EVENT_TYPES["slip"]
    plain = {f.name: _first(f.type) for f in dataclasses.fields(kind)}
    event = kind(**plain | {"time_s": time_s, "onset_s": time_s - 0.2, "detected_s": time_s + 0.1})
    message = codec.to_map(event, seq=0, board="b", unix_offset_s=offset_s)
    assert message["timestamp"] == time_s + offset_s
    assert message["onset"] == time_s - 0.2 + offset_s
    assert message["detected"] == time_s + 0.1 + offset_s
    assert not set(RENAMED) & set(message)


def _first(kind: Any) -> Any:
    """Some value of a declared type."""
    if typing.get_origin(kind) is typing.Literal:
        return typing.get_args(kind)[0]
    return () if typing.get_origin(kind) is tuple else kind()


def test_no_topic_is_a_prefix_of_another() -> None:
    """ZeroMQ matches prefixes: a subscriber to one topic must not get another."""
    topics = [codec.topic_of("hand", name) for name in EVENT_TYPES]
    assert not [(a, b) for a in topics for b in topics if a != b and b.startswith(a)]


@pytest.mark.parametrize(
    ("board", "topic"),
    [
        ("TB-0001", "tactile/TB-0001/slip"),
        ("left hand, no 2; new", "tactile/left-hand--no-2--new/slip"),
        ("a/b", "tactile/a-b/slip"),
        ("\0\n", "tactile/--/slip"),
        ("", "tactile/-/slip"),
    ],
)
def test_a_board_name_never_breaks_the_topic(board: str, topic: str) -> None:
    assert codec.topic_of(board, "slip") == topic

"""Contract with all readers: two frames, a plain map, fixed types, as protocols/events says of each."""

import copy
import dataclasses
import json
import typing
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from message_strategies import instances, walk

from tactiled import resources
from tactiled.events import codec
from tactiled.events.endpoints import control_endpoint
from tactiled.events.types import EVENT_TYPES, Candidate, Event, ForceEvent, new_event

KINDS = pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}
HEAD = {"v": int, "timestamp": float, "seq": int, "board": str, "run": int}
_WIRE = {"number": "float64", "integer": "int", "boolean": "bool", "string": "str"}


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


def schema_of(topic: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(
        resources.shipped("protocols", "events", f"{topic}.schema.json").read_text()
    )
    return loaded


def typed(kind: Any) -> Any:
    """JSON Schema's words for a declared type."""
    if typing.get_origin(kind) is typing.Literal:
        return ("string", list(typing.get_args(kind)))
    if typing.get_origin(kind) is tuple:
        return ("array", typed(typing.get_args(kind)[0]))
    if dataclasses.is_dataclass(kind):
        return ("object", {f.name: typed(f.type) for f in dataclasses.fields(kind)})
    return ({float: "number", int: "integer", bool: "boolean", str: "string"}[kind], None)


def stated(schema: dict[str, Any]) -> Any:
    """The same words, read from the schema."""
    if schema["type"] == "array":
        return ("array", stated(schema["items"]))
    if schema["type"] == "object":
        return ("object", {name: stated(inner) for name, inner in schema["properties"].items()})
    return (schema["type"], schema.get("enum"))


def fits(shape: Any, schema: dict[str, Any]) -> bool:
    """Return whether the types on the wire are those of the schema, which calls 1 a number, too."""
    if schema["type"] == "array":
        # An empty array has no inner type to be wrong.
        return isinstance(shape, list) and all(fits(each, schema["items"]) for each in shape)
    if schema["type"] == "object":
        fields = schema["properties"]
        return list(shape) == list(fields) and all(fits(shape[name], fields[name]) for name in fields)
    return bool(shape == _WIRE[schema["type"]])


def test_there_is_a_schema_for_each_message_and_no_other() -> None:
    files = resources.shipped("protocols", "events").glob("*.schema.json")
    assert {path.name.removesuffix(".schema.json") for path in files} == set(EVENT_TYPES)


@KINDS
def test_schema_states_each_field_and_its_type(kind: type[Event]) -> None:
    schema = schema_of(kind.topic)
    Draft202012Validator.check_schema(schema)
    declared = HEAD | {RENAMED.get(f.name, f.name): f.type for f in dataclasses.fields(kind)}
    assert {name: stated(inner) for name, inner in schema["properties"].items()} == {
        name: typed(field) for name, field in declared.items()
    }
    assert set(schema["required"]) == set(declared)
    assert schema["additionalProperties"] is False
    assert all(len(inner["description"]) > 10 for inner in schema["properties"].values())


@KINDS
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_every_message_is_what_its_schema_says_in_fixed_types(kind: type[Event], data: st.DataObject) -> None:
    event = data.draw(instances(kind))
    board, seq = data.draw(st.text(max_size=30)), data.draw(st.integers(0, 2**63))
    topic, payload = codec.encode(event, seq=seq, board=board, unix_offset_s=0.0)
    value, shape = walk(payload)
    assert value == codec.to_map(event, seq=seq, board=board, unix_offset_s=0.0)
    assert fits(shape, schema_of(kind.topic))
    Draft202012Validator(schema_of(kind.topic)).validate(value)
    name = topic.decode()
    assert name == codec.topic_of(board, kind.topic)
    assert name.startswith("tactile/")
    assert name.endswith(f"/{kind.topic}")
    assert not set(name) & set(" ,;\t\n\0")


@KINDS
@given(data=st.data())
@settings(deadline=None, max_examples=5)
def test_the_schema_refuses_other_messages(kind: type[Event], data: st.DataObject) -> None:
    validator = Draft202012Validator(schema_of(kind.topic))
    message = codec.to_map(data.draw(instances(kind)), seq=0, board="b", unix_offset_s=1.7e9)
    for name in message:
        lacking = {key: value for key, value in message.items() if key != name}
        assert not validator.is_valid(lacking), f"without {name}"
        assert not validator.is_valid(message | {name: None}), f"{name} nil"
    assert not validator.is_valid(message | {"surplus": 1})
    assert not validator.is_valid(message | {"v": 2})


def test_candidates_are_closed_too() -> None:
    items = schema_of("texture")["properties"]["candidates"]["items"]
    assert items["additionalProperties"] is False
    assert set(items["required"]) == {f.name for f in dataclasses.fields(Candidate)}
    broken = copy.deepcopy(items)
    broken["properties"]["weight"]["type"] = "string"
    assert not Draft202012Validator(broken).is_valid({"period_mm": 1.0, "angle_deg": 0.0, "weight": 0.5})


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


def test_an_event_made_of_all_fields_is_the_one_of_the_constructor() -> None:
    plain = ForceEvent(time_s=1.5, fz_n=3.0, taxel_fz_n=(1.0, 2.0), valid=True)
    fields = {field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)}
    made = new_event(ForceEvent, **fields)
    assert made == plain
    assert hash(made) == hash(plain)


@pytest.mark.parametrize("topic", ["slip", "texture", "contact"])
def test_evidence_of_an_event_is_complete_at_the_instant_of_its_report(topic: str) -> None:
    times = {"time_s": 1.0, "onset_s": 0.5, "detected_s": 2.0, "answered_s": 3.0}
    kind = EVENT_TYPES[topic]
    names = [field.name for field in dataclasses.fields(kind)]
    event: Event = new_event(kind, **dict.fromkeys(names, 0.0) | times)
    assert event.evidence_s == {"slip": 2.0, "texture": 3.0, "contact": 1.0}[topic]


@pytest.mark.parametrize(
    ("endpoint", "control"),
    [
        ("tcp://127.0.0.1:9872", "tcp://127.0.0.1:9873"),
        ("tcp://[::1]:1", "tcp://[::1]:2"),
        ("tcp://host", ""),
        ("tcp://host:*", ""),
        ("tcp://host:٣", ""),
        ("ipc:///run/left/events.ipc", "ipc:///run/left/control.ipc"),
        ("ipc:///run/events/left", "ipc:///run/events/left.control"),
        ("ipc://left", "ipc://left.control"),
        ("ipc://", ""),
        ("inproc://events", ""),
        ("zenoh://host", "zenoh://host"),
    ],
)
def test_requests_have_the_endpoint_beside_that_of_events(endpoint: str, control: str) -> None:
    assert control_endpoint(endpoint) == control

"""protocols/events/*.schema.json say of each message exactly what the codec emits."""

import copy
import dataclasses
import json
import typing
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from message_strategies import instances

from tactiled import resources
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Candidate, Event

KINDS = pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}
HEAD = {"v": int, "timestamp": float, "seq": int, "board": str, "run": int}


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
@settings(deadline=None, max_examples=30)
def test_every_message_fits_its_schema(kind: type[Event], data: st.DataObject) -> None:
    message = codec.to_map(
        data.draw(instances(kind)), seq=data.draw(st.integers(0)), board="b", unix_offset_s=1.7e9
    )
    Draft202012Validator(schema_of(kind.topic)).validate(message)
    assert set(schema_of(kind.topic)["required"]) == set(message)


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

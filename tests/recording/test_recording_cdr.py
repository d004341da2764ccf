"""Our CDR against an independent encoder, byte by byte, and read back."""

import contextlib
import typing
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactiled.errors import DataError
from tactiled.events.types import EVENT_TYPES
from tactiled.recording import contents
from tactiled.recording.cdr import Schema, fields_of
from tactiled.recording.contents import Input, Read

STAMP = {"board": str, "unix_offset_s": float}
KINDS: dict[Schema, dict[str, Any]] = {
    contents.RAW: fields_of(Read),
    contents.INPUT: fields_of(Input),
    **{contents.SCHEMAS[topic]: STAMP | fields_of(kind) for topic, kind in EVENT_TYPES.items()},
}
EACH = pytest.mark.parametrize("schema", KINDS, ids=lambda schema: schema.name.rsplit("/", 1)[-1])


def values(kind: Any) -> st.SearchStrategy[Any]:
    if kind is float:
        return st.floats(allow_nan=False)
    if kind is int:
        return st.integers(-(2**63), 2**63 - 1)
    if kind is str:
        return st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
    if kind is bytes:
        return st.binary(max_size=20)
    if typing.get_origin(kind) is typing.Literal:
        return st.sampled_from(typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        return st.lists(values(typing.get_args(kind)[0]), max_size=5).map(tuple)
    if is_dataclass(kind):
        assert isinstance(kind, type)
        return st.builds(kind, **{name: values(inner) for name, inner in fields_of(kind).items()})
    return st.booleans()


@cache
def store_of(schema: Schema) -> Any:
    """The other encoder, with the types of a schema."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.text, schema.name))
    return store


def as_ros(store: Any, value: Any, kind: Any) -> Any:
    """A value as the other encoder wants it: numpy arrays for numbers, its own classes for types."""
    if kind is bytes:
        return np.frombuffer(value, np.uint8)
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)[0]
        if inner in (bool, int, float):
            return np.array(value, {bool: np.bool_, int: np.int64, float: np.float64}[inner])
        return [as_ros(store, item, inner) for item in value]
    if isinstance(kind, type) and is_dataclass(kind):
        made = store.types[f"tactiled_msgs/msg/{kind.__name__}"]
        return made(**{f.name: getattr(value, f.name) for f in fields(kind)})
    return value


@EACH
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_bytes_are_those_of_an_independent_encoder(schema: Schema, data: st.DataObject) -> None:
    kinds = KINDS[schema]
    message = {name: data.draw(values(kind), label=name) for name, kind in kinds.items()}
    store = store_of(schema)
    theirs = store.types[schema.name](
        **{name: as_ros(store, message[name], kind) for name, kind in kinds.items()}
    )
    ours = schema.encode(message)
    assert ours == bytes(store.serialize_cdr(theirs, schema.name))
    assert schema.decode(ours) == message


@EACH
@given(data=st.data())
def test_the_decoder_accepts_any_bytes(schema: Schema, data: st.DataObject) -> None:
    junk = data.draw(st.binary(max_size=200).map(lambda tail: b"\x00\x01\x00\x00" + tail))
    with contextlib.suppress(DataError):
        assert set(schema.decode(junk)) == set(KINDS[schema])


def test_big_endian_is_refused() -> None:
    with pytest.raises(DataError, match="not little-endian CDR"):
        contents.RAW.decode(b"\x00\x00\x00\x00" + bytes(30))

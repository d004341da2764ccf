"""Type hashes of ROS 2 (REP-2011, version 1): SHA-256 of the description of a type as canonical JSON."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from tactiled.ros2.definitions import PRIMITIVES, RosField, RosType, nested_types

# type_description_interfaces/msg/FieldType. A char of ROS is a uint8 before types are described.
_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "char": 3, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_NESTED, _BOUNDED_STRING = 1, 21
_ARRAY, _BOUNDED, _SEQUENCE = 48, 96, 144  # added for arrays and for sequences with and without a bound


def rihs01(name: str, types: Mapping[str, RosType]) -> str:
    """Return the hash of a type of messages or services, as ``RIHS01_`` and 64 hexadecimal digits."""
    described = {
        "type_description": _described(types[name]),
        "referenced_type_descriptions": [_described(types[inner]) for inner in nested_types(name, types)],
    }
    canonical = json.dumps(described, separators=(", ", ": "))
    return "RIHS01_" + hashlib.sha256(canonical.encode()).hexdigest()


def _described(kind: RosType) -> dict[str, Any]:
    return {"type_name": kind.name, "fields": [_field(field) for field in kind.fields]}


def _field(field: RosField) -> dict[str, Any]:
    shape = _ARRAY if field.size else _BOUNDED if field.most else _SEQUENCE
    shape = 0 if field.size is None else shape
    primitive = field.kind in PRIMITIVES
    own = _BOUNDED_STRING if field.bound else _IDS[field.kind] if primitive else _NESTED
    return {
        "name": field.name,
        "type": {
            "type_id": shape + own,
            "capacity": field.size or field.most,
            "string_capacity": field.bound,
            "nested_type_name": "" if primitive else field.kind,
        },
    }

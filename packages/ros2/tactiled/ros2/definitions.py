"""Types of ROS: parser of their definitions (``.msg`` text), as far as tactiled uses the format, and hashes.

A type hash (REP-2011, version 1) is the SHA-256 of the description of a type as canonical JSON.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# type_description_interfaces/msg/FieldType. A char of ROS is a uint8 before types are described.
_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "char": 3, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_NESTED, _BOUNDED_STRING = 1, 21
_ARRAY, _SEQUENCE = 48, 144  # added for arrays and for sequences without a bound
PRIMITIVES = frozenset(_IDS)
_FIELD = re.compile(
    r"(?P<kind>[A-Za-z0-9_/]+)(<=(?P<bound>\d+))?(?P<array>\[(?P<size>\d*)\])?\s+(?P<name>[a-z][a-z0-9_]*)\s*$"
)

# Types of others, as in ROS 2 Humble to Jazzy (fields only).
STANDARD: dict[str, str] = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Wrench": "Vector3 force\nVector3 torque\n",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\nWrench wrench\n",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values\n"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status\n",
    "sensor_msgs/msg/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    "sensor_msgs/msg/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
    ),
}


@dataclass(frozen=True)
class RosField:
    """Field of a message."""

    name: str
    kind: str  # primitive type, or full name of a message type
    size: int | None = None  # None for one value, 0 for a sequence, otherwise the length of a fixed array
    bound: int = 0  # longest string; 0 where there is no bound


@dataclass(frozen=True)
class RosType:
    """Message type with full name ``package/msg/Name``."""

    name: str
    fields: tuple[RosField, ...]


def parse_type(name: str, text: str) -> RosType:
    """Parse a definition; constants and comments are passed over.

    Raises
    ------
    ValueError
        A line is neither a field nor a constant.
    """
    package = name.split("/", 1)[0]
    fields = []
    for raw in text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if not line or "=" in line.replace("<=", ""):
            continue
        found = _FIELD.match(line)
        if found is None:
            raise ValueError(f"{name}: {raw!r} is no field")
        size = None if found["array"] is None else int(found["size"] or 0)
        kind = _full_name(found["kind"], package)
        fields.append(RosField(found["name"], kind, size, int(found["bound"] or 0)))
    return RosType(name, tuple(fields))


def parse_types(texts: Mapping[str, str]) -> dict[str, RosType]:
    """Parse several definitions by full name."""
    return {name: parse_type(name, text) for name, text in texts.items()}


def discovery_types(gid_bytes: int) -> dict[str, str]:
    """Return the types of ``ros_discovery_info``; a Gid has 24 bytes up to ROS 2 Humble, 16 after it."""
    return {
        "rmw_dds_common/msg/Gid": f"char[{gid_bytes}] data\n",
        "rmw_dds_common/msg/NodeEntitiesInfo": (
            "string<=256 node_namespace\nstring<=256 node_name\nGid[] reader_gid_seq\nGid[] writer_gid_seq\n"
        ),
        "rmw_dds_common/msg/ParticipantEntitiesInfo": (
            "Gid gid\nNodeEntitiesInfo[] node_entities_info_seq\n"
        ),
    }


def nested_types(name: str, types: Mapping[str, RosType]) -> list[str]:
    """Return the full names of all types that a type contains, sorted, without itself."""
    found: set[str] = set()
    new = {name}
    while new:
        kinds = {field.kind for each in new for field in types[each].fields}
        new = kinds - PRIMITIVES - found
        found |= new
    return sorted(found)


def rihs01(name: str, types: Mapping[str, RosType]) -> str:
    """Return the hash of a type of messages, as ``RIHS01_`` and 64 hexadecimal digits."""
    described = {
        "type_description": _described(types[name]),
        "referenced_type_descriptions": [_described(types[inner]) for inner in nested_types(name, types)],
    }
    canonical = json.dumps(described, separators=(", ", ": "))
    return "RIHS01_" + hashlib.sha256(canonical.encode()).hexdigest()


def _described(kind: RosType) -> dict[str, Any]:
    return {"type_name": kind.name, "fields": [_field(field) for field in kind.fields]}


def _field(field: RosField) -> dict[str, Any]:
    shape = 0 if field.size is None else _ARRAY if field.size else _SEQUENCE
    primitive = field.kind in PRIMITIVES
    own = _BOUNDED_STRING if field.bound else _IDS[field.kind] if primitive else _NESTED
    return {
        "name": field.name,
        "type": {
            "type_id": shape + own,
            "capacity": field.size or 0,
            "string_capacity": field.bound,
            "nested_type_name": "" if primitive else field.kind,
        },
    }


def _full_name(kind: str, package: str) -> str:
    if kind in PRIMITIVES:
        return kind
    if kind == "Header":
        return "std_msgs/msg/Header"
    parts = kind.split("/")
    return f"{package}/msg/{kind}" if len(parts) == 1 else f"{parts[0]}/msg/{parts[-1]}"

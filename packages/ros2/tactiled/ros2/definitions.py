"""Parser of ROS interface definitions (``.msg`` text) into types, as far as tactiled uses the format."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

PRIMITIVES = frozenset(
    ("bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
) | {"float32", "float64", "string"}
_FIELD = re.compile(
    r"(?P<kind>[A-Za-z0-9_/]+)(<=(?P<bound>\d+))?(?P<array>\[(<=(?P<most>\d+)|(?P<size>\d*))\])?\s+(?P<name>[a-z][a-z0-9_]*)\s*$"
)


@dataclass(frozen=True)
class RosField:
    """Field of a message."""

    name: str
    kind: str  # primitive type, or full name of a message type
    size: int | None = None  # None for one value, 0 for a sequence, otherwise the length of a fixed array
    bound: int = 0  # longest string; 0 where there is no bound
    most: int = 0  # longest sequence; 0 where there is no bound


@dataclass(frozen=True)
class RosType:
    """Message type with full name ``package/msg/Name`` (or ``package/srv/Name_Request``)."""

    name: str
    fields: tuple[RosField, ...]


def parse_type(name: str, text: str) -> RosType:
    """Parse a definition; constants and comments are passed over.

    Parameters
    ----------
    name : str
        Full name of the type.
    text : str
        Content of the ``.msg`` file.

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
        fields.append(RosField(found["name"], kind, size, int(found["bound"] or 0), int(found["most"] or 0)))
    return RosType(name, tuple(fields))


def parse_types(texts: Mapping[str, str]) -> dict[str, RosType]:
    """Parse several definitions by full name."""
    return {name: parse_type(name, text) for name, text in texts.items()}


def service_types(name: str) -> dict[str, RosType]:
    """Return the types by which ROS describes a service, beside its request and response.

    Parameters
    ----------
    name : str
        Full name of the service, such as ``std_srvs/srv/Trigger``.
    """
    request, response, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    parts = (("request_message", request), ("response_message", response), ("event_message", event))
    fields = (
        RosField("info", "service_msgs/msg/ServiceEventInfo"),
        RosField("request", request, 0, most=1),
        RosField("response", response, 0, most=1),
    )
    return {
        event: RosType(event, fields),
        name: RosType(name, tuple(RosField(field, kind) for field, kind in parts)),
    }


def nested_types(name: str, types: Mapping[str, RosType]) -> list[str]:
    """Return the full names of all types that a type contains, sorted, without itself."""
    found: set[str] = set()

    def walk(inner: str) -> Iterator[str]:
        for field in types[inner].fields:
            if field.kind not in PRIMITIVES and field.kind not in found:
                found.add(field.kind)
                yield field.kind
                yield from walk(field.kind)

    return sorted(walk(name))


def _full_name(kind: str, package: str) -> str:
    if kind in PRIMITIVES:
        return kind
    if kind == "Header":
        return "std_msgs/msg/Header"
    parts = kind.split("/")
    return f"{package}/msg/{kind}" if len(parts) == 1 else f"{parts[0]}/msg/{parts[-1]}"

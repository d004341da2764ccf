"""Text of the ROS types in ``ros2/tactiled_msgs``, made from the JSON Schemas of the events.

Each topic has one type, ``tactiled_msgs/msg/Slip`` for `slip` and so on: a header whose stamp is the
`timestamp` of the message, then its other fields in order, in SI units (REP-103). Other instants are
``builtin_interfaces/Time``. Strings with a fixed set of values come with constants.
"""

import math
import re
import textwrap
from collections.abc import Mapping
from typing import Any

INSTANTS = frozenset(("onset", "detected", "answered"))  # epoch seconds; `timestamp` is the header's stamp
_PRIMITIVES = {"number": "float64", "integer": "int64", "boolean": "bool", "string": "string"}
_WIDTH = 100  # of comments in the text
# Ends of names in units that are not SI: end of the name in ROS, and factor. No end is that of a later one.
_SI = {
    "_nmm": ("_n_m", 1e-3), "_mm_s": ("_m_s", 1e-3), "_mm": ("_m", 1e-3), "_deg": ("_rad", math.pi / 180.0),
    "torsion": ("torsion_m", 1e-3),  # in `unit` times mm
}  # fmt: skip
_SI_WORDS = {"millimetres": "metres", "mm": "metres", "degrees": "radians", "180": "pi"}


def si_field(name: str) -> tuple[str, float | None]:
    """Return the name in ROS of a field, and its factor to SI units; None where its unit stays."""
    for end, (si_end, factor) in _SI.items():
        if name.endswith(end):
            return name.removesuffix(end) + si_end, factor
    return name, None


def ros_texts(schemas: Mapping[str, dict[str, Any]]) -> dict[str, str]:
    """Return the ``.msg`` text of every type by its bare name, nested ones included."""
    texts: dict[str, str] = {}
    for topic, schema in schemas.items():
        stamp = schema["properties"]["timestamp"]["description"]
        head = f"{_comment(schema['description'])}\n{_comment('stamp: ' + stamp)}std_msgs/Header header\n\n"
        texts[topic.capitalize()] = head + _fields(schema, texts)
    return texts


def _fields(schema: dict[str, Any], texts: dict[str, str]) -> str:
    parts = []
    for name, field in schema["properties"].items():
        if name == "timestamp":
            continue
        kind = "builtin_interfaces/Time" if name in INSTANTS else _kind(name, field, texts)
        words = _comment(field.get("description", ""))
        parts.append(f"{words}{_constants(name, field)}{kind} {si_field(name)[0]}\n")
    return "\n".join(parts)


def _kind(name: str, field: dict[str, Any], texts: dict[str, str]) -> str:
    if field["type"] == "array":
        return f"{_kind(name.removesuffix('s'), field['items'], texts)}[]"
    if field["type"] == "object":
        texts[name.capitalize()] = _comment(field.get("description", "")) + _fields(field, texts)
        return f"tactiled_msgs/{name.capitalize()}"
    return _PRIMITIVES[field["type"]]


def _constants(name: str, field: dict[str, Any]) -> str:
    """Constants for the values that a string may have."""
    values = field.get("enum", ())
    words = {value: value.upper().replace("-", "_") or "NOTHING" for value in values}
    return "".join(f'string {name.upper()}_{word}="{value}"\n' for value, word in words.items())


def _comment(text: str) -> str:
    lines = textwrap.wrap(_in_si(text), _WIDTH - len("# "), break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _in_si(text: str) -> str:
    """Words about a field, with units and names of fields as in ROS; names of options (`a.b`) stay."""
    return re.sub(r"(?<![\w.])\w+\b", lambda word: _SI_WORDS.get(word[0], si_field(word[0])[0]), text)

"""Values of ROS messages, as maps, from the maps of the daemon's messages. No I/O, no clock."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from tactiled.events.types import ForceEvent
from tactiled.ros2.freshness import Level
from tactiled.ros2.own_types import INSTANTS, si_field

_LEVELS: dict[Level, int] = {"ok": 0, "warn": 1, "error": 2, "stale": 3}  # diagnostic_msgs/DiagnosticStatus
_FLOAT32 = 7  # sensor_msgs/PointField
_POINT = ("x", "y", "z", "fx", "fy", "fz")
Values = dict[str, Any]


def ros_time(unix_s: float) -> Values:
    """Return ``builtin_interfaces/Time`` of epoch seconds; instants before the epoch become 0."""
    nanoseconds = max(round(unix_s * 1e9), 0)
    return {"sec": min(nanoseconds // 1_000_000_000, 2**31 - 1), "nanosec": nanoseconds % 1_000_000_000}


def header(unix_s: float, frame_id: str) -> Values:
    """Return ``std_msgs/Header``."""
    return {"stamp": ros_time(unix_s), "frame_id": frame_id}


def own_message(data: Mapping[str, Any], frame_id: str) -> Values:
    """Return the message of our own type: all fields, in SI units, with instants as times."""
    fields = {name: value for name, value in data.items() if name != "timestamp"}
    return {"header": header(data["timestamp"], frame_id)} | _in_si(fields)


def _in_si(data: Mapping[str, Any]) -> Values:
    return dict(_si_item(name, value) for name, value in data.items())


def _si_item(name: str, value: Any) -> tuple[str, Any]:
    si_name, factor = si_field(name)
    if name in INSTANTS:
        value = ros_time(value)
    elif isinstance(value, Mapping):
        value = _in_si(value)
    elif isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        value = [_in_si(each) for each in value]
    elif factor is not None:
        is_list = isinstance(value, list | tuple)
        value = [factor * each for each in value] if is_list else factor * value
    return si_name, value


def wrench(force: Mapping[str, Any], frame_id: str) -> Values | None:
    """Return ``geometry_msgs/WrenchStamped`` of a `force` message; None where it has no calibrated force.

    Force of the object on the skin in newtons, torque about the origin of the array in newton metres.
    """
    if not _is_in_newtons(force):
        return None
    return {
        "header": header(force["timestamp"], frame_id),
        "wrench": {
            "force": {axis: force[f"f{axis}_n"] for axis in "xyz"},
            "torque": {axis: 1e-3 * force[f"t{axis}_nmm"] for axis in "xyz"},
        },
    }


def _is_in_newtons(force: Mapping[str, Any]) -> bool:
    """Return True for forces from a calibration: standard types cannot say that a force is nominal."""
    return bool(force["valid"]) and force["calibration"] not in ForceEvent.UNCALIBRATED


def taxel_cloud(force: Mapping[str, Any], info: Mapping[str, Any], frame_id: str) -> Values | None:
    """Return ``sensor_msgs/PointCloud2`` of the forces of all taxels; None where there are none.

    One point for each taxel: place in metres (z is 0), and force of the object on the taxel in newtons, all
    as float32.
    """
    forces: list[Sequence[float]] = [force[f"taxel_f{axis}_n"] for axis in "xyz"]
    n_taxels = len(info.get("x_mm", ()))
    if not _is_in_newtons(force) or not n_taxels:
        return None
    if any(len(each) != n_taxels for each in forces):
        return None
    size = 4 * len(_POINT)
    places = zip(info["x_mm"], info["y_mm"], strict=True)
    points = (
        struct.pack("<6f", 1e-3 * x_mm, 1e-3 * y_mm, 0.0, *taxel)
        for (x_mm, y_mm), taxel in zip(places, zip(*forces, strict=True), strict=True)
    )
    return {
        "header": header(force["timestamp"], frame_id),
        "height": 1,
        "width": n_taxels,
        "fields": [
            {"name": name, "offset": 4 * number, "datatype": _FLOAT32, "count": 1}
            for number, name in enumerate(_POINT)
        ],
        "is_bigendian": False,
        "point_step": size,
        "row_step": size * n_taxels,
        "data": b"".join(points),
        "is_dense": True,
    }


def contact_from_status(status: Mapping[str, Any], previous: str, *, lost: bool) -> dict[str, Any]:
    """Return a `contact` message as a status implies it.

    After an interruption the state is repeated from the status, without taxels. During one (`lost`) it is
    "unknown" and not valid, so that a late subscriber does not receive the state before it. Its `seq` is -1,
    because the daemon did not send it.
    """
    common = {name: status[name] for name in ("v", "timestamp", "board", "run")} | {"seq": -1}
    state = "unknown" if lost else status["contact"]
    return common | {"state": state, "previous": previous, "taxels": [], "valid": not lost}


def diagnostics(rows: Sequence[tuple[str, str, Level, str, Mapping[str, Any]]], unix_s: float) -> Values:
    """Return ``diagnostic_msgs/DiagnosticArray`` of name, hardware id, level, text and values of entries."""
    entries = [
        {
            "level": _LEVELS[level],
            "name": name,
            "message": text,
            "hardware_id": hardware,
            "values": [{"key": key, "value": _plain(value)} for key, value in values.items()],
        }
        for name, hardware, level, text, values in rows
    ]
    return {"header": header(unix_s, ""), "status": entries}


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)

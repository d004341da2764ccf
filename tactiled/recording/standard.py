"""Standard ROS messages made from events, so that stock panels of other viewers draw something useful.

A recording has them beside tactiled's own: ``/tactile/wrench`` (geometry_msgs/msg/WrenchStamped) from
`force`, and ``/diagnostics`` (diagnostic_msgs/msg/DiagnosticArray) from `status`. Readers of tactiled pass
over them.
"""

import itertools
import struct
from dataclasses import dataclass
from typing import NamedTuple

from tactiled.events.types import Event, ForceEvent, StatusEvent
from tactiled.recording import cdr

_RULER = "=" * 80 + "\n"
_OK, _WARN, _ERROR = 0, 1, 2  # diagnostic_msgs/DiagnosticStatus
_HEADER_TYPES = (
    f"{_RULER}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_RULER}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@dataclass(frozen=True)
class StandardType:
    """Type of ROS with the topic that its messages have in a recording."""

    topic: str
    name: str
    text: str


WRENCH = StandardType(
    "/tactile/wrench",
    "geometry_msgs/msg/WrenchStamped",
    "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
    f"{_RULER}MSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
    f"{_RULER}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{_HEADER_TYPES}",
)
DIAGNOSTICS = StandardType(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
    f"{_RULER}MSG: diagnostic_msgs/DiagnosticStatus\nbyte level\nstring name\n"
    "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    f"{_RULER}MSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n{_HEADER_TYPES}",
)


class StandardMessage(NamedTuple):
    """Message of a standard type, encoded as CDR."""

    type: StandardType
    data: bytes


def standard_message(event: Event, board: str, unix_offset_s: float) -> StandardMessage | None:
    """Return the standard message of an event, or None where there is none.

    Force is that of the object on the skin, in newtons; torque is about the origin of the array, in newton
    metres. Forces without a calibration, and nominal ones, have no message.
    """
    unix_s = event.time_s + unix_offset_s
    seconds = max(int(unix_s), 0)
    nanoseconds = min(max(round(1e9 * (unix_s - seconds)), 0), 999_999_999)
    out = bytearray(struct.pack("<iI", seconds, nanoseconds))
    cdr.write(out, frame_id(board), str)
    if isinstance(event, ForceEvent) and event.calibration not in ForceEvent.UNCALIBRATED:
        moments_nm = (1e-3 * moment for moment in (event.tx_nmm, event.ty_nmm, event.tz_nmm))
        for number in (event.fx_n, event.fy_n, event.fz_n, *moments_nm):
            cdr.write(out, number, float)
        return StandardMessage(WRENCH, cdr.HEAD + bytes(out))
    if isinstance(event, StatusEvent):
        _write_diagnostics(out, event, board)
        return StandardMessage(DIAGNOSTICS, cdr.HEAD + bytes(out))
    return None


def frame_id(board: str) -> str:
    """Return the name of the array frame of a board, as in ``tactile_TS0001``."""
    return "tactile_" + ("".join(c if c.isalnum() else "_" for c in board) or "board")


def _write_diagnostics(out: bytearray, status: StatusEvent, board: str) -> None:
    level = _ERROR if not status.valid else _WARN if status.warning else _OK
    words = status.reason or status.warning or status.state
    values = {
        "state": status.state,
        "age_s": f"{status.age_s:.4f}",
        "rate_hz": f"{status.rate_hz:.3f}",
        "scans": str(status.scans),
        "scans_missing": str(status.scans_missing) if status.loss_known else "unknown",
        "frames_corrupt": str(status.frames_corrupt),
        "clock_sd_s": f"{status.clock_sd_s:.6g}",
        "loop_lag_s": f"{status.loop_lag_s:.4f}",
        "contact": status.contact,
        "slipping": str(status.slipping).lower(),
    }
    cdr.write_length(out, 1)
    out.append(level)
    for text in (f"tactiled {board}".strip(), words, board):
        cdr.write(out, text, str)
    cdr.write_length(out, len(values))
    for text in itertools.chain.from_iterable(values.items()):
        cdr.write(out, text, str)

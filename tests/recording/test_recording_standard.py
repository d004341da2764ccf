"""Standard ROS messages in recordings, read by rosbags, which shares no code with tactiled."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from messages import SLIP, STATUS
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tactiled.events.types import Event, ForceEvent
from tactiled.recording.contents import Header, RecordedEvent, load_board
from tactiled.recording.reader import read_items
from tactiled.recording.standard import frame_id, standard_message
from tactiled.recording.writer import RecordingWriter

STORE = get_typestore(Stores.ROS2_HUMBLE)
UNIX_S = 1_700_000_000.0
FORCE = ForceEvent(
    time_s=0.125,
    fx_n=1.0,
    fy_n=-2.0,
    fz_n=3.0,
    tx_nmm=4.0,
    ty_nmm=5.0,
    tz_nmm=-6.0,
    calibration="mine",
    valid=True,
)


def decoded(event: Event, board: str = "TS0001") -> Any:
    message = standard_message(event, board, UNIX_S)
    assert message is not None
    return STORE.deserialize_cdr(message.data, message.type.name)


@pytest.mark.parametrize("board", ["", "TS0001", "left hand", "x" * 64])
def test_a_wrench_has_the_force_in_newtons_and_newton_metres(board: str) -> None:
    found = decoded(FORCE, board)
    force, torque = found.wrench.force, found.wrench.torque
    assert (force.x, force.y, force.z) == (1.0, -2.0, 3.0)
    assert (torque.x, torque.y, torque.z) == pytest.approx((0.004, 0.005, -0.006))
    assert found.header.frame_id == frame_id(board)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (1_700_000_000, 125_000_000)


@pytest.mark.parametrize("board", ["", "TS0001", "x" * 63])
@pytest.mark.parametrize(
    ("status", "level", "words"),
    [
        (STATUS, 0, "running"),
        (replace(STATUS, warning="the adapter is slow"), 1, "the adapter is slow"),
        (replace(STATUS, valid=False, state="no-device", reason="no such port"), 2, "no such port"),
    ],
)
def test_diagnostics_have_the_level_and_the_words_of_the_status(
    status: Event, level: int, words: str, board: str
) -> None:
    found = decoded(status, board)
    (entry,) = found.status
    assert (entry.level, entry.message, entry.hardware_id) == (level, words, board)
    values = {value.key: value.value for value in entry.values}
    assert values["rate_hz"] == "100.000"


def test_other_events_and_forces_without_a_calibration_have_none() -> None:
    assert standard_message(SLIP, "TS0001", UNIX_S) is None
    for calibration in ("none", "nominal"):
        assert standard_message(replace(FORCE, calibration=calibration), "TS0001", UNIX_S) is None


def test_a_recording_opens_in_rosbags_with_its_own_schemas_and_reads_back_as_before(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    with RecordingWriter(path, Header(load_board("board-v1", "wang2019-3x3"))) as writer:
        for event in (STATUS, FORCE, SLIP):
            writer.event(event, "TS0001", UNIX_S, "pipeline")
    with AnyReader([path]) as reader:
        topics = {connection.topic: connection.msgtype for connection in reader.connections}
        assert all(topic.startswith("/") for topic in topics)
        assert topics["/tactile/wrench"] == "geometry_msgs/msg/WrenchStamped"
        assert topics["/diagnostics"] == "diagnostic_msgs/msg/DiagnosticArray"
        found: dict[str, Any] = {
            c.topic: reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()
        }
    assert found["/tactile/wrench"].wrench.force.z == 3.0
    events = [item.event for item in read_items(path) if isinstance(item, RecordedEvent)]
    assert events == [STATUS, FORCE, SLIP]

"""Types on DDS: text, hash, encoding and conversion, with rosbags as the oracle."""

import functools
import json
import math
import re
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import instances
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Candidate, Event, ForceEvent, GripEvent, TextureEvent
from tactiled.ros2 import convert, names, own_types
from tactiled.ros2.cdr import encode
from tactiled.ros2.definitions import (
    PRIMITIVES,
    STANDARD,
    discovery_types,
    nested_types,
    parse_type,
    parse_types,
    rihs01,
)
from tools.interfaces import ROOT, generated

TYPES = parse_types({**STANDARD, **discovery_types(16), **own_types.own_definitions()})
KINDS = pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)
FRAME = "tactile_TS0001"


@functools.cache
def oracle() -> Any:
    made = get_typestore(Stores.ROS2_JAZZY)
    own: dict[str, Any] = {}
    for name, text in own_types.own_definitions().items():
        own.update(get_types_from_msg(text, name))
    made.register(own)
    return made


def plain(value: Any) -> Any:
    """Make maps and lists of a message of rosbags."""
    if hasattr(value, "__msgtype__"):
        return {name: plain(inner) for name, inner in vars(value).items() if name[0].islower()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


def test_the_colcon_package_has_exactly_the_generated_files() -> None:
    files = {
        str(path.relative_to(ROOT)): path.read_text()
        for path in (ROOT / "ros2" / "tactiled_msgs" / "msg").iterdir()
    }
    prefix = "ros2/tactiled_msgs/msg/"
    assert files == {name: text for name, text in generated().items() if name.startswith(prefix)}


@pytest.mark.parametrize("name", sorted(TYPES))
def test_text_and_hash_are_what_rosbags_reads_of_them(name: str) -> None:
    store = oracle()
    inside = [field.kind for each in (name, *nested_types(name, TYPES)) for field in TYPES[each].fields]
    if name in store.fielddefs and "char" not in inside:  # rosbags 0.11 gives char a number of its own
        assert rihs01(name, TYPES) == store.hash_rihs01(name)
    assert all(field.kind in PRIMITIVES or field.kind in TYPES for field in TYPES[name].fields)


@KINDS
@given(data=st.data())
@settings(max_examples=20)
def test_a_message_comes_back_from_an_independent_decoder(kind: type[Event], data: st.DataObject) -> None:
    event = data.draw(instances(kind))
    message = codec.to_map(event, seq=7, board="TS0001", unix_offset_s=0.0)
    name = f"tactiled_msgs/msg/{own_types.type_name(kind.topic)}"
    values = convert.own_message(message, FRAME)
    encoded = encode(name, TYPES, values)
    read = plain(oracle().deserialize_cdr(encoded, name))
    expected = {field.name: values[field.name] for field in TYPES[name].fields}
    assert read == json.loads(json.dumps(expected))


@pytest.mark.parametrize(("store", "gid_bytes"), [(Stores.ROS2_HUMBLE, 24), (Stores.ROS2_JAZZY, 16)])
def test_discovery_is_read_by_either_kind_of_distribution(store: Stores, gid_bytes: int) -> None:
    types = parse_types(discovery_types(gid_bytes))
    gid = {"data": bytes(range(gid_bytes))}
    node = {"node_namespace": "/t", "node_name": "n", "reader_gid_seq": [gid], "writer_gid_seq": [gid, gid]}
    name = "rmw_dds_common/msg/ParticipantEntitiesInfo"
    encoded = encode(name, types, {"gid": gid, "node_entities_info_seq": [node]})
    read = plain(get_typestore(store).deserialize_cdr(encoded, name))
    listed = {"data": list(range(gid_bytes))}
    assert read["gid"] == listed
    assert read["node_entities_info_seq"][0]["writer_gid_seq"] == [listed, listed]


@given(st.floats(0, 2e9))
def test_a_time_is_exact_to_the_nanosecond(unix_s: float) -> None:
    assert convert.ros_time(-3.0) == {"sec": 0, "nanosec": 0}
    time = convert.ros_time(unix_s)
    assert 0 <= time["nanosec"] < 10**9
    assert abs(time["sec"] + 1e-9 * time["nanosec"] - unix_s) <= 1e-9 + 1e-15 * unix_s


def test_own_messages_are_in_si_units() -> None:
    candidate = Candidate(period_mm=1.6, angle_deg=90.0, weight=1.0)
    texture = TextureEvent(
        time_s=1.0, answered_s=1.0, status="ok", speed_mm_s=20.0, angle_sd_deg=180.0, candidates=(candidate,)
    )
    message = codec.to_map(texture, seq=0, board="TS0001", unix_offset_s=0.0)
    values = convert.own_message(message, FRAME)
    assert values["speed_m_s"] == 0.02
    assert values["angle_sd_rad"] == math.pi
    assert values["candidates"][0]["period_m"] == 0.0016
    assert values["candidates"][0]["angle_rad"] == math.pi / 2
    one = convert.own_message(force_map(tx_nmm=250.0), FRAME)
    assert one["tx_n_m"] == 0.25
    grip_message = codec.to_map(GripEvent(time_s=1.0, torsion=3.0), seq=0, board="TS0001", unix_offset_s=0.0)
    assert convert.own_message(grip_message, FRAME)["torsion_m"] == 0.003
    grip = own_types.own_texts()["Grip"]
    assert "in unit times\n# metres." in grip
    left = re.findall(r"^\S+ (\w+(?:mm|_deg|mm_s))$", "".join(own_types.own_texts().values()), re.MULTILINE)
    assert left == []


def force_map(**fields: Any) -> dict[str, Any]:
    event = ForceEvent(time_s=1.0, **fields)
    return codec.to_map(event, seq=0, board="TS0001", unix_offset_s=100.0)


def test_a_wrench_is_in_newtons_and_newton_metres() -> None:
    force = force_map(fx_n=1.0, fy_n=2.0, fz_n=3.0, tx_nmm=10.0, tz_nmm=-5.0, valid=True, calibration="c")
    values = convert.wrench(force, FRAME)
    assert values is not None
    assert values["wrench"] == {
        "force": {"x": 1.0, "y": 2.0, "z": 3.0},
        "torque": {"x": pytest.approx(0.01), "y": 0.0, "z": pytest.approx(-0.005)},
    }
    assert values["header"] == {"stamp": {"sec": 101, "nanosec": 0}, "frame_id": FRAME}


@pytest.mark.parametrize(
    "fields",
    [
        {"valid": False, "calibration": "c"},
        {"valid": True, "calibration": "none"},
        {"valid": True, "calibration": "nominal", "fz_n": 58.9},
    ],
)
def test_a_force_that_cannot_be_trusted_is_no_wrench(fields: dict[str, Any]) -> None:
    assert convert.wrench(force_map(**fields), FRAME) is None
    taxels = {f"taxel_f{axis}_n": (1.0,) for axis in "xyz"}
    assert convert.taxel_cloud(force_map(**fields, **taxels), {"x_mm": [0.0], "y_mm": [0.0]}, FRAME) is None


def test_a_cloud_has_places_and_forces_of_the_taxels() -> None:
    taxels = {"taxel_fx_n": (1.0, 2.0), "taxel_fy_n": (3.0, 4.0), "taxel_fz_n": (5.0, 6.0)}
    force = force_map(**taxels, valid=True, calibration="c")
    values = convert.taxel_cloud(force, {"x_mm": [0.0, 3.5], "y_mm": [1.0, 2.0]}, FRAME)
    assert values is not None
    cloud = oracle().deserialize_cdr(
        encode("sensor_msgs/msg/PointCloud2", TYPES, values), "sensor_msgs/msg/PointCloud2"
    )
    points = cloud.data.view("<f4").reshape(cloud.width, len(cloud.fields))
    assert cloud.point_step * cloud.width == cloud.row_step == cloud.data.size
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "fx", "fy", "fz"]
    assert points.tolist()[1] == pytest.approx([0.0035, 0.002, 0.0, 2.0, 4.0, 6.0])


@given(st.text(max_size=12))
def test_every_board_has_a_valid_name(board: str) -> None:
    name = names.name_of_board(board)
    assert re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name)
    assert "__" not in name
    assert not name.endswith("_")


@pytest.mark.parametrize(
    ("name", "valid"), [("tactile", True), ("a/b_1", True), ("", False), ("1a", False), ("a__b", False)]
)
def test_namespaces(name: str, valid: bool) -> None:
    assert names.is_namespace(name) is valid


@pytest.mark.parametrize("text", ["float64\n", "float64 X\n", "double x\nfloat64[ y\n"])
def test_a_text_that_is_no_definition_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no field"):
        parse_type("a/msg/A", text)

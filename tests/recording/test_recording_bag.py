"""Bags of others are read, or refused with the names that they have; written by rosbags and mcap."""

import contextlib
import sqlite3
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from recordings import record, simulated_reads
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.recording import reader
from tactiled.recording.bag import is_bag, read_bag
from tactiled.recording.table_times import TableOptions
from tactiled.samples.block import ScanBlock
from tactiled.scan_log import read_log

Floats = NDArray[np.float64]

START_NS = 1_700_000_000_000_000_000
PAD = "std_msgs/Header header\nstring name\nfloat32[3] temperature\ndemo_msgs/Taxel[] taxels"
TAXEL = "float64 x\nfloat64 y\nint32 z"
NAMES = [f"t{k}" for k in range(4)]


def readings(n: int = 20, channels: int = 4) -> Floats:
    return np.round(np.random.default_rng(3).normal(size=(n, channels)) * 100) / 64


def stamps_ns(n: int = 20, rate_hz: int = 50) -> NDArray[np.int64]:
    return START_NS + np.arange(n) * (1_000_000_000 // rate_hz)


def write_bag(path: Path, rows: Floats, storage: StoragePlugin, recorded_ns: NDArray[np.int64]) -> Path:
    """A rosbag2 with a multi-array, a joint state whose header is 7 ms early, a pad, and a text."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(PAD, "demo_msgs/msg/Pad"))
    store.register(get_types_from_msg(TAXEL, "demo_msgs/msg/Taxel"))
    kinds = store.types
    layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    with Writer(path, version=9, storage_plugin=storage) as bag:
        topics = {
            "/array": "std_msgs/msg/Int16MultiArray",
            "/joints": "sensor_msgs/msg/JointState",
            "/pad": "demo_msgs/msg/Pad",
            "/text": "std_msgs/msg/String",
        }
        at = {name: bag.add_connection(name, kind, typestore=store) for name, kind in topics.items()}
        for k, (row, ns) in enumerate(zip(rows, stamps_ns(len(rows)).tolist(), strict=True)):
            early = divmod(ns - 7_000_000, 1_000_000_000)
            stamp = kinds["builtin_interfaces/msg/Time"](sec=early[0], nanosec=early[1])
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="finger")
            taxel = kinds["demo_msgs/msg/Taxel"]
            sent = {
                "/array": kinds[topics["/array"]](layout=layout, data=(64 * row).astype(np.int16)),
                "/joints": kinds[topics["/joints"]](
                    header=header, name=NAMES, position=row, velocity=-row, effort=np.zeros(0)
                ),
                "/pad": kinds[topics["/pad"]](
                    header=header,
                    name="pad",
                    temperature=np.full(3, 25.0, dtype=np.float32),
                    taxels=[taxel(x=row[0], y=row[1], z=7), taxel(x=row[2], y=row[3], z=8)],
                ),
                "/text": kinds[topics["/text"]](data="on"),
            }
            for name, message in sent.items():
                bag.write(at[name], int(recorded_ns[k]), store.serialize_cdr(message, topics[name]))
    return path


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_topics_of_a_rosbag2_are_read(tmp_path: Path, storage: StoragePlugin) -> None:
    rows = readings()
    path = write_bag(tmp_path / "bag", rows, storage, stamps_ns())
    time_s, got = read_bag(path, "/array")
    assert np.array_equal(got, 64 * rows)
    assert time_s == pytest.approx(stamps_ns() * 1e-9, abs=1e-6)
    time_s, got = read_bag(path, "joints.velocity")
    assert np.array_equal(got, -rows)
    assert time_s == pytest.approx(stamps_ns() * 1e-9 - 0.007, abs=1e-6)  # the header's
    _, got = read_bag(path, "/pad.taxels")
    assert np.array_equal(got, np.insert(rows, [2, 4], [7.0, 8.0], axis=1))
    (alone,) = path.glob("bag.*")  # without its metadata.yaml
    _, got = read_bag(alone, "/pad.temperature")
    assert np.array_equal(got, np.full((20, 3), 25.0))


def test_what_a_bag_has_is_named(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", readings(), StoragePlugin.MCAP, stamps_ns())
    with pytest.raises(DataError, match=r"--topic TOPIC.*/array with data \(4\); /joints with position"):
        read_bag(path, None)
    with pytest.raises(DataError, match="no topic /tactile; it has /array"):
        read_bag(path, "/tactile")
    with pytest.raises(DataError, match=r"several arrays.*--topic /joints.velocity \(4 numbers\)"):
        read_bag(path, "/joints")
    with pytest.raises(DataError, match="no field force: no force among name, position"):
        read_bag(path, "/joints.force")
    with pytest.raises(DataError, match="/text has no numbers in message 1"):
        read_bag(path, "/text")


def test_times_that_do_not_grow_need_a_rate(tmp_path: Path) -> None:
    bunched = stamps_ns()
    bunched[7] = bunched[6]
    path = write_bag(tmp_path / "bag", readings(), StoragePlugin.MCAP, bunched)
    with pytest.raises(DataError, match=r"times of /array do not grow at message 8; .* --rate"):
        read_bag(path, "/array")
    time_s, _ = read_bag(path, "/array", rate_hz=50.0)
    assert time_s - time_s[0] == pytest.approx(np.arange(20) / 50, abs=1e-6)
    bunched[7] = bunched[6] + 100  # float64 seconds since 1970 do not tell 100 ns
    with pytest.raises(DataError, match="times of /array do not grow at message 8"):
        read_bag(write_bag(tmp_path / "close", readings(), StoragePlugin.MCAP, bunched), "/array")
    time_s, _ = read_bag(path, "/joints.position")  # headers grow
    assert np.diff(time_s) == pytest.approx(np.full(19, 0.02), abs=1e-6)


def test_bags_are_logs_of_calibrate_and_tune(tmp_path: Path) -> None:
    array = tmp_path / "pad.toml"
    array.write_text(
        'name = "pad"\nunit = "count"\nrange = [-500, 500]\ntaxel_count = 4\n'
        '[[taxel_channels]]\nname = "n"\nkind = "normal"\n'
    )
    path = write_bag(tmp_path / "bag", readings(), StoragePlugin.MCAP, stamps_ns())
    for source in (path, path / "bag.mcap"):
        assert np.array_equal(read_log(source, str(array), topic="/array").readings, 64 * readings())
        (block,) = read_log(source, str(array), topic="/array").blocks()
        assert isinstance(block, ScanBlock)
        assert len(block) == 20
    with pytest.raises(DataError, match="--topic TOPIC"):
        read_log(path, str(array))
    with pytest.raises(ConfigError, match="a bag has --topic"):
        read_log(path, str(array), "/array", TableOptions(columns=("a",)))
    with pytest.raises(DataError, match=r"4 channels, .* or the field .* --topic TOPIC\.FIELD"):
        read_log(path, "wang2019-3x3", topic="/array")


def test_errors_on_a_table_name_the_options(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time_s=np.arange(50) / 100, volts=np.zeros((50, 5)))
    with pytest.raises(DataError, match=r"5 channels, .* or the columns with --columns$"):
        read_log(tmp_path / "log.npz")
    with pytest.raises(ConfigError, match=r"--topic is for bags \(\.mcap, \.db3, \.bag or the folder"):
        read_log(tmp_path / "log.npz", topic="/pad")


def test_types_without_a_definition_are_named_and_others_are_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", readings(), StoragePlugin.SQLITE3, stamps_ns())
    with contextlib.closing(sqlite3.connect(path / "bag.db3")) as file:
        file.execute("DELETE FROM message_definitions")  # as ROS 2 before Iron writes it
        file.commit()
    with pytest.raises(DataError, match=r"/pad has messages of demo_msgs/msg/Pad, which the bag does not"):
        read_bag(path, "/pad.temperature")
    with pytest.raises(DataError, match=r"/pad with a type that it does not define"):
        read_bag(path, "/nothing")
    _, got = read_bag(path, "/array")
    assert np.array_equal(got, 64 * readings())


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "sensor_msgs/msg/JointState"
    rows = readings()
    with Writer1(tmp_path / "x.bag") as bag:
        at = bag.add_connection("/joints", kind, typestore=store)
        for k, (row, ns) in enumerate(zip(rows, stamps_ns().tolist(), strict=True)):
            seconds, rest = divmod(ns, 1_000_000_000)
            stamp = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
            header = store.types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
            nothing = np.zeros(0)
            message = store.types[kind](
                header=header, name=NAMES, position=row, velocity=nothing, effort=nothing
            )
            bag.write(at, ns, store.serialize_ros1(message, kind))
    time_s, got = read_bag(tmp_path / "x.bag", None)
    assert np.array_equal(got, rows)
    assert time_s == pytest.approx(stamps_ns() * 1e-9, abs=1e-6)


def test_without_rosbags_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(OperatorError, match=r"pip install '?rosbags"):
        read_bag(tmp_path / "x.bag", None)


def test_an_mcap_of_another_profile_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros1", "test")
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(DataError, match=r"[Pp]rofile.*exported as CSV"):
        read_bag(tmp_path / "x.mcap", None)


def write_mcap(path: Path, messages: list[bytes], schema: str, encoding: str = "cdr") -> Path:
    """An MCAP with one topic, without rosbags."""
    kind = "ros2msg" if encoding == "cdr" else "jsonschema"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        schema_id = writer.register_schema("demo_msgs/msg/Raw", kind, schema.encode())
        channel_id = writer.register_channel("/raw", encoding, schema_id)
        for ns, data in zip(stamps_ns(len(messages)).tolist(), messages, strict=True):
            writer.add_message(channel_id, log_time=ns, data=data, publish_time=ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_the_only_array_of_an_mcap_needs_no_name(tmp_path: Path) -> None:
    rows = readings()
    messages = [b"\0\1\0\0" + struct.pack("<B3xI4f", 1, 4, *row) for row in rows]
    path = write_mcap(tmp_path / "x.mcap", messages, "uint8 finger\nfloat32[] counts")
    _, got = read_bag(path, None)
    assert np.array_equal(got, rows)
    messages[4] = b"\0\1\0\0" + struct.pack("<B3xI2f", 1, 2, 0.0, 1.0)
    path = write_mcap(tmp_path / "y.mcap", messages, "uint8 finger\nfloat32[] counts")
    with pytest.raises(DataError, match=r"/raw.counts has 2 numbers in message 5, but 4 in the first"):
        read_bag(path, None)


def test_other_encodings_and_damage_are_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "j.mcap", [b'{"a": [1]}'] * 3, "{}", "json")
    with pytest.raises(DataError, match=r"j\.mcap: rosbags cannot read it.*export"):
        read_bag(path, "/raw")
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:-40])
    (tmp_path / "noise.db3").write_bytes(bytes(range(256)))
    (tmp_path / "folder").mkdir()
    for name, words in (
        ("cut.mcap", "is cut or damaged at byte"),
        ("noise.db3", "rosbags cannot read it"),
        ("folder", "a folder without metadata.yaml"),
    ):
        with pytest.raises(DataError, match=f"{name}: {words}"):
            read_bag(tmp_path / name, "/raw")


def test_a_bag_is_told_from_a_table_and_from_a_recording(tmp_path: Path) -> None:
    table = tmp_path / "log.csv"
    table.write_text("time_s,a\n0,1\n")
    recording = tmp_path / "ours.mcap"
    record(recording, simulated_reads(0.1))
    other = tmp_path / "other.mcap"
    with other.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        writer.finish()  # type: ignore[no-untyped-call]
    assert [is_bag(path) for path in (table, recording)] == [False] * 2
    assert [is_bag(path) for path in (other, tmp_path, tmp_path / "one.bag", tmp_path / "one.db3")] == [
        True
    ] * 4


def test_a_finished_mcap_of_others_is_told_by_its_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its chunks are not read for that."""
    messages = [b"\0\1\0\0" + struct.pack("<I4f", 4, *row) for row in readings()]
    path = write_mcap(tmp_path / "x.mcap", messages, "float32[] counts")
    monkeypatch.setattr(reader, "chunks", lambda *_: pytest.fail("the chunks are read"))
    assert is_bag(path)

"""A recording holds what was written, any viewer can read it, and two recorders never share one."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from messages import SLIP, STATUS
from recordings import HEADER, SOURCE, UNIX_OFFSET_S, items, record, simulated_reads
from rosbags.highlevel import AnyReader

from tactiled.errors import DataError
from tactiled.events.types import Event, ScanEvent
from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Input, Read, RecordedEvent
from tactiled.recording.reader import read_header, read_items
from tactiled.recording.writer import RecordingWriter


@pytest.fixture(scope="module")
def reads() -> list[Read]:
    return simulated_reads(1.2)


def test_bytes_arrivals_and_events_come_back_exactly(tmp_path: Path, reads: list[Read]) -> None:
    path = tmp_path / "a.mcap"
    record(path, reads)
    assert [item for item in items(path) if isinstance(item, Read)] == reads
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    live = [out for read in reads for out in pipeline.receive_data(read.data, read.arrival_s)]
    events = [item.event for item in items(path) if isinstance(item, RecordedEvent)]
    assert events == [out for out in live if isinstance(out, Event)]
    assert sum(isinstance(event, ScanEvent) for event in events) > 100
    header = read_header(path)
    assert (header.source, header.pipeline, header.part) == (SOURCE, HEADER.pipeline, 1)
    assert list(tmp_path.iterdir()) == [path]


def test_other_pipeline_inputs_keep_their_place(tmp_path: Path) -> None:
    told: list[Read | Input] = [
        Read(1.0, 0.5, b"ab"),
        Input(1.5, 0.5, "dropped", '{"reads": 3, "bytes": 99}'),
        Input(2.0, 0.5, "disconnected"),
        Read(3.0, 0.25, b""),
    ]
    with RecordingWriter(tmp_path / "a.mcap", HEADER) as writer:
        for item in told:
            if isinstance(item, Read):
                writer.read(item)
            else:
                writer.input(item)
    assert items(tmp_path / "a.mcap") == told
    assert isinstance(told[1], Input)
    assert told[1].values() == {"reads": 3, "bytes": 99}


def test_an_independent_reader_finds_every_channel_its_schema_and_its_times(
    tmp_path: Path, reads: list[Read]
) -> None:
    path = tmp_path / "a.mcap"
    record(path, reads)
    recorded = [i.event for i in items(path) if isinstance(i, RecordedEvent)]
    scans = iter([event for event in recorded if isinstance(event, ScanEvent)])
    others = iter([event for event in recorded if not isinstance(event, ScanEvent)])
    raws = iter(reads)
    with AnyReader([path]) as bag:
        for connection, stamp_ns, data in bag.messages():
            message: Any = bag.deserialize(data, connection.msgtype)
            if connection.topic == "/tactile/raw":
                read = next(raws)
                assert message.data.tobytes() == read.data
                instant_s = read.arrival_s
            elif connection.topic.endswith("/scan"):
                scan = next(scans)
                assert tuple(message.volts.tolist()) == scan.volts
                instant_s = scan.time_s
            else:
                other = next(others)
                assert connection.topic.endswith(f"/{other.topic}")
                instant_s = other.time_s
            assert stamp_ns == pytest.approx((instant_s + UNIX_OFFSET_S) * 1e9, abs=1e3)
    assert next(scans, None) is next(others, None) is None
    with path.open("rb") as stream:
        reader = make_reader(stream)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert message.publish_time == message.log_time
        assert next(m.name for m in reader.iter_metadata()) == "tactiled"


def test_a_second_recorder_is_refused_and_a_dead_one_named(tmp_path: Path, reads: list[Read]) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, HEADER), pytest.raises(DataError, match="another recorder is writing it"):
        RecordingWriter(path, HEADER)
    with pytest.raises(DataError, match="exists already"):
        RecordingWriter(path, HEADER)
    dead = RecordingWriter(tmp_path / "d.mcap", HEADER)
    dead.read(reads[0])
    dead.abandon()
    with pytest.raises(DataError, match=r"recorder that died; first run: tactiled recover .*d\.mcap\.active"):
        RecordingWriter(tmp_path / "d.mcap", HEADER)


def test_a_recorder_in_another_process_is_seen(tmp_path: Path) -> None:
    script = (
        "import sys; from recordings import HEADER; from pathlib import Path;"
        "from tactiled.recording.writer import RecordingWriter;"
        f"w = RecordingWriter(Path({str(tmp_path / 'a.mcap')!r}), HEADER); print('open', flush=True);"
        "sys.stdin.read()"
    )
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path])}
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environ
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        with pytest.raises(DataError, match="another recorder is writing it"):
            RecordingWriter(tmp_path / "a.mcap", HEADER)
        other.kill()
    with pytest.raises(DataError, match="recorder that died"):
        RecordingWriter(tmp_path / "a.mcap", HEADER)


@pytest.mark.parametrize("directory", ["none", "file"])
def test_an_unwritable_path_is_refused_before_recording(tmp_path: Path, directory: str) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match=r"a\.mcap\.active: cannot be written \(.*choose a place"):
        RecordingWriter(tmp_path / directory / "a.mcap", HEADER)


def test_a_recording_opens_in_rosbags_with_its_own_schemas(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    with RecordingWriter(path, HEADER) as writer:
        for event in (STATUS, SLIP):
            writer.event(event, "TS0001", 1.7e9, "pipeline")
    with AnyReader([path]) as reader:
        messages = reader.messages()
        found: dict[str, Any] = {c.topic: reader.deserialize(data, c.msgtype) for c, _, data in messages}
    assert found["/tactile/status"].state == STATUS.state
    assert found["/tactile/slip"].board == "TS0001"
    assert [item.event for item in read_items(path) if isinstance(item, RecordedEvent)] == [STATUS, SLIP]

"""Run again, a recording gives the events that were live: bit for bit, whatever the file looks like."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from recordings import HEADER, SOURCE, UNIX_OFFSET_S, items, record, simulated_reads, write_step

from tactiled.array import numerics_words
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.errors import DataError
from tactiled.events.codec import encode
from tactiled.events.types import Event, GripEvent, SlipEvent
from tactiled.offline import Choices, detect_messages
from tactiled.pipeline import Pipeline
from tactiled.recording import contents
from tactiled.recording import writer as writer_module
from tactiled.recording.cdr import Schema, fields_of
from tactiled.recording.contents import Input, Read
from tactiled.recording.recover import recover
from tactiled.recording.replay import replay
from tactiled.recording.session import RecordEntry, RecordingSession, RecordParams, part_path
from tactiled.recording.writer import RecordingWriter
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Hello, Scan


@pytest.fixture(scope="module")
def reads() -> list[Read]:
    """Long enough for contact and slip, with events of every kind that the demo has by then."""
    return simulated_reads(7.5)


def hand_over(session: RecordingSession, told: list[Read | Input], pipeline: Pipeline) -> list[Event]:
    """As the service does it, with the clock of the recording; gives the events that were live."""
    live: list[Event] = []
    for item in told:
        if isinstance(item, Read):
            outputs = pipeline.receive_data(item.data, item.arrival_s)
            now_s = item.arrival_s
        elif item.name == "disconnected":
            pipeline.disconnected()
            outputs, now_s = [], item.time_s
        else:
            reason, events = pipeline.command(item.name, item.values(), item.time_s)
            assert not reason
            outputs, now_s = list(events), item.time_s
        live += [output for output in outputs if isinstance(output, Event)]
        session.take(RecordEntry(item, outputs, pipeline.hello, "", UNIX_OFFSET_S), now_s)
        session.tick(now_s)
    return live


def messages(events: list[Event], board: str) -> list[str]:
    """JSON lines as a live subscriber prints them, through the very bytes that it gets."""
    seqs: dict[str, int] = {}
    lines = []
    for event in events:
        seqs[event.topic] = seq = seqs.get(event.topic, -1) + 1
        _, payload = encode(event, seq=seq, board=board, unix_offset_s=UNIX_OFFSET_S)
        lines.append(json.dumps({"topic": event.topic, **msgpack.unpackb(payload)}))
    return lines


def ticks_of(reads: list[Read]) -> int | None:
    """Ticks of the newest scan: about what a board answers to a ping then."""
    frames = Decoder(SOURCE.layout).feed(b"".join(read.data for read in reads[-20:]))
    scans = [frame for frame in frames if isinstance(frame, Scan)]
    return scans[-1].ticks if scans else None


def board_of(reads: list[Read]) -> str:
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    hellos = [o for r in reads for o in pipeline.receive_data(r.data, r.arrival_s) if isinstance(o, Hello)]
    return hellos[0].board_serial


def test_lines_are_those_of_a_live_subscriber(tmp_path: Path, reads: list[Read]) -> None:
    session = RecordingSession(RecordParams(min_free_mb=0), HEADER, tmp_path / "a.mcap", reads[0].arrival_s)
    live = hand_over(session, list(reads), Pipeline(SOURCE.layout, SOURCE.array))
    session.end(reads[-1].arrival_s)
    assert {event.topic for event in live} >= {"scan", "contact", "slip"}
    lines: list[str] = []
    verdict = replay([tmp_path / "a.mcap"], lines.append)
    assert lines == messages(live, board_of(reads))
    assert (verdict.compared, verdict.difference, verdict.is_good) == (len(live), "", True)
    slips: list[str] = []
    replay([tmp_path / "a.mcap"], slips.append, topics=("slip",))
    assert slips == [line for line in lines if '"topic": "slip"' in line]


def test_events_with_another_schema_are_refused(
    tmp_path: Path, reads: list[Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    other = {"board": str, "unix_offset_s": float} | fields_of(SlipEvent)
    del other["suppressed"]
    with monkeypatch.context() as then:
        then.setitem(contents.SCHEMAS, "slip", Schema("Slip", other))
        record(tmp_path / "a.mcap", reads)
    with pytest.raises(DataError, match="/tactile/slip has the schema of another tactiled version"):
        replay([tmp_path / "a.mcap"], lambda _: None)


@pytest.mark.parametrize("chunk_bytes", [200, 5_000, 10_000_000])
def test_any_grouping_into_chunks_gives_the_same(
    tmp_path: Path, reads: list[Read], chunk_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "_CHUNK_BYTES", chunk_bytes)
    monkeypatch.setattr("os.fsync", lambda _: None)
    record(tmp_path / "a.mcap", reads, sync_every=10**9)
    verdict = replay([tmp_path / "a.mcap"], lambda _: None)
    assert verdict.is_good
    assert verdict.compared > len(reads)


def test_parts_lost_ports_and_commands_are_replayed(tmp_path: Path, reads: list[Read]) -> None:
    """Rotated in the middle of frames and of the slip; the cable pulled; commands in between."""
    told: list[Read | Input] = []
    commands: dict[int, tuple[str, dict[str, object]]] = {
        50: ("adapter", {"handover_s": 0.016}),
        100: ("tare", {"force": True}),
        60: ("friction", {"value": 0.7, "sd": 0.1}),
        300: ("speed", {"speed_mm_s": 7.0}),
        500: ("thresholds", {"values": {"grip.incipient_p": 0.5}}),
        600: ("inhibit", {"duration_s": 0.3}),
        620: ("object-changed", {}),
        650: ("adapter", {"handover_s": None}),
    }
    pings: dict[int, int] = {}  # the read behind which each is sent, by token
    for k, read in enumerate(reads):
        half = len(read.data) // 2
        told += [
            Read(read.arrival_s, UNIX_OFFSET_S, read.data[:half]),
            Read(read.arrival_s + 1e-4, UNIX_OFFSET_S, read.data[half:]),
        ]
        if k % 40 == 20:
            pings[k] = k
            told.append(Input(read.arrival_s + 1.5e-4, UNIX_OFFSET_S, "ping", json.dumps({"token": k})))
        if k - 1 in pings and (ticks := ticks_of(reads[: k + 1])) is not None:
            answer = Encoder(SOURCE.layout).encode(Acknowledge(k - 1, "ping", "ok", ticks))
            told.append(Read(read.arrival_s + 1.8e-4, UNIX_OFFSET_S, answer))
        if k in commands:
            name, arguments = commands[k]
            told.append(Input(read.arrival_s + 2e-4, UNIX_OFFSET_S, name, json.dumps(arguments)))
        if k == 400:
            told.append(Input(read.arrival_s + 2e-4, UNIX_OFFSET_S, "disconnected"))
            told.append(Read(read.arrival_s + 1.0e-3, UNIX_OFFSET_S, hello_of(reads)))
    path = tmp_path / "a.mcap"
    params = RecordParams(max_file_s=1.0, sync_s=0.1, min_free_mb=0)
    session = RecordingSession(params, HEADER, path, reads[0].arrival_s)
    live = hand_over(session, told, Pipeline(SOURCE.layout, SOURCE.array))
    session.end(reads[-1].arrival_s)
    parts = [part_path(path, k) for k in range(1, session.progress.parts + 1)]
    assert len(parts) >= 6
    verdict = replay(parts, lambda _: None)
    assert verdict.words() == f"{len(live)} events reproduced bit for bit"
    later = replay(parts[2:], lambda _: None)
    assert not later.fresh
    assert "add the earlier parts" in later.words()
    shuffled = [*parts[3:], *parts[1:3], parts[0]]  # as a shell sorts a.002.mcap before a.mcap, and worse
    assert replay(shuffled, lambda _: None) == verdict
    with pytest.raises(DataError, match=r"a\.003\.mcap: this is part 3, and part 2 of its run was not given"):
        replay([parts[2], parts[0]], lambda _: None)
    with pytest.raises(DataError, match="part 1 of its run was given twice"):
        replay([parts[0], parts[0]], lambda _: None)
    record(tmp_path / "other.mcap", reads[:5])
    with pytest.raises(DataError, match=r"other\.mcap: this is another recording than the file before it"):
        replay([parts[0], tmp_path / "other.mcap"], lambda _: None)


def test_scans_have_the_announced_motion_that_they_had_live(
    tmp_path: Path, reads: list[Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The grip messages say here what motion their scan was processed with."""
    told_by = GripDetector._told  # noqa: SLF001  no message has it

    def saying(self: GripDetector, *arguments: Any, **others: Any) -> GripEvent | None:
        event = told_by(self, *arguments, **others)
        return None if event is None else replace(event, shear_x=np.nan_to_num(self.acceleration_m_s2))

    monkeypatch.setattr(GripDetector, "_told", saying)
    told: list[Read | Input] = []
    for k, read in enumerate(reads):
        told.append(read)
        if k % 5 == 0 and k % 200 < 150:  # with pauses, and up to 30 ms late or ahead
            time_s = [read.arrival_s + (k % 7 - 3 + step) / 100 for step in range(5)]
            course = {"time_s": time_s, "acceleration_m_s2": [9.81 + 0.01 * k + step for step in range(5)]}
            told.append(Input(read.arrival_s + 1e-3, UNIX_OFFSET_S, "motion", json.dumps(course)))
    session = RecordingSession(RecordParams(min_free_mb=0), HEADER, tmp_path / "a.mcap", reads[0].arrival_s)
    live = hand_over(session, told, Pipeline(SOURCE.layout, SOURCE.array))
    session.end(reads[-1].arrival_s)
    said = {event.shear_x for event in live if isinstance(event, GripEvent)}
    assert 0.0 in said
    assert len(said) > 100
    verdict = replay([tmp_path / "a.mcap"], lambda _: None)
    assert verdict.words() == f"{len(live)} events reproduced bit for bit"
    _, messages = detect_messages(tmp_path / "a.mcap", choices=Choices(grip_hz=1e4))
    assert said == {message["shear_x"] for message in messages if message["topic"] == "grip"}


def test_a_recording_with_motion_that_is_no_course_is_refused(tmp_path: Path, reads: list[Read]) -> None:
    with RecordingWriter(tmp_path / "a.mcap", HEADER) as writer:
        write_step(writer, reads[0], [])
        writer.input(Input(reads[0].arrival_s, UNIX_OFFSET_S, "motion", '{"time_s": [2, 1]}'))
    with pytest.raises(DataError, match="motion: time_s and acceleration_m_s2 are not"):
        replay([tmp_path / "a.mcap"], lambda _: None)


def hello_of(reads: list[Read]) -> bytes:
    """The bytes up to the first scan: the board's introduction."""
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    for read in reads:
        if any(isinstance(o, Hello) for o in pipeline.receive_data(read.data, read.arrival_s)):
            return read.data
    raise AssertionError("the board never said hello")


def test_a_later_part_alone_still_has_its_scans(tmp_path: Path, reads: list[Read]) -> None:
    params = RecordParams(max_file_s=1.0, sync_s=0.1, min_free_mb=0)
    session = RecordingSession(params, HEADER, tmp_path / "a.mcap", reads[0].arrival_s)
    hand_over(session, list(reads), Pipeline(SOURCE.layout, SOURCE.array))
    session.end(reads[-1].arrival_s)
    lines: list[str] = []
    replay([tmp_path / "a.003.mcap"], lines.append, topics=("scan",))
    assert len(lines) > 90


def test_verification_reports_that_a_recording_begins_in_the_middle_of_a_run(
    tmp_path: Path, reads: list[Read]
) -> None:
    params = RecordParams(directory=str(tmp_path), min_free_mb=0)
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    session = RecordingSession(params.model_copy(update={"directory": None}), HEADER, None, 0.0)
    hand_over(session, list(reads[:300]), pipeline)
    assert not list(tmp_path.iterdir())
    session = RecordingSession(params, HEADER, tmp_path / "first.mcap", 0.0)
    session.begin(pipeline.hello, reads[300].arrival_s)
    hand_over(session, list(reads[300:]), pipeline)
    session.end(reads[-1].arrival_s)
    (path,) = tmp_path.glob("tactile-*Z.mcap")
    lines: list[str] = []
    verdict = replay([path], lines.append, topics=("scan",))
    assert len(lines) > 400
    assert not verdict.fresh
    assert "begins in the middle of a run" in verdict.words()


def test_half_a_recording_gives_the_events_of_its_half(tmp_path: Path, reads: list[Read]) -> None:
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    record(path, reads)
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    saved = recover(cut)
    whole: list[str] = []
    half: list[str] = []
    replay([path], whole.append)
    verdict = replay([saved.path], half.append)
    assert verdict.is_good
    assert half == whole[: len(half)]
    assert len(half) > len(whole) // 4


@pytest.mark.parametrize(
    ("computed_with", "is_named"),
    [("", False), (numerics_words(), False), ("numpy 9 for Zen", True)],
    ids=["unknown", "here", "elsewhere"],
)
def test_a_changed_bit_is_found(
    tmp_path: Path, reads: list[Read], computed_with: str, *, is_named: bool
) -> None:
    """Written anew with one event changed in the last place: the check is not blind."""
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    header = replace(HEADER, computed_with=computed_with)
    session = RecordingSession(RecordParams(min_free_mb=0), header, tmp_path / "a.mcap", 0.0)
    for k, read in enumerate(reads[:200]):
        outputs = pipeline.receive_data(read.data, read.arrival_s)
        if k == 150:
            changed = Read(read.arrival_s, read.unix_offset_s, read.data[:-9] + b"?" + read.data[-8:])
            session.take(RecordEntry(changed, outputs, pipeline.hello, "", UNIX_OFFSET_S), read.arrival_s)
        else:
            session.take(RecordEntry(read, outputs, pipeline.hello, "", UNIX_OFFSET_S), read.arrival_s)
    session.end(1.0)
    verdict = replay([tmp_path / "a.mcap"], lambda _: None)
    assert not verdict.is_good
    assert verdict.compared < 200
    assert f"first difference at {reads[150].arrival_s:.6f} s: live" in verdict.words()
    assert ("computed with numpy 9 for Zen, this replay with" in verdict.words()) == is_named


def test_nothing_is_compared_after_dropped_reads(tmp_path: Path, reads: list[Read]) -> None:
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    session = RecordingSession(RecordParams(min_free_mb=0), HEADER, tmp_path / "a.mcap", 0.0)
    for k, read in enumerate(reads[:300]):
        outputs = pipeline.receive_data(read.data, read.arrival_s)
        if 100 <= k < 105:
            continue
        dropped = (5, 5 * len(read.data)) if k == 105 else (0, 0)
        session.take(RecordEntry(read, outputs, pipeline.hello, "", UNIX_OFFSET_S, dropped), read.arrival_s)
    session.end(1.0)
    (mark,) = [item for item in items(tmp_path / "a.mcap") if isinstance(item, Input)]
    assert (mark.name, mark.values()["reads"]) == ("dropped", 5)
    verdict = replay([tmp_path / "a.mcap"], lambda _: None)
    assert verdict.is_good
    assert verdict.compared < 105
    assert "compared up to the place where the recorder dropped 5 reads" in verdict.words()


def test_mcap_files_of_others_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        other = Writer(stream, compression=CompressionType.NONE)
        other.start()
        other.add_metadata("tactiled", {"layout": "{}"})
        other.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(DataError, match="a recording of another tactiled"):
        replay([path], lambda _: None)


@pytest.mark.parametrize("place", [0, 1], ids=["before its first read", "before its second"])
def test_a_recording_that_begins_again_marks_only_its_own_dropped_reads(
    tmp_path: Path, reads: list[Read], place: int
) -> None:
    params = RecordParams(directory=str(tmp_path), min_free_mb=0)
    session = RecordingSession(params, HEADER, tmp_path / "first.mcap", 0.0)
    session.end(0.0)
    for read in reads[:3]:  # between two recordings
        session.take(RecordEntry(read, [], None, "", UNIX_OFFSET_S), read.arrival_s)
    session.begin(None, reads[3].arrival_s)
    for k, read in enumerate(reads[3:5]):
        dropped = (5, 99) if k == place else (0, 0)
        session.take(RecordEntry(read, [], None, "", UNIX_OFFSET_S, dropped), read.arrival_s)
    session.end(reads[4].arrival_s)
    (path,) = tmp_path.glob("tactile-*Z.mcap")
    found = items(path)
    mark = found.pop(place)
    assert found == reads[3:5]
    assert isinstance(mark, Input)
    assert (mark.name, mark.values()) == ("dropped", {"reads": 5, "bytes": 99})


def test_a_mark_without_a_number_of_reads_is_refused(tmp_path: Path, reads: list[Read]) -> None:
    with RecordingWriter(tmp_path / "a.mcap", HEADER) as writer:
        writer.input(Input(reads[0].arrival_s, UNIX_OFFSET_S, "dropped"))
    with pytest.raises(DataError, match="'dropped': it does not state the number of reads"):
        replay([tmp_path / "a.mcap"], lambda _: None)

"""Recordings are read by `tactiled tune` as `tactiled record` writes them."""

from pathlib import Path

from recordings import HEADER, SOURCE, UNIX_OFFSET_S, simulated_reads, write_step

from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Input
from tactiled.recording.writer import RecordingWriter
from tactiled.tune.files import read_recording


def test_a_recording_that_was_ended_regularly_is_read(tmp_path: Path) -> None:
    reads = simulated_reads(2.0)
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    path = tmp_path / "hold.mcap"
    with RecordingWriter(path, HEADER) as writer:
        for read in reads:
            write_step(writer, read, pipeline.receive_data(read.data, read.arrival_s))
        writer.input(Input(reads[-1].arrival_s, UNIX_OFFSET_S, "disconnected"))
    recording = read_recording(path)
    assert sum(len(block) for block in recording.blocks) == pipeline.health().scans
    assert {block.rate_hz for block in recording.blocks} == {100.0}

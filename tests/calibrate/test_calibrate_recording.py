"""Recordings of tactiled as the log of a calibration, and forces of a recording."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from recordings import SOURCE, record, simulated_reads, write_step

from tactiled.cli.entry import cli
from tactiled.errors import ConfigError
from tactiled.events.types import ForceEvent
from tactiled.force.calibration import load_calibration
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.recording.contents import Header
from tactiled.recording.reader import read_header
from tactiled.recording.steps import Replay
from tactiled.recording.writer import RecordingWriter
from tactiled.scan_log import read_log


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "press.mcap"
    record(path, simulated_reads(6.0))
    return path


def test_a_recording_gives_array_board_and_scans(recording: Path) -> None:
    log = read_log(recording)
    assert log.array.name == "wang2019-3x3"
    assert log.board
    assert log.readings.shape == (len(log.time_s), 36)
    assert len(log.time_s) > 400
    with pytest.raises(ConfigError, match="a recording contains them"):
        read_log(recording, array="wang2019-3x3")


def test_forces_of_a_recording_by_the_nominal_calibration(recording: Path) -> None:
    found = CliRunner().invoke(
        cli, ["detect", str(recording), "--calibration", "wang2019-3x3", "--only", "force", "--force-hz", "5"]
    )
    assert found.exit_code == 0, found.output
    lines = [json.loads(line) for line in found.stdout.splitlines()]
    assert len(lines) > 20
    assert {line["calibration"] for line in lines} == {"nominal"}
    assert max(line["fz_n"] for line in lines) > 1.0


def test_a_recording_keeps_its_calibration_and_replays_the_same_forces(tmp_path: Path) -> None:
    params = PipelineParams(force=True, calibration=load_calibration("wang2019-3x3"))
    path = tmp_path / "forces.mcap"
    pipeline = Pipeline(SOURCE.layout, SOURCE.array, params)
    live: list[ForceEvent] = []
    with RecordingWriter(path, Header(SOURCE, pipeline=params)) as writer:
        for read in simulated_reads(3.0):
            outputs = pipeline.receive_data(read.data, read.arrival_s)
            live += [output for output in outputs if isinstance(output, ForceEvent)]
            write_step(writer, read, outputs)
    assert len(live) > 200
    assert read_header(path).pipeline == params
    replay = Replay([path])
    again = [one.event for step in replay for one in step.now if isinstance(one.event, ForceEvent)]
    assert again == live

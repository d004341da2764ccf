"""Exported tables hold every scan exactly, and are read again."""

import json
from pathlib import Path

import numpy as np
import pytest
from recordings import HEADER, items, record, simulated_reads

from tactiled.detect.contact.signs import LOOK_S
from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.offline import detect_file
from tactiled.recording.contents import RecordedEvent
from tactiled.recording.export import export_csv
from tactiled.recording.whole import read_table
from tactiled.recording.writer import RecordingWriter


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    record(path, simulated_reads(7.5))
    return path


def scans_of(recording: Path) -> list[ScanEvent]:
    recorded = [item.event for item in items(recording) if isinstance(item, RecordedEvent)]
    return [event for event in recorded if isinstance(event, ScanEvent)]


def test_every_number_survives(tmp_path: Path, recording: Path) -> None:
    scans = scans_of(recording)
    time_s = np.array([scan.time_s for scan in scans])
    valid = np.array([scan.valid for scan in scans])
    volts = np.where(valid, np.array([scan.volts for scan in scans]), np.nan)
    assert export_csv([recording], tmp_path / "a.csv") == len(scans)
    got_s, got_volts = read_table(tmp_path / "a.csv")
    assert np.array_equal(got_s, time_s)
    assert np.array_equal(got_volts, volts, equal_nan=True)


def test_detect_finds_the_same_in_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = tmp_path / "demo.mcap"
    record(recording, simulated_reads(7.5, "demo"))
    export_csv([recording], tmp_path / "a.csv")
    capsys.readouterr()
    detect_file(recording)
    ours = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    detect_file(tmp_path / "a.csv")
    table = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(e["topic"], e["state"]) for e in table] == [(e["topic"], e["state"]) for e in ours]
    # A table does not say when within a scan each channel was sampled: an onset may move within its standard
    # deviation, and an event by two looks at the taxels.
    for one, other in zip(table, ours, strict=True):
        may_move_s = max(other.get("onset_sd_s", 0.0), 0.01 + 2 * LOOK_S)
        assert one["timestamp"] == pytest.approx(other["timestamp"], abs=may_move_s), one


def test_a_failed_export_gives_a_reason_and_leaves_no_file(tmp_path: Path, recording: Path) -> None:
    with RecordingWriter(tmp_path / "empty.mcap", HEADER):
        pass
    with pytest.raises(DataError, match="contains no scans"):
        export_csv([tmp_path / "empty.mcap"], tmp_path / "e.csv")
    assert not (tmp_path / "e.csv").exists()
    (tmp_path / "mine.csv").write_text("mine")
    with pytest.raises(DataError, match=r"mine\.csv: exists already"):
        export_csv([recording], tmp_path / "mine.csv")
    assert (tmp_path / "mine.csv").read_text() == "mine"
    with pytest.raises(DataError, match="cannot be written: No such file"):
        export_csv([recording], tmp_path / "none" / "a.csv")

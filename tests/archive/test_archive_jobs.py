"""Keys of jobs, tables of rows and lines for people, without workers."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactiled.archive.detect import (
    FILE_TOPIC,
    FileJob,
    Outcome,
    detect_files,
    event_rows,
    file_row,
    matching,
    schema,
)
from tactiled.errors import DataError, OperatorError
from tactiled.offline import Choices

MESSAGES = [{"topic": "slip", "seq": 3, "timestamp": 1.5, "valid": True, "taxels": [1, 2]}]


def job(path: Path, **changes: Any) -> FileJob:
    return replace(FileJob(path.name, path, None, None, Choices()), **changes)


def test_a_file_that_changed_is_analysed_anew(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"12")
    os.utime(path, (1.0, 1.0))
    first = job(path).key()
    assert job(path).key() == first
    assert len(first) == 64
    path.write_bytes(b"123")
    os.utime(path, (1.0, 1.0))
    longer = job(path).key()
    os.utime(path, (1.0, 2.0))
    assert len({first, longer, job(path).key()}) == 3


def test_a_bag_changes_with_any_file_in_it(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    (bag / "inner").mkdir(parents=True)
    file = bag / "inner" / "0.mcap"
    file.write_bytes(b"12")
    first = job(bag).key()
    stat = bag.stat()
    file.write_bytes(b"123")
    os.utime(bag, (stat.st_atime, stat.st_mtime))
    assert job(bag).key() != first


def test_all_choices_and_the_version_are_in_the_key(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.touch()
    config = tmp_path / "tactiled.toml"
    config.write_text('[detect]\nsetting = "fast"\n')
    array = tmp_path / "a.toml"
    array.write_text("one")
    jobs = [
        job(path),
        job(path, rate_hz=100.0),
        job(path, array="wang2019-3x3"),
        job(path, array=str(array)),
        job(path, version="0"),
        job(path, file="b.csv"),
        job(path, choices=Choices(calibration="wang2019-3x3")),
        job(path, choices=Choices(layout="legacy-9")),
        job(path, choices=Choices(grip_hz=1.0)),
        job(path, choices=Choices(config=config)),
    ]
    keys = [each.key() for each in jobs]
    array.write_text("two")
    config.write_text('[detect]\nsetting = "quiet"\n')
    assert len({*keys, jobs[3].key(), jobs[-1].key()}) == len(jobs) + 2


def test_a_job_for_any_worker_has_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").touch()
    made = FileJob.for_any_worker(
        "a.csv", "mine.toml", 50.0, Choices(calibration="mine.toml", layout="legacy-9")
    )
    assert (made.file, made.path) == ("a.csv", tmp_path / "a.csv")
    assert (made.array, made.rate_hz) == (str(tmp_path / "mine.toml"), 50.0)
    assert made.choices.calibration == str(tmp_path / "mine.toml")
    assert made.choices.layout == "legacy-9"  # the name of a shipped one


def test_patterns_name_each_file_once_and_sorted(tmp_path: Path) -> None:
    for name in ("b.mcap", "a.mcap", "sub/c.mcap", "[x].mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = matching([f"{tmp_path}/**/*.mcap", f"{tmp_path}/a.mcap", f"{tmp_path}/[x].mcap"])
    assert [str(Path(name).relative_to(tmp_path)) for name in found] == [
        "[x].mcap",
        "a.mcap",
        "b.mcap",
        "sub/c.mcap",
    ]
    with pytest.raises(DataError, match="no such file, and no file matches"):
        matching([f"{tmp_path}/a.mcap", f"{tmp_path}/*.csv"])


def rows_of(table: Any) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if value is not None} for row in table.to_pylist()]


def test_a_table_has_a_row_for_the_file_and_one_for_each_event() -> None:
    head, events = file_row("a.csv", "36 channels"), event_rows("a.csv", MESSAGES)
    assert head.schema == events.schema == schema()
    assert rows_of(head) == [{"file": "a.csv", "topic": FILE_TOPIC, "error": "", "summary": "36 channels"}]
    assert rows_of(events) == [{"file": "a.csv", **MESSAGES[0]}]


def test_a_name_that_is_no_utf8_is_escaped() -> None:
    assert rows_of(file_row(os.fsdecode(b"\xff.csv"), ""))[0]["file"] == "\\xff.csv"


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome(3, 0, 7, ()), "t: 7 events of 3 files"),
        (Outcome(3, 2, 7, ()), "t: 7 events of 3 files, 2 of them analysed earlier"),
        (Outcome(3, 0, 7, (("a", "x"),)), "t: 7 events of 3 files; 1 files could not be analysed"),
    ],
)
def test_the_outcome_is_a_line(outcome: Outcome, words: str) -> None:
    assert outcome.words(Path("t")) == words


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(OperatorError, match="cannot be written: No such file"):
        detect_files([job(tmp_path / "a")], tmp_path / "none" / "events.parquet", 1, None)

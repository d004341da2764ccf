"""Scans of the recordings that the virtual machine makes are counted from the bytes of the line."""

from pathlib import Path

import pytest
from recordings import record, simulated_reads

from bench.machine.records import first_after, read_recording
from tactiled.recording.contents import Read


@pytest.fixture(scope="module")
def reads() -> list[Read]:
    return simulated_reads(3.0)


def test_of_a_whole_recording_nothing_is_lost(tmp_path: Path, reads: list[Read]) -> None:
    record(tmp_path / "whole.mcap", reads)
    found = read_recording(tmp_path / "whole.mcap")
    assert len(found.scan_s) > 250
    assert (found.lost_with_board, found.unaccounted, found.steps_s) == (0, 0, [])
    assert found.last_unix_s == reads[-1].arrival_s + reads[-1].unix_offset_s


def test_scans_that_never_arrived_are_lost_and_here_not_accounted_for(
    tmp_path: Path, reads: list[Read]
) -> None:
    middle = len(reads) // 2
    record(tmp_path / "cut.mcap", reads[:middle] + reads[middle + 20 :])
    found = read_recording(tmp_path / "cut.mcap")
    assert found.lost_with_board > 10
    assert found.unaccounted == found.lost_with_board  # this recording has no status that counts them


def test_no_later_time_is_infinitely_far() -> None:
    assert first_after([1.0, 2.5, 4.0], 2.0) == 0.5
    assert first_after([1.0], 2.0) == float("inf")

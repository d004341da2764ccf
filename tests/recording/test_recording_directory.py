"""A record directory: what is kept of it, and what earlier runs left unfinished in it."""

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import HEADER, items, noise_read, record, simulated_reads

from tactiled.errors import DataError
from tactiled.recording.contents import Read
from tactiled.recording.directory import Finished, finished, new_name, remove_surplus, surplus, unfinished
from tactiled.recording.recover import recover_directory
from tactiled.recording.writer import ACTIVE, DAMAGED, RecordingWriter

files_of = st.lists(
    st.builds(
        Finished,
        path=st.integers(0, 10**6).map(lambda k: Path(f"{k}.mcap")),
        size_mb=st.floats(0, 1000),
        ended_unix_s=st.floats(0, 1e9),
    ),
    max_size=20,
    unique_by=lambda file: file.path,
)


@given(files=files_of, keep_mb=st.floats(0.001, 1e4), now_unix_s=st.floats(0, 1e9))
def test_the_oldest_go_first_until_the_limit_holds_and_the_newest_stays(
    files: list[Finished], keep_mb: float, now_unix_s: float
) -> None:
    removed = surplus(files, keep_mb, now_unix_s)
    kept = [file for file in files if file not in removed]
    assert bool(kept) == bool(files)
    assert len(kept) <= 1 or sum(file.size_mb for file in kept) <= keep_mb * (1 + 1e-9)
    possible = [file for file in files if file.ended_unix_s <= now_unix_s]
    for some in (possible, [file for file in files if file not in possible]):
        oldest = max((file.ended_unix_s for file in some if file in removed), default=-1.0)
        assert all(file.ended_unix_s >= oldest for file in some if file in kept)
    if any(file in removed for file in possible):
        assert all(file in possible for file in kept)


def name(second: int) -> str:
    return new_name(datetime(2026, 1, 1, 0, 0, second, tzinfo=UTC))


def place_file(path: Path, size_bytes: int, ended_unix_s: float) -> None:
    path.write_bytes(bytes(size_bytes))
    os.utime(path, (ended_unix_s, ended_unix_s))


def test_only_finished_recordings_that_the_daemon_named_are_removed(tmp_path: Path) -> None:
    for k in range(4):
        place_file(tmp_path / name(k), 1_000_000, 1000.0 + k)
    part = name(0).replace(".mcap", ".002.mcap")
    others = ("mine.mcap", "tactile-notes.mcap", name(5) + ACTIVE, name(6) + ".part")
    place_file(tmp_path / part, 1_000_000, 1000.5)
    for other in others:
        place_file(tmp_path / other, 5_000_000, 1.0)
    (tmp_path / name(7)).mkdir()
    removed = remove_surplus(tmp_path, 2.5, 2000.0)
    assert [file.path.name for file in removed] == [name(0), part, name(1)]
    assert {path.name for path in tmp_path.iterdir()} == {name(2), name(3), name(7), *others}
    remove_surplus(tmp_path, 0.001, 1e9)
    assert [file.path.name for file in finished(tmp_path)] == [name(3)]


def test_a_file_that_cannot_be_removed_does_not_keep_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(4):
        place_file(tmp_path / name(k), 1_000_000, 1000.0 + k)
    unlink = Path.unlink

    def refuse_one(path: Path, missing_ok: bool = False) -> None:
        if path.name == name(0):
            raise PermissionError(1, "Operation not permitted", str(path))
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse_one)
    with pytest.raises(PermissionError):
        remove_surplus(tmp_path, 1.5, 2000.0)
    assert {path.name for path in tmp_path.iterdir()} == {name(0), name(3)}


def leave_unfinished(path: Path, n_reads: int) -> bytes:
    """What a recorder that was killed leaves behind; gives its bytes."""
    writer = RecordingWriter(path, HEADER)
    for k in range(n_reads):
        writer.read(noise_read(k))
    writer.sync()
    writer.abandon()
    with writer.active.open("ab") as torn:
        torn.write(b"torn" * 20)
    return writer.active.read_bytes()


def test_unfinished_files_are_recovered_and_files_being_written_are_not(tmp_path: Path) -> None:
    leave_unfinished(tmp_path / name(0), 5)
    os.utime(tmp_path / (name(0) + ACTIVE), (1000.0, 1000.0))
    leave_unfinished(tmp_path / "mine.mcap", 5)
    (tmp_path / (name(1) + ACTIVE)).write_bytes(b"")  # killed before anything was written
    with RecordingWriter(tmp_path / name(2), HEADER) as other:
        other.read(noise_read(7))
        other.sync()
        before = other.active.read_bytes()
        assert [path.name for path in unfinished(tmp_path)] == [name(0) + ACTIVE, name(1) + ACTIVE]
        (good, words), (bad, why) = recover_directory(tmp_path)
        assert (good, bad) == (True, False)
        assert "an incomplete chunk of 80 bytes" in words
        assert "not a recording of tactiled" in why
        assert other.active.read_bytes() == before
    assert items(tmp_path / name(0)) == [noise_read(k) for k in range(5)]
    assert (tmp_path / name(0)).stat().st_mtime == 1000.0  # its age is that of the recording
    assert items(tmp_path / name(2)) == [noise_read(7)]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["mine.mcap" + ACTIVE, name(0), name(1) + ACTIVE, name(2)]
    )


def test_an_original_whose_last_chunk_is_whole_and_damaged_is_kept(tmp_path: Path) -> None:
    sizes = record(tmp_path / "whole.mcap", simulated_reads(2.0))
    data = bytearray((tmp_path / "whole.mcap").read_bytes()[: sizes[-1]])
    data[data.rindex(b"zstd") + 30] ^= 0xFF
    active = tmp_path / (name(0) + ACTIVE)
    active.write_bytes(data)
    assert [is_recovered for is_recovered, _ in recover_directory(tmp_path)] == [True]
    assert (tmp_path / (name(0) + ACTIVE + DAMAGED)).read_bytes() == data


def test_a_damaged_original_is_kept_until_retention_removes_it(tmp_path: Path) -> None:
    reads = simulated_reads(2.0)
    sizes = record(tmp_path / "whole.mcap", reads)
    data = bytearray((tmp_path / "whole.mcap").read_bytes()[: sizes[-1]])
    data[data.index(b"zstd") + 30] ^= 0xFF  # in the first chunk
    active = tmp_path / (name(0) + ACTIVE)
    active.write_bytes(data)
    ((good, words),) = recover_directory(tmp_path)
    kept = tmp_path / (name(0) + ACTIVE + DAMAGED)
    assert good
    assert f"the original is kept as {kept.name}" in words
    assert kept.read_bytes() == data
    found = [item for item in items(tmp_path / name(0)) if isinstance(item, Read)]
    assert len(found) > len(reads) // 2
    assert found == reads[50 : 50 + len(found)]
    assert not list(recover_directory(tmp_path))
    place_file(tmp_path / name(1), 10, active_s := kept.stat().st_mtime + 1.0)
    remove_surplus(tmp_path, 1e-6, active_s)
    assert {path.name for path in tmp_path.iterdir()} == {"whole.mcap", name(1)}


def test_a_file_without_room_for_its_copy_or_with_a_finished_one_beside_it_is_left(tmp_path: Path) -> None:
    data = leave_unfinished(tmp_path / name(0), 5)
    ((good, words),) = recover_directory(tmp_path, min_free_mb=1e12)
    assert not good
    assert "skipped" in words
    (tmp_path / name(0)).write_bytes(b"finished")
    ((good, words),) = recover_directory(tmp_path)
    assert not good
    assert "exists already" in words
    assert (tmp_path / (name(0) + ACTIVE)).read_bytes() == data
    with pytest.raises(DataError, match="none: cannot be read"):
        list(recover_directory(tmp_path / "none"))


def test_a_recovery_that_was_killed_is_ended_by_the_next_one(tmp_path: Path) -> None:
    active, out = tmp_path / (name(0) + ACTIVE), tmp_path / name(0)
    data = leave_unfinished(out, 5)
    part = tmp_path / (name(0) + ".part")
    part.write_bytes(b"half")  # killed while it copied
    ((good, _),) = recover_directory(tmp_path, min_free_mb=1e12)
    assert not good
    assert [path.name for path in tmp_path.iterdir()] == [active.name]
    assert all(good for good, _ in recover_directory(tmp_path))
    recovered = out.read_bytes()
    active.write_bytes(data)  # killed before the original was removed
    ((good, words),) = recover_directory(tmp_path)
    assert good, words
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert out.read_bytes() == recovered


def test_a_file_that_cannot_be_locked_is_removed_and_can_be_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lock is not there between creating the file and locking it: nothing is left behind then."""

    def busy(*_: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    with monkeypatch.context() as then:
        then.setattr("fcntl.flock", busy)
        with pytest.raises(DataError, match="temporarily unavailable"):
            RecordingWriter(tmp_path / "a.mcap", HEADER)
    with RecordingWriter(tmp_path / "a.mcap", HEADER) as writer:
        writer.read(Read(0.0, 0.0, b"x"))
    assert len(items(tmp_path / "a.mcap")) == 1

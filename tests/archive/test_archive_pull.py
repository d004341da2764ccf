"""Recordings of a store: listed, read back, fetched; names and sizes of others are not believed."""

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from fsspec.implementations.memory import MemoryFileSystem

from tactiled.archive.copies import pull, push
from tactiled.archive.store import StoredRecording, examine, open_store, stored_recordings
from tactiled.commands.archive import archive
from tactiled.errors import DataError, OperatorError, UnavailableError


@pytest.fixture
def url(tmp_path: Path) -> str:
    """Store with two recordings, of 300,000 and 5 bytes."""
    runs = tmp_path / "runs"
    (runs / "left").mkdir(parents=True)
    (runs / "a.mcap").write_bytes(os.urandom(300_000))
    (runs / "left" / "b.mcap").write_bytes(os.urandom(5))
    store, folder = open_store(f"file://{tmp_path}/store")
    list(push(runs, store, folder))
    return f"file://{tmp_path}/store"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(archive, arguments)


def lines(result: Result) -> list[dict[str, object]]:
    return [json.loads(line) for line in result.stdout.splitlines()]


def spoil(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[0] ^= 1
    path.write_bytes(data)


def test_list_prints_each_recording_with_its_size_and_digest(url: str, tmp_path: Path) -> None:
    (tmp_path / "store/a.mcap.sha256").write_bytes(b"cut")
    listed = run("list", url)
    assert listed.exit_code == 0
    assert [(line["name"], line["bytes"]) for line in lines(listed)] == [
        ("a.mcap", 300_000),
        ("left/b.mcap", 5),
    ]
    assert [len(str(line["sha256"])) for line in lines(listed)] == [0, 64]


def test_verify_finds_one_flipped_bit_and_an_unconfirmed_copy(url: str, tmp_path: Path) -> None:
    assert run("verify", url).exit_code == 0
    spoil(tmp_path / "store/a.mcap")
    (tmp_path / "store/left/b.mcap.sha256").unlink()
    verified = run("verify", url)
    assert verified.exit_code == 1
    assert {line["name"]: line["health"] for line in lines(verified)} == {
        "a.mcap": "damaged",
        "left/b.mcap": "unconfirmed",
    }
    assert "1 damaged, 1 unconfirmed" in verified.stderr


def test_verify_names_a_copy_that_cannot_be_read(tmp_path: Path) -> None:
    store, _ = open_store(f"file://{tmp_path}")
    health, reason = examine(store, StoredRecording("a.mcap", f"{tmp_path}/a.mcap", 5, "0" * 64))
    assert health == "unreadable"
    assert "FileNotFoundError" in reason


def test_pull_fetches_what_is_whole_and_nothing_else(url: str, tmp_path: Path) -> None:
    spoil(tmp_path / "store/a.mcap")
    back = tmp_path / "back"
    first = run("pull", url, "--to", str(back))
    assert first.exit_code == 1
    assert "1 fetched, 0 there already, 1 not fetched" in first.stderr
    assert [path.name for path in back.rglob("*") if path.is_file()] == ["b.mcap"]
    assert (back / "left/b.mcap").read_bytes() == (tmp_path / "runs/left/b.mcap").read_bytes()
    again = run("pull", url, "left/*", "--to", str(back))
    assert again.exit_code == 0
    assert "0 fetched, 1 there already" in again.stderr


def test_pull_replaces_no_file(url: str, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"mine")
    pulled = run("pull", url, "a.mcap", "--to", str(tmp_path))
    assert pulled.exit_code == 1
    assert "exists with other content" in pulled.stderr
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"


def test_pull_refuses_an_unconfirmed_copy(url: str, tmp_path: Path) -> None:
    (tmp_path / "store/a.mcap.sha256").unlink()
    pulled = run("pull", url, "a.mcap", "--to", str(tmp_path / "back"))
    assert pulled.exit_code == 1
    assert "push it again" in pulled.stderr


@pytest.mark.parametrize(
    "name", ["../evil.mcap", "/etc/evil.mcap", "a/../../evil.mcap", "line\nfeed.mcap", "x" * 1100 + ".mcap"]
)
def test_a_name_that_leads_out_of_the_directory_is_refused(name: str, tmp_path: Path) -> None:
    store = MemoryFileSystem(skip_instance_cache=True)
    store.pipe_file("/evil", b"evil")
    recording = StoredRecording(name, "/evil", 4, "4e2beb" + "0" * 58)
    (copy,) = pull(store, [recording], tmp_path / "to")
    assert (copy.state, "no name for a file" in copy.reason) == ("failed", True)
    assert not list(tmp_path.rglob("*.mcap"))


def test_a_file_that_is_longer_than_the_store_stated_ends_there(url: str, tmp_path: Path) -> None:
    store, folder = open_store(url)
    first = stored_recordings(store, folder)[0]
    liar = StoredRecording(first.name, first.remote, 10, first.sha256)
    (copy,) = pull(store, [liar], tmp_path / "to")
    assert (copy.state, "longer than the 10 bytes" in copy.reason) == ("failed", True)
    assert not [path for path in (tmp_path / "to").rglob("*") if path.is_file()]


def test_a_recording_beyond_the_free_space_is_not_begun(url: str, tmp_path: Path) -> None:
    store, folder = open_store(url)
    first = stored_recordings(store, folder)[0]
    (copy,) = pull(store, [StoredRecording(first.name, first.remote, 10**18, first.sha256)], tmp_path / "to")
    assert (copy.state, "has room for" in copy.reason) == ("failed", True)


def test_an_empty_store_an_unknown_name_and_no_url_are_errors(url: str, tmp_path: Path) -> None:
    (tmp_path / "nothing").mkdir()
    assert isinstance(run("verify", f"file://{tmp_path}/nothing").exception, DataError)
    assert isinstance(run("verify", url, "c.mcap").exception, DataError)
    with pytest.raises(OperatorError, match="URL store: give a URL"):
        open_store("store", "URL")


def test_a_store_that_cannot_be_listed_may_be_tried_again() -> None:
    class LostStore(MemoryFileSystem):  # type: ignore[misc]  # fsspec has no types
        """Store whose network is gone."""

        def find(self, *_: object, **__: object) -> dict[str, object]:
            raise ConnectionError("no route")

    with pytest.raises(UnavailableError, match="ConnectionError: no route"):
        stored_recordings(LostStore(skip_instance_cache=True), "/x")


def test_what_is_no_regular_file_is_named_and_never_opened(url: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "store/fifo.mcap")
    (tmp_path / "store/fifo.mcap.sha256").write_text("0" * 64)
    (tmp_path / "store/a.mcap.sha256").unlink()
    os.mkfifo(tmp_path / "store/a.mcap.sha256")
    (tmp_path / "store/link.mcap").symlink_to(tmp_path / "runs/a.mcap")  # a file, as its target is
    verified = run("verify", url)
    assert verified.exit_code == 1
    assert {line["name"]: (line["health"], line["reason"]) for line in lines(verified)} == {
        "a.mcap": ("unconfirmed", "no complete .sha256 beside it: push it again"),
        "fifo.mcap": ("unreadable", "skipped: not a regular file"),
        "left/b.mcap": ("whole", ""),
        "link.mcap": ("unconfirmed", "no complete .sha256 beside it: push it again"),
    }
    pulled = run("pull", url, "fifo.mcap", "--to", str(tmp_path / "back"))
    assert pulled.exit_code == 1
    assert "fifo.mcap is not a regular file" in pulled.stderr

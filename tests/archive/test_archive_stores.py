"""URLs of stores: those that cannot be opened, or could lose or multiply recordings, are refused."""

import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from fsspec.implementations.memory import MemoryFileSystem

from tactiled.archive.copies import push
from tactiled.archive.store import open_store
from tactiled.commands.archive import archive
from tactiled.errors import OperatorError, UnavailableError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Record directory with one finished recording."""
    runs = tmp_path / "runs"
    runs.mkdir()
    (runs / "a.mcap").write_bytes(os.urandom(5))
    return runs


def refusal(*arguments: str) -> OperatorError:
    """Run a command, and return why it was refused; the entry point ends with the exit code of that."""
    error = CliRunner().invoke(archive, arguments).exception
    assert isinstance(error, OperatorError), repr(error)
    return error


@pytest.mark.parametrize(
    "url", ["memory://x", "simplecache::s3://touch/x", "dir://x::memory://", "nope://x", "://x"]
)
def test_the_only_copy_is_never_left_to_a_store_that_may_end_with_the_command(folder: Path, url: str) -> None:
    error = refusal("push", str(folder), "--to", url, "--remove")
    assert error.exit_code == 2
    assert f"--to {url}" in str(error)
    assert "push without --remove" in str(error)
    assert (folder / "a.mcap").exists()


def test_a_store_that_lasts_may_have_the_only_copy(folder: Path, tmp_path: Path) -> None:
    pushed = CliRunner().invoke(
        archive, ["push", str(folder), "--to", f"file://{tmp_path}/store", "--remove"]
    )
    assert pushed.exit_code == 0
    assert (tmp_path / "store/a.mcap").exists()
    assert not (folder / "a.mcap").exists()


def test_a_store_in_memory_may_have_a_second_copy(folder: Path) -> None:
    pushed = CliRunner().invoke(archive, ["push", str(folder), "--to", "memory://second"])
    MemoryFileSystem.store.clear()
    assert pushed.exit_code == 0
    assert (folder / "a.mcap").exists()


@pytest.mark.parametrize("options", [[], ["--remove"]])
@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("file://{}/runs", "is inside"),
        ("file://{}/runs/store", "is inside"),
        ("local://{}/other/../runs/store", "is inside"),
        ("file://{}/link/store", "is inside"),
        ("simplecache::file://{}/runs/store", "is inside"),
        ("file://{}", "is inside this store"),
        ("file:///", "is inside this store"),
    ],
)
def test_a_store_and_a_directory_inside_each_other_are_refused(
    folder: Path, tmp_path: Path, place: str, reason: str, options: list[str]
) -> None:
    (tmp_path / "link").symlink_to(folder)
    error = refusal("push", str(folder), "--to", place.format(tmp_path), *options)
    assert error.exit_code == 2
    assert reason in str(error)
    assert [path.name for path in folder.rglob("*")] == ["a.mcap"]


def test_a_neighbour_whose_name_begins_alike_is_another_folder(folder: Path, tmp_path: Path) -> None:
    pushed = CliRunner().invoke(archive, ["push", str(folder), "--to", f"file://{tmp_path}/runs-copy"])
    assert pushed.exit_code == 0


@pytest.mark.parametrize("url", ["ftp://127.0.0.1:1/x", "zip://x::file:///no/such.zip"])
def test_a_store_that_cannot_be_opened_is_named(folder: Path, url: str) -> None:
    for arguments in (("push", str(folder), "--to", url), ("list", url), ("verify", url)):
        error = refusal(*arguments)
        assert isinstance(error, UnavailableError)
        assert error.exit_code == 1
        assert f"{url}: cannot be opened: " in str(error)


def test_a_file_that_is_no_zip_is_named(tmp_path: Path) -> None:
    (tmp_path / "no.zip").write_bytes(b"no zip")
    with pytest.raises(UnavailableError, match=r"no\.zip: cannot be opened: BadZipFile"):
        open_store(f"zip://x::file://{tmp_path}/no.zip")


@pytest.mark.parametrize("url", ["s3:///x", "s3a:////x", "gs:///x", "simplecache::s3:///x"])
def test_a_url_without_bucket_is_refused(url: str) -> None:
    error = refusal("verify", url)
    assert error.exit_code == 2
    assert "name the bucket first" in str(error)


def test_a_fifo_in_the_place_of_a_copy_is_not_opened(folder: Path, tmp_path: Path) -> None:
    (folder / "a.mcap").write_bytes(b"")
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    (tmp_path / "store/a.mcap").unlink()
    os.mkfifo(tmp_path / "store/a.mcap")
    (copy,) = push(folder, store, to, remove=True)
    assert (copy.state, "not a regular file" in copy.reason) == ("failed", True)
    assert (folder / "a.mcap").exists()

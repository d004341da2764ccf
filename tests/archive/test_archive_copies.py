"""Copies of recordings in an S3 server and in a folder: confirmed, resumed, never replaced, never lost."""

import contextlib
import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from fsspec.implementations.memory import MemoryFileSystem

from tactiled.archive.copies import Copy, pull, push
from tactiled.archive.store import StoredRecording, examine, open_store, stored_recordings
from tactiled.commands.archive import archive
from tactiled.errors import DataError, OperatorError, UnavailableError

SEAWEED_INNER_PORTS = (8181, 9101)  # Iceberg, Lance
WEED = Path(sys.executable).with_name("weed")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Record directory with two finished recordings and one that is being written."""
    runs = tmp_path / "runs"
    (runs / "left").mkdir(parents=True)
    (runs / "a.mcap").write_bytes(os.urandom(300_000))
    (runs / "left" / "b.mcap").write_bytes(os.urandom(5))
    (runs / "c.mcap.active").write_bytes(b"not yet")
    return runs


def states(copies: Iterator[Copy]) -> dict[str, str]:
    return {copy.path.name: copy.state for copy in copies}


def test_a_folder_gets_whole_files_that_sha256sum_confirms(folder: Path, tmp_path: Path) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    assert states(push(folder, store, to)) == {"a.mcap": "copied", "b.mcap": "copied"}
    checked = subprocess.run(["sha256sum", "-c", "a.mcap.sha256"], cwd=tmp_path / "store", check=False)
    assert checked.returncode == 0
    assert (tmp_path / "store/left/b.mcap").read_bytes() == (folder / "left/b.mcap").read_bytes()
    assert not list((tmp_path / "store").rglob("c.mcap*"))
    assert states(push(folder, store, to)) == {"a.mcap": "there already", "b.mcap": "there already"}


def test_an_unfinished_copy_is_made_anew(folder: Path, tmp_path: Path) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    (tmp_path / "store/a.mcap").write_bytes(b"half")
    (tmp_path / "store/a.mcap.sha256").unlink()
    assert states(push(folder, store, to))["a.mcap"] == "copied"
    assert (tmp_path / "store/a.mcap").read_bytes() == (folder / "a.mcap").read_bytes()


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_a_copy_that_the_store_has_damaged_since_is_made_anew_before_anything_is_removed(
    folder: Path, tmp_path: Path
) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    good = (folder / "a.mcap").read_bytes()
    list(push(folder, store, to))
    flip_a_bit(tmp_path / "store/a.mcap")
    assert states(push(folder, store, to, remove=True)) == {"a.mcap": "repaired", "b.mcap": "there already"}
    assert (tmp_path / "store/a.mcap").read_bytes() == good
    assert not (folder / "a.mcap").exists()


def damaged(data: bytes) -> bytes:
    """Return the data with another last byte, whatever that was."""
    return data[:-1] + bytes([data[-1] ^ 1])


class LossyStore(MemoryFileSystem):  # type: ignore[misc]  # fsspec has no types
    """Store that damages what it is given, as a full or failing disk behind it does."""

    store: dict[str, object] = {}  # its own, which MemoryFileSystem keeps in the class
    pseudo_dirs = [""]

    def put_file(self, lpath: str, rpath: str, **_: object) -> None:
        self.pipe_file(rpath, damaged(Path(lpath).read_bytes()))


@pytest.mark.parametrize("was_confirmed", [False, True])
def test_the_only_good_copy_stays_where_the_store_damages_whatever_it_is_given(
    folder: Path, *, was_confirmed: bool
) -> None:
    store, to = LossyStore(skip_instance_cache=True), f"/{was_confirmed}"
    for name in ("a.mcap", "left/b.mcap") if was_confirmed else ():
        data = (folder / name).read_bytes()
        store.pipe_file(f"{to}/{name}", damaged(data))
        store.pipe_file(f"{to}/{name}.sha256", f"{hashlib.sha256(data).hexdigest()}  {name}\n".encode())
    copies = list(push(folder, store, to, remove=True))
    assert [copy.state for copy in copies] == ["failed", "failed"]
    assert "read back" in copies[0].reason
    assert (folder / "a.mcap").exists()
    assert not [name for name in store.find(to) if name.endswith(".sha256")]


def test_another_recording_of_the_same_name_is_never_replaced(folder: Path, tmp_path: Path) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    before = (tmp_path / "store/a.mcap").read_bytes()
    (folder / "a.mcap").write_bytes(b"of another board")
    copies = {copy.path.name: copy for copy in push(folder, store, to, remove=True)}
    assert copies["a.mcap"].state == "failed"
    assert "folder of its own" in copies["a.mcap"].reason
    assert (tmp_path / "store/a.mcap").read_bytes() == before
    assert (folder / "a.mcap").exists()  # not confirmed, so kept
    assert not (folder / "left/b.mcap").exists()


def test_a_folder_is_no_copy_of_itself(folder: Path, tmp_path: Path) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    (tmp_path / "link").symlink_to(tmp_path / "store")
    for name in ("store", "link"):
        itself = open_store(f"file://{tmp_path}/{name}")[1]
        copies = list(push(tmp_path / "store", store, itself, remove=True))
        assert [copy.state for copy in copies] == ["failed", "failed"]
        assert "no other copy" in copies[0].reason
    assert (tmp_path / "store/a.mcap").exists()


@pytest.mark.parametrize("left", [b"", b"0123", b"\0" * 70])
def test_a_cut_confirmation_confirms_nothing(folder: Path, tmp_path: Path, left: bytes) -> None:
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    (tmp_path / "store/a.mcap.sha256").write_bytes(left)
    assert states(push(folder, store, to))["a.mcap"] == "copied"
    assert states(push(folder, store, to))["a.mcap"] == "there already"


def test_recordings_that_the_daemon_removes_meanwhile_are_passed_over(folder: Path, tmp_path: Path) -> None:
    (folder / "link.mcap").symlink_to(tmp_path / "nothing")
    store, to = open_store(f"file://{tmp_path}/store")
    copies = push(folder, store, to)
    assert next(copies).state == "copied"
    (folder / "left/b.mcap").unlink()
    assert [(copy.path.name, copy.state) for copy in copies] == [("b.mcap", "failed")]


def test_a_recording_that_changed_since_it_was_copied_stays(folder: Path) -> None:
    class SlowStore(MemoryFileSystem):  # type: ignore[misc]  # fsspec has no types
        """Store in whose time the recording grows."""

        store: dict[str, object] = {}
        pseudo_dirs = [""]

        def put_file(self, lpath: str, rpath: str, **_: object) -> None:
            self.pipe_file(rpath, Path(lpath).read_bytes())
            with Path(lpath).open("ab") as stream:
                stream.write(b"more")

    copies = list(push(folder, SlowStore(skip_instance_cache=True), "/store", remove=True))
    assert {copy.reason.split(" has ")[1] for copy in copies} == {"changed while it was copied"}
    assert (folder / "a.mcap").stat().st_size == 300_004


def test_a_store_without_bucket_is_refused() -> None:
    with pytest.raises(OperatorError, match="name a bucket"):
        open_store("memory://")


def free_ports(n: int) -> list[int]:
    probes = [socket.socket() for _ in range(n)]
    try:
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]
    finally:
        for probe in probes:
            probe.close()


@pytest.fixture
def another_seaweed() -> Iterator[None]:
    """Occupy the ports that SeaweedFS takes unasked, as another one on this host does."""
    with contextlib.ExitStack() as stack:
        for port in SEAWEED_INNER_PORTS:
            probe = stack.enter_context(socket.socket())
            with contextlib.suppress(OSError):  # there is another one
                probe.bind(("127.0.0.1", port))
                probe.listen()
        yield


@pytest.fixture
def s3(tmp_path: Path) -> Iterator[tuple[dict[str, str], subprocess.Popen[bytes]]]:
    """Environment of a client of an S3 server, and the server."""
    s3_port, master, volume, filer, *grpc = free_ports(8)
    (tmp_path / "s3").mkdir()
    ports = {"s3.port": s3_port, "master.port": master, "volume.port": volume, "filer.port": filer}
    ports |= dict(
        zip(("master.port.grpc", "volume.port.grpc", "filer.port.grpc", "s3.port.grpc"), grpc, strict=True)
    )
    command = [str(WEED), "server", f"-dir={tmp_path}/s3", "-s3", "-ip=127.0.0.1", "-ip.bind=127.0.0.1"]
    command += [f"-{name}={port}" for name, port in ports.items()]
    # Two services that nobody asked for, on ports of their own; and no statistics to its makers.
    command += ["-s3.port.iceberg=0", "-s3.port.lance=0", "-master.telemetry=false"]
    server = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", s3_port)) == 0:
                break
        time.sleep(0.1)
    environment = {
        **os.environ,
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{s3_port}",
        "AWS_ACCESS_KEY_ID": "any",
        "AWS_SECRET_ACCESS_KEY": "any",
        "AWS_MAX_ATTEMPTS": "1",
    }
    yield environment, server
    server.kill()
    server.wait()


@pytest.mark.system
@pytest.mark.usefixtures("another_seaweed")
def test_an_s3_server_gets_every_recording_and_what_it_did_not_get_stays(
    folder: Path, tmp_path: Path, s3: tuple[dict[str, str], subprocess.Popen[bytes]]
) -> None:
    environment, server = s3
    digest = hashlib.sha256((folder / "a.mcap").read_bytes()).hexdigest()
    spare = tmp_path / "spare"
    shutil.copytree(folder, spare)

    def archive(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "tactiled", "archive", *arguments]
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=90
        )

    def pushed(directory: Path, *options: str) -> subprocess.CompletedProcess[str]:
        return archive("push", str(directory), *options, "--to", "s3://touch/hand-3")

    for _ in range(20):  # the server opens its port before it serves
        first = pushed(folder, "--remove")
        if first.returncode == 0:
            break
        time.sleep(1)
    assert first.returncode == 0, first.stderr
    assert "not confirmed" not in first.stderr
    assert not (folder / "a.mcap").exists()
    assert (folder / "c.mcap.active").exists()
    read_back = (
        "import fsspec, hashlib; s, p = fsspec.core.url_to_fs('s3://touch/hand-3/a.mcap');"
        "print(hashlib.sha256(s.cat_file(p)).hexdigest(), s.cat_file(p + '.sha256').decode().split()[0])"
    )
    remote = subprocess.run(
        [sys.executable, "-c", read_back], env=environment, capture_output=True, text=True, check=True
    )
    assert remote.stdout.split() == [digest, digest]
    again = pushed(spare)
    assert (again.returncode, "0 copied, 2 there already" in again.stderr) == (0, True)
    verified = archive("verify", "s3://touch/hand-3")
    assert (verified.returncode, verified.stdout.count('"whole"')) == (0, 2)
    pulled = archive("pull", "s3://touch/hand-3", "a.mcap", "--to", str(tmp_path / "back"))
    assert (pulled.returncode, "1 fetched" in pulled.stderr) == (0, True)
    assert hashlib.sha256((tmp_path / "back/a.mcap").read_bytes()).hexdigest() == digest
    server.kill()
    server.wait()
    lost = pushed(spare, "--remove")
    assert lost.returncode == 1
    assert lost.stderr.count("not confirmed, kept here") == 2
    assert "Traceback" not in lost.stderr
    assert (spare / "a.mcap").exists()


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
    assert sorted(path.name for path in folder.rglob("*")) == ["a.mcap", "b.mcap", "c.mcap.active", "left"]


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
    copy, _ = push(folder, store, to, remove=True)
    assert (copy.state, "not a regular file" in copy.reason) == ("failed", True)
    assert (folder / "a.mcap").exists()


@pytest.fixture
def url(folder: Path, tmp_path: Path) -> str:
    """Store with two recordings, of 300,000 and 5 bytes."""
    store, to = open_store(f"file://{tmp_path}/store")
    list(push(folder, store, to))
    return f"file://{tmp_path}/store"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(archive, arguments)


def lines(result: Result) -> list[dict[str, object]]:
    return [json.loads(line) for line in result.stdout.splitlines()]


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
    flip_a_bit(tmp_path / "store/a.mcap")
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
    flip_a_bit(tmp_path / "store/a.mcap")
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

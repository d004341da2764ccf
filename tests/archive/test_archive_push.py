"""Copies of recordings in an S3 server and in a folder: confirmed, resumed, never replaced, never lost."""

import contextlib
import hashlib
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fsspec.implementations.memory import MemoryFileSystem

from tactiled.archive.copies import Copy, push
from tactiled.archive.store import open_store
from tactiled.errors import OperatorError

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


class LossyStore(MemoryFileSystem):  # type: ignore[misc]  # fsspec has no types
    """Store that damages what it is given, as a full or failing disk behind it does."""

    store: dict[str, object] = {}  # its own, which MemoryFileSystem keeps in the class
    pseudo_dirs = [""]

    def put_file(self, lpath: str, rpath: str, **_: object) -> None:
        self.pipe_file(rpath, Path(lpath).read_bytes()[:-1] + b"?")


@pytest.mark.parametrize("was_confirmed", [False, True])
def test_the_only_good_copy_stays_where_the_store_damages_whatever_it_is_given(
    folder: Path, *, was_confirmed: bool
) -> None:
    store, to = LossyStore(skip_instance_cache=True), f"/{was_confirmed}"
    for name in ("a.mcap", "left/b.mcap") if was_confirmed else ():
        data = (folder / name).read_bytes()
        store.pipe_file(f"{to}/{name}", data[:-1] + b"?")
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

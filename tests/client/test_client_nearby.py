"""Search for the daemon of this host, and the message for a user who may not command it."""

import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tactiled.client import nearby
from tactiled.errors import OperatorError
from tactiled.events.endpoints import control_endpoint


class Host:
    """Directories of a host, and daemons that listen there."""

    def __init__(self, root: Path, stack: ExitStack) -> None:
        self.units = root / "units"
        self.environ = {"XDG_RUNTIME_DIR": str(root / "session")}
        self.own = root / "session/tactiled"
        self._stack = stack

    def listen(self, folder: Path, name: str) -> str:
        folder.mkdir(parents=True, exist_ok=True)
        sock = self._stack.enter_context(socket.socket(socket.AF_UNIX))
        sock.bind(str(folder / name))
        sock.listen()
        return f"ipc://{folder}/{name}"

    def serve(self, folder: Path, name: str = "events.ipc") -> str:
        """Listen as a daemon with this socket for events does; return the endpoint for requests."""
        self.listen(folder, name)
        return self.listen(folder, control_endpoint(f"ipc://{name}").removeprefix("ipc://"))

    def find(self) -> str:
        return nearby.control(self.environ, self.units)


@pytest.fixture
def host() -> Iterator[Host]:
    with ExitStack() as stack:
        root = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        root.chmod(0o755)  # pytest's own folders are closed to other users
        yield Host(root, stack)


def test_the_only_daemon_is_found_for_any_user(host: Host) -> None:
    (host.units / "TS0009").mkdir(parents=True)  # a unit whose daemon is starting
    endpoint = host.serve(host.units / "TS0001")
    assert host.find() == endpoint


def test_a_daemon_that_takes_no_connection_now_is_found_at_once(host: Host) -> None:
    with ExitStack() as stack:
        endpoint = host.serve(host.own)
        full = False
        while not full:
            waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
            waiting.setblocking(False)
            full = waiting.connect_ex(endpoint.removeprefix("ipc://")) != 0
        assert host.find() == endpoint


def test_our_own_daemon_is_found(host: Host) -> None:
    endpoint = host.serve(host.own)
    assert host.find() == endpoint


@pytest.mark.parametrize("name", ["left-events.ipc", "a.ipc", "control-events.ipc"])
def test_an_endpoint_of_another_name_is_found_and_named_by_its_events(host: Host, name: str) -> None:
    endpoint = host.serve(host.own, name)
    assert host.find() == endpoint
    host.serve(host.units / "TS0001")
    with pytest.raises(
        OperatorError, match=rf"one of ipc://.*/tactiled/{name}, ipc://.*/TS0001/events\.ipc$"
    ):
        host.find()


def test_a_daemon_with_two_endpoints_is_one(host: Host) -> None:
    host.serve(host.own, "also-events.ipc")
    assert host.serve(host.own) == host.find()


def test_of_two_endpoints_of_other_names_one_must_be_named(host: Host) -> None:
    """They may be of two daemons, and a command to the wrong one moves another hand."""
    host.serve(host.own, "left-events.ipc")
    host.serve(host.own, "right-events.ipc")
    with pytest.raises(OperatorError, match=r"one of ipc://.*/left-events\.ipc, ipc://.*/right-events\.ipc$"):
        host.find()


def test_what_is_no_folder_is_no_daemon(host: Host) -> None:
    host.own.parent.mkdir(parents=True)
    host.own.touch()
    with pytest.raises(OperatorError, match="no daemon"):
        host.find()


def test_of_several_one_must_be_named(host: Host) -> None:
    host.serve(host.own)
    host.serve(host.units / "TS0001")
    with pytest.raises(
        OperatorError, match=r"several daemons.*--endpoint.*session/tactiled/events\.ipc.*TS0001"
    ):
        host.find()


def test_the_error_says_that_no_daemon_runs(host: Host) -> None:
    with pytest.raises(OperatorError, match=r"no daemon.*session/tactiled or .*units/\*.*publish\.endpoints"):
        host.find()
    folder = host.units / "TS0001"
    folder.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(folder / "control.ipc"))
        host.listen(folder, "events.ipc")
    with pytest.raises(OperatorError, match="no daemon"):
        host.find()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs another user")
def test_the_error_names_the_group_that_may_connect(host: Host) -> None:
    host.serve(host.units / "TS0001")
    (host.units / "TS0001").chmod(0o750)
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(12345)
            os.setuid(12345)
            host.find()
        except OperatorError as error:
            os._exit(0 if "usermod -aG tactiled" in str(error) else 1)
        finally:
            os._exit(2)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_a_folder_that_somebody_else_made_in_our_place_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    uid = os.getuid()
    with ExitStack() as stack, tempfile.TemporaryDirectory() as root:
        host = Host(Path(root), stack)
        endpoint = host.serve(host.own)
        assert host.find() == endpoint
        monkeypatch.setattr(os, "getuid", lambda: uid + 1)
        with pytest.raises(OperatorError, match="no daemon"):
            host.find()

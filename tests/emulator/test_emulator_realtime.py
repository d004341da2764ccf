"""The emulator in real time: pty, TCP, unplugging, signals. No tight timing: the machine may be busy."""

import contextlib
import errno
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from patience import PATIENCE_S

from tactiled.emulator.line.faults import FaultAt, FaultParams
from tactiled.emulator.line.links import PtyLink, SocketLink, make_control_link, make_tcp_link
from tactiled.emulator.realtime import Emulator
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import ConfigError
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Hello, Scan
from tactiled.wire.layout import Layout, compile_layout, load_layout

V1 = load_layout("board-v1")
DEMO = load_scene("prescribed")
START = Encoder(V1).encode(Command("start", 1))

Reports = list[dict[str, Any]]


@contextlib.contextmanager
def emulated(
    link: PtyLink | SocketLink, layout: Layout = V1, *, scan_takes_s: float = 0.0, **options: Any
) -> Iterator[tuple[Emulator, Reports]]:
    """An emulator in a thread, and what it reports; with scans, each can take long to compute."""
    reports: Reports = []

    def report(what: dict[str, Any]) -> None:
        if what["what"] == "scan":
            time.sleep(scan_takes_s)
        reports.append(what)

    emulator = Emulator(DEMO, layout, link, report=report, **options)
    thread = threading.Thread(target=emulator.run)
    thread.start()
    try:
        wait_for(lambda: bool(reports), "ready")
        yield emulator, reports
    finally:
        emulator.stop()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"no {what} within {PATIENCE_S} s"
        time.sleep(0.005)


def what(reports: Reports, kind: str) -> Reports:
    return [report for report in reports if report["what"] == kind]


class Host:
    """The host's end of a port, as a descriptor."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._decoder = Decoder(V1)

    def start(self) -> None:
        """Wait for the hello: a board that boots hears nothing. Then start it."""
        self.read(lambda items: any(isinstance(item, Hello) for item in items))
        os.write(self.fd, START)

    def read(self, enough: Callable[[list[Any]], bool]) -> list[Any]:
        """Frames until there are enough; an empty read ends, as for a port that is gone."""
        items: list[Any] = []
        deadline = time.monotonic() + PATIENCE_S
        while not enough(items):
            assert select.select([self.fd], [], [], max(0.0, deadline - time.monotonic()))[0], items
            try:
                data = os.read(self.fd, 4096)
            except OSError:
                data = b""
            if not data:
                return items
            items += self._decoder.feed(data)
        return items


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Host]:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        yield Host(fd)
    finally:
        os.close(fd)


def scans(items: list[Any]) -> list[Scan]:
    return [item for item in items if isinstance(item, Scan)]


def test_a_pty_under_its_link_is_paced_by_the_clock(tmp_path: Path) -> None:
    link = tmp_path / "board"
    with emulated(PtyLink(link), with_scans=True) as (_, reports), opened(link) as host:
        before_s = time.monotonic()
        host.start()
        items = host.read(lambda items: len(scans(items)) >= 100)
        after_s = time.monotonic()
    assert isinstance(items[0], Acknowledge)
    assert [s.sequence for s in scans(items)][:100] == list(range(100))
    assert after_s - before_s > 0.99  # 100 scans at 100 Hz
    (scene,) = what(reports, "scene")
    assert before_s < scene["t0_s"] < after_s - 0.99
    assert scene["slips"][0]["onset_s"] == scene["t0_s"] + 6.0
    truths = what(reports, "scan")
    assert truths[0]["began_s"] == pytest.approx(scene["t0_s"])
    assert [t["sequence"] for t in truths] == list(range(len(truths)))
    json.dumps(reports)
    assert not os.path.lexists(link)
    assert what(reports, "end")[0]["counts"]["frames_damaged"] == 0


def test_unplugging_closes_the_port_and_brings_it_back_under_the_same_name(tmp_path: Path) -> None:
    link = tmp_path / "board"
    with emulated(PtyLink(link), faults=FaultParams(unplug_s=0.5)) as (emulator, reports):
        with opened(link) as host:
            host.start()
            first = scans(host.read(lambda items: len(scans(items)) > 5))
            emulator.inflict("unplug")
            first += scans(host.read(lambda _: False))  # until the port is gone
        wait_for(lambda: bool(what(reports, "unplugged")), "unplugging")
        wait_for(lambda: bool(what(reports, "plugged")), "replugging")
        with opened(link) as host:
            again = scans(host.read(lambda items: len(scans(items)) > 5))
    assert again[0].sequence > first[-1].sequence + 20  # the board ran on meanwhile
    assert [report["what"] for report in reports if report["what"] != "scene"] == [
        "ready", "unplugged", "plugged", "end",
    ]  # fmt: skip
    assert not os.path.lexists(link)


def test_a_host_that_does_not_read_does_not_block_the_emulator(tmp_path: Path) -> None:
    link = tmp_path / "board"
    # A line this fast is no bottleneck: what does not go out is what the pty does not take.
    fast = compile_layout(V1.file.model_copy(update={"baud": 100_000_000}))
    with emulated(PtyLink(link), fast, with_scans=True) as (_, reports), opened(link) as host:
        host.start()
        wait_for(lambda: bool(what(reports, "scene")), "scene")
        # Each hello is 140 bytes, and nobody reads: far more than any pty holds.
        identify = b"".join(Encoder(V1).encode(Command("identify", token)) for token in range(200))
        for _ in range(5):
            os.write(host.fd, identify)
        wait_for(lambda: len(what(reports, "scan")) > 100, "scans meanwhile")
    counts = what(reports, "end")[0]["counts"]
    assert counts["bytes_in"] > 5 * 200 * 140
    assert counts["bytes_overflowed"] > 0


def test_a_scene_slower_than_real_time_sends_each_scan_before_it_computes_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, control = PtyLink(tmp_path / "board"), make_control_link(f"unix://{tmp_path}/control")
    write = link.write
    late: dict[str, Any] = {"with_scans": True, "scan_takes_s": 0.03}  # three periods
    with emulated(link, control=control, **late) as (emulator, reports), opened(tmp_path / "board") as host:

        def sent(data: bytes) -> int:
            reports.append({"what": "sent"})
            return write(data)

        monkeypatch.setattr(link, "write", sent)
        host.start()
        first = scans(host.read(lambda items: len(scans(items)) >= 20))
        with socket.socket(socket.AF_UNIX) as peer:
            peer.settimeout(PATIENCE_S)
            peer.connect(str(tmp_path / "control"))
            peer.sendall(b"{}\n")
            asked_s = json.loads(peer.recv(4096))["scene_s"]
        computed = len(what(reports, "scan"))
        os.write(host.fd, Encoder(V1).encode(Command("stop", 2)))
        rest = host.read(lambda items: any(isinstance(item, Acknowledge) for item in items))
        assert 0.19 < asked_s < 0.01 * (computed + 2)  # where the board is, not the clock
        assert [s.sequence for s in first + scans(rest)] == list(range(len(first + scans(rest))))
        assert len(scans(rest)) > 20  # up to the instant of the command, a multiple of the first
        os.write(host.fd, Encoder(V1).encode(Command("start", 3)))
        host.read(lambda items: len(scans(items)) >= 20)
        emulator.stop()
        computed = len(what(reports, "scan"))
    assert len(what(reports, "scan")) <= computed + 1
    assert what(reports, "behind")
    assert all(report["behind_s"] > 0.5 for report in what(reports, "behind"))
    kinds = [report["what"] for report in reports if report["what"] in ("scan", "sent")]
    # The last bytes of a scan may be on the line when the next scan instant is due, but no later.
    assert all("sent" in three for three in zip(kinds, kinds[1:], kinds[2:], strict=False))


def test_a_board_is_powered_up_when_its_tables_are_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the hellos and the faults of that time come at once, and the host is called too slow."""
    at_s: dict[str, float] = {}

    def report(what: dict[str, Any]) -> None:
        at_s[what["what"]] = time.monotonic()
        if what["what"] == "unplugged":
            emulator.stop()

    monkeypatch.setattr(Emulator, "_solve_tables", lambda _: time.sleep(1.2))
    faults = FaultParams(at=[FaultAt(kind="unplug", at_s=1.0)])
    emulator = Emulator(DEMO, V1, PtyLink(tmp_path / "board"), faults=faults, report=report)
    emulator.run_until_signal()
    assert at_s["unplugged"] - at_s["ready"] > 0.9


def test_hosts_come_and_go_on_a_pty(tmp_path: Path) -> None:
    link = tmp_path / "board"
    with emulated(PtyLink(link)):
        with opened(link) as host:
            host.start()
            last = scans(host.read(lambda items: len(scans(items)) > 3))[-1]
        with opened(link) as host:
            tty.setraw(host.fd)
            later = scans(host.read(lambda items: len(scans(items)) > 3))[-1]
    assert later.sequence > last.sequence


def test_a_tcp_port_serves_one_host_at_a_time() -> None:
    with emulated(SocketLink("tcp", ("127.0.0.1", 0))) as (_, reports):
        port = int(reports[0]["link"].rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as connection:
            host = Host(connection.fileno())
            host.start()
            assert len(scans(host.read(lambda items: len(scans(items)) >= 5))) >= 5
            with socket.create_connection(("127.0.0.1", port)) as second:
                second.settimeout(PATIENCE_S)
                assert second.recv(10) == b""
        with socket.create_connection(("127.0.0.1", port)) as connection:
            assert scans(Host(connection.fileno()).read(lambda items: len(scans(items)) > 0))


def test_unplugging_a_tcp_port_hangs_up_and_listens_again() -> None:
    with emulated(SocketLink("tcp", ("127.0.0.1", 0)), faults=FaultParams(unplug_s=0.3)) as (
        emulator,
        reports,
    ):
        port = int(reports[0]["link"].rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as connection:
            host = Host(connection.fileno())
            host.read(lambda items: bool(items))  # the hello
            emulator.inflict("unplug")
            host.read(lambda _: False)
        wait_for(lambda: bool(what(reports, "plugged")), "replugging")
        assert what(reports, "plugged")[0]["link"] == reports[0]["link"]
        with socket.create_connection(("127.0.0.1", port)) as connection:
            host = Host(connection.fileno())
            host.start()
            assert scans(host.read(lambda items: len(scans(items)) > 0))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_emulator_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    link = tmp_path / "board"
    program = (
        "import json, sys; from pathlib import Path\n"
        "from tactiled.emulator.scene.description import load_scene\n"
        "from tactiled.emulator.line.links import PtyLink\n"
        "from tactiled.emulator.realtime import Emulator\n"
        "from tactiled.wire.layout import load_layout\n"
        "Emulator(load_scene('rest'), load_layout('board-v1'), PtyLink(Path(sys.argv[1])),\n"
        "         report=lambda report: print(json.dumps(report), flush=True)).run_until_signal()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(link)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["what"] == "ready"
    assert link.is_symlink()
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert err == ""
    assert json.loads(out.splitlines()[-1])["what"] == "end"
    assert not os.path.lexists(link)


def test_a_stale_link_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    link = tmp_path / "board"
    link.symlink_to(tmp_path / "gone")
    with emulated(PtyLink(link)):
        assert str(link.readlink()).startswith("/dev/")
    link.write_text("precious")
    with pytest.raises(ConfigError, match="is no symbolic link"):
        Emulator(DEMO, V1, PtyLink(link), report=lambda _: None).run()
    assert link.read_text() == "precious"
    with pytest.raises(ConfigError, match="No such file"):
        Emulator(DEMO, V1, PtyLink(tmp_path / "no" / "folder"), report=lambda _: None).run()


@pytest.mark.parametrize(
    "tcp",
    [
        "127.0.0.1",
        "tcp://:99",
        "tcp://127.0.0.1:http",
        "tcp://127.0.0.1:70000",
        "unix:///tmp/x",
        "unix://x:99",
    ],
)
def test_addresses_of_another_form_are_refused(tcp: str) -> None:
    with pytest.raises(ConfigError, match=r"tcp: .* not of the form tcp://HOST:PORT$"):
        make_tcp_link(tcp)


@pytest.mark.parametrize("address", ["unix://", "tcp://127.0.0.1:99", "/tmp/x"])
def test_addresses_for_a_controller_of_another_form_are_refused(address: str) -> None:
    with pytest.raises(ConfigError, match=r"control: .* not of the form unix:///PATH$"):
        make_control_link(address)


def test_an_unfinished_line_of_a_controller_ends_with_it(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with emulated(PtyLink(tmp_path / "board"), control=make_control_link(f"unix://{path}")):
        with socket.socket(socket.AF_UNIX) as killed:
            killed.connect(str(path))
            killed.sendall(b'{}\n{"grip_n": 3')
            assert killed.recv(4096)
        with socket.socket(socket.AF_UNIX) as peer:
            peer.connect(str(path))
            peer.sendall(b"{}\n")
            assert json.loads(peer.recv(4096))["ok"]


def test_a_stop_after_the_end_writes_into_no_other_file(tmp_path: Path) -> None:
    with emulated(PtyLink(tmp_path / "board")) as (emulator, _):
        pass
    paths = [tmp_path / str(k) for k in range(20)]
    with contextlib.ExitStack() as stack:
        for path in paths:  # descriptors that were freed are taken
            stack.enter_context(path.open("wb"))
        emulator.stop()
    assert all(path.read_bytes() == b"" for path in paths)


def test_a_peer_at_an_ipv6_address_is_accepted_and_may_vanish(monkeypatch: pytest.MonkeyPatch) -> None:
    link = make_tcp_link("tcp://[::1]:0")
    try:
        link.open()
    except ConfigError:
        pytest.skip("this host has no IPv6")
    address = link.describe()["link"]
    assert address.startswith("socket://[::1]:")
    with socket.create_connection(("::1", int(address.rpartition(":")[2]))) as peer:
        wait_for(lambda: bool(link.read() or link.n_peers), "peer")
        peer.sendall(b"hello")
        wait_for(lambda: link.read() == b"hello", "bytes")
        gone = mock.Mock(wraps=link._client)  # noqa: SLF001  no test can cut a cable
        gone.recv.side_effect = TimeoutError(errno.ETIMEDOUT, "Connection timed out")
        monkeypatch.setattr(link, "_client", gone)
        assert link.read() == b""
    link.close()


def test_a_socket_of_a_living_process_is_not_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "control"
    first, second = make_control_link(f"unix://{path}"), make_control_link(f"unix://{path}")
    first.open()
    with pytest.raises(
        ConfigError, match=r"control: cannot listen on .*control: another process listens there"
    ):
        second.open()
    second.close()
    assert path.is_socket()
    first.close()
    assert not path.exists()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    second.open()
    second.close()


def test_ports_that_cannot_be_made_are_refused(tmp_path: Path) -> None:
    def report(what: dict[str, Any]) -> None:
        raise AssertionError(what)  # that it is ready

    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        control = make_control_link(f"unix://{tmp_path}")
        for link, controlled, says in (
            (make_tcp_link(address), None, "tcp: cannot listen"),
            (PtyLink(tmp_path / "board"), control, "control: cannot listen"),
            (PtyLink(tmp_path / "no" / "folder"), None, "link: cannot make"),
        ):
            with pytest.raises(ConfigError, match=says):
                Emulator(DEMO, V1, link, report=report, control=controlled).run()
    assert not os.path.lexists(tmp_path / "board")

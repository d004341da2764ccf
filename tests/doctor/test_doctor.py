"""The doctor on a good set-up and on broken ones: every fault is named, with what to do."""

import json
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import msgpack
import pytest
import zmq
from commands import call
from messages import STATUS
from uart import received_at

from tactiled.config import Setup, load_config
from tactiled.daemon.serial import device
from tactiled.daemon.serial.port import open_port
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.security import KeyFolder
from tactiled.doctor import board as board_checks
from tactiled.doctor.board import LISTEN_S, check_board, check_rate
from tactiled.doctor.examine import examine
from tactiled.doctor.finding import Finding
from tactiled.doctor.host import (
    check_daemon,
    check_disk,
    check_endpoints,
    running_daemon,
)
from tactiled.doctor.port import check_port
from tactiled.doctor.unplugged import check_files, check_keys
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.line.links import PtyLink
from tactiled.emulator.realtime import Emulator
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import ConfigError
from tactiled.events.codec import encode
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Scan
from tactiled.wire.layout import load_layout

LAYOUT = load_layout("board-v1")


class AtAnotherRate(PtyLink):
    """A pty whose board sends at `sent_baud`, whatever the host has set."""

    def __init__(self, path: Path, sent_baud: int) -> None:
        super().__init__(path)
        self._sent_baud = sent_baud
        self.rates = {getattr(termios, f"B{rate}"): rate for rate in (9600, 57600, 115200, 230400, 460800)}

    def write(self, data: bytes) -> int:
        set_baud = self.rates.get(termios.tcgetattr(self._slave)[5], self._sent_baud / 7)
        super().write(received_at(data, self._sent_baud, set_baud)[0])
        return len(data)


@contextmanager
def emulated(
    path: Path,
    *,
    layout: str = "board-v1",
    link: PtyLink | None = None,
    board: EmulatedBoardParams | None = None,
    faults: FaultParams | None = None,
) -> Iterator[None]:
    """A board on a pty."""
    scene = load_scene("rest")
    if layout == "legacy-9":
        scene = scene.model_copy(update={"array": "normal-3x3"})
    emulator = Emulator(
        scene, load_layout(layout), link or PtyLink(path), board=board, faults=faults, report=lambda _: None
    )
    thread = threading.Thread(target=emulator.run)
    thread.start()
    try:
        while not path.exists():
            assert thread.is_alive()
        yield
    finally:
        emulator.stop()
        thread.join()


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "tactiled.toml"
    path.write_text(
        f'[port]\nurl = "{tmp_path}/board"\n[publish]\nendpoints = ["ipc://{tmp_path}/events.ipc"]\n'
        f'[record]\ndirectory = "{tmp_path}"\nmin_free_mb = 0.0\n'
    )
    return path


@pytest.fixture
def setup(config: Path) -> Setup:
    return load_config(config)


def by_check(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.check: finding for finding in findings}


def failed(findings: list[Finding]) -> list[str]:
    return [f"{f.check}: {f.words}" for f in findings if f.verdict == "fail"]


def test_a_good_set_up_passes_and_the_board_is_left_idle(config: Path, tmp_path: Path) -> None:
    with emulated(tmp_path / "board"):
        for _ in range(2):  # the second time too: the first left nothing behind
            findings = by_check(examine(config, None))
            assert failed(list(findings.values())) == []
    assert "TS0001" in findings["board"].words
    assert "100.0 scans" in findings["rate"].words or "scans a second" in findings["rate"].words
    for check in (
        "configuration",
        "port",
        "line",
        "board",
        "rate",
        "clock",
        "grooves",
        "disk",
        "endpoint",
    ):
        assert findings[check].verdict == "ok", findings[check]


def test_the_report_is_text_or_json_lines(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("doctor", "--config", str(config), "--json") == 1
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["verdict"] for row in rows} <= {"ok", "warn", "fail"}
    (port,) = [row for row in rows if row["check"] == "port"]
    assert port["verdict"] == "fail"
    assert "no such port" in port["words"]
    assert call("doctor", "--config", str(config)) == 1
    text = capsys.readouterr().out
    assert "fail  port" in text
    assert text.splitlines()[-1].startswith(f"{len(rows)} checks: 1 fail")


def test_a_broken_set_up_has_every_fault_named(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text('[port]\nurl = "/dev/ttyUSB77"\nbauds = 3\n[session]\nrate = 100\n')
    faults = failed(examine(path, None))
    assert any("port.bauds: unknown key" in fault for fault in faults)
    assert any("use rate_hz" in fault for fault in faults)
    assert any("/dev/ttyUSB77: no such port" in fault for fault in faults)
    assert "not checked" in by_check(examine(path, None))["the rest"].words
    path.write_text(
        f'[port]\nurl = "{tmp_path}/none"\n[record]\ndirectory = "{tmp_path}/nowhere"\n'
        f'[publish]\nendpoints = ["ipc://{tmp_path}/no/such/folder.ipc"]\n'
    )
    checks = {fault.split(":")[0] for fault in failed(examine(path, None))}
    assert checks == {"port", "disk", "endpoint"}


def test_a_wrong_baud_rate_is_found_and_the_right_one_named(setup: Setup, tmp_path: Path) -> None:
    with emulated(
        tmp_path / "board",
        link=AtAnotherRate(tmp_path / "board", 57600),
        board=EmulatedBoardParams(rate_hz=50.0),
    ):
        findings, _ = check_board(setup)
    faults = failed(findings)
    assert any("wrong baud rate (115200 configured)" in fault for fault in faults)
    assert not any("tactiled doctor" in finding.line for finding in findings)  # it is what runs
    assert "search: the board sends frames of board-v1 at 57600 baud" in faults


def test_another_protocol_is_named(setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board_checks, "_TRY_S", 0.2)
    with emulated(tmp_path / "board", layout="legacy-9"):
        findings, _ = check_board(setup)
    assert "search: the board sends frames of legacy-9" in failed(findings)
    assert by_check(findings)["search"].remedy == 'set board.protocol = "legacy-9"'


def test_a_silent_board_and_a_wrong_board_have_different_findings(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_checks, "_TRY_S", 0.02)

    class Silent(PtyLink):
        def write(self, data: bytes) -> int:
            return len(data)

    with emulated(tmp_path / "board", link=Silent(tmp_path / "board")):
        faults = failed(check_board(setup)[0])
    assert any("no bytes arrive: is the board powered" in fault for fault in faults)
    with emulated(tmp_path / "board", board=EmulatedBoardParams(board_serial="TS0009")):
        pinned = setup.config.session.model_copy(update={"board_serial": "TS0001"})
        other = replace(setup, config=setup.config.model_copy(update={"session": pinned}))
        (fault,) = failed(check_board(other)[0])
    assert "board TS0009 is plugged in, board TS0001 is configured" in fault


class LateScans(PtyLink):
    """A pty on which the first scans are lost, for longer than a board is listened to."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._decoder, self._from_s = Decoder(LAYOUT), 0.0

    def write(self, data: bytes) -> int:
        if any(isinstance(frame, Scan) for frame in self._decoder.feed(data)):
            self._from_s = self._from_s or time.monotonic() + LISTEN_S + 0.5
            if time.monotonic() < self._from_s:
                return len(data)
        return super().write(data)


def test_a_board_whose_scans_come_late_is_waited_for(setup: Setup, tmp_path: Path) -> None:
    with emulated(tmp_path / "board", link=LateScans(tmp_path / "board")):
        findings, rate_hz = check_board(setup)
    assert failed(findings) == []
    assert by_check(findings)["board"].verdict == "ok"
    assert rate_hz == 100.0


def test_scans_that_wait_at_first_do_not_change_the_rate() -> None:
    late_s = [n * 0.01 + max(0.0, 0.042 - n * 0.002) for n in range(120)]
    assert check_rate(late_s, 100.0).words.startswith("100.0 scans a second arrive")
    assert check_rate(late_s, 100.0).verdict == "ok"
    assert check_rate(late_s, 95.0).verdict == "warn"
    assert check_rate([0.0, 0.5], 2.0).verdict == "ok"


def test_a_noisy_line_is_a_warning(setup: Setup, tmp_path: Path) -> None:
    with emulated(tmp_path / "board", faults=FaultParams(flip_per_byte=1e-3)):
        findings, _ = check_board(setup)
    line = by_check(findings)["line"]
    assert line.verdict == "warn"
    assert "noise" in line.remedy


def test_a_path_that_is_no_serial_port_fails(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    assert "not a serial port" in failed(check_port(str(tmp_path / "file")))[0]
    assert "is a directory" in failed(check_port(str(tmp_path)))[0]
    assert "not known" in failed(check_port("usb://x"))[0]
    assert failed(check_port("socket://robot:7000")) == []


def test_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    permission = by_check(check_port("/dev/null"))["permission"]
    assert permission.verdict == "fail"
    assert "sudo usermod -aG" in permission.remedy


def test_an_unstable_port_name_and_a_slow_latency_timer_are_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "stable_name", lambda _: Path("/dev/serial/by-id/usb-FTDI_X-if00"))
    monkeypatch.setattr(device, "latency_ms", lambda _: 16)
    findings = by_check(check_port("/dev/null"))
    assert findings["name"].remedy == 'set port.url = "/dev/serial/by-id/usb-FTDI_X-if00"'
    assert "every 16 ms" in findings["latency timer"].words
    assert "99-tactiled.rules" in findings["latency timer"].remedy


def test_endpoints_bound_by_another_program_fail(setup: Setup) -> None:
    publish = setup.config.publish
    assert failed(check_endpoints(publish, daemon_runs=False)) == []
    with zmq.Context() as context, context.socket(zmq.PUB) as taken:
        taken.bind(publish.endpoints[0])
        assert running_daemon(publish) is None
        (fault,) = failed(check_endpoints(publish, daemon_runs=False))
        unasked = check_endpoints(publish, daemon_runs=False, is_configured=False)
    assert "in use" in fault
    assert [finding.verdict for finding in unasked].count("warn") == 1
    assert failed(unasked) == []


@contextmanager
def publisher(endpoint: str, messages: Sequence[Sequence[bytes]]) -> Iterator[None]:
    """A publisher of these messages, again and again."""
    is_over = threading.Event()

    def flood() -> None:
        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            socket.bind(endpoint)
            while not is_over.is_set():
                for message in messages:
                    socket.send_multipart(message)
                time.sleep(1e-4)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def test_statuses_of_a_foreign_publisher_are_no_daemon(tmp_path: Path) -> None:
    publish = PublishParams(endpoints=[f"ipc://{tmp_path}/events.ipc"])
    status = {"v": 1, "seq": 0, "run": 0, "board": "x", "timestamp": 0.0}
    payloads = (b"\xff", msgpack.packb(status))
    with publisher(publish.endpoints[0], [(b"tactile/x/status", payload) for payload in payloads]):
        assert running_daemon(publish) is None


def test_of_several_boards_of_a_daemon_the_configured_one_is_judged(tmp_path: Path) -> None:
    publish = PublishParams(endpoints=[f"ipc://{tmp_path}/events.ipc"])
    gone = replace(STATUS, state="no-device", valid=False, reason="no such port")
    boards = {"RIGHT": gone, "LEFT": STATUS}
    sent = [
        encode(event, seq=seq, board=board, unix_offset_s=0.0)
        for seq in range(2)
        for board, event in boards.items()
    ]
    with publisher(publish.endpoints[0], sent):
        for board, state in (("LEFT", "running"), ("RIGHT", "no-device")):
            status = running_daemon(publish, board)
            assert status is not None
            assert (status["board"], status["state"]) == (board, state)
        unknown = running_daemon(publish, "THUMB")
    assert unknown is not None
    assert unknown["board"] in boards


def test_a_daemon_that_reads_another_port_is_a_failure(tmp_path: Path) -> None:
    path = tmp_path / "board"
    status = {"board": "TS0002", "state": "running", "reason": "", "valid": True}
    with emulated(path):
        other, is_ours = check_daemon(status, str(path))
        assert (other.verdict, is_ours) == ("fail", False)
        assert f"does not read {path}" in other.words
        assert check_daemon(status, str(path), is_configured=False)[0].verdict == "warn"
        port = open_port(str(path), 115200)
        assert check_daemon(status, str(path)) == (
            Finding("daemon", "ok", "runs here: board TS0002 is running"),
            True,
        )
        port.close()
        gone = status | {"state": "no-device", "valid": False, "reason": "no such port"}
        assert check_daemon(gone, str(path))[1]


def test_keys(tmp_path: Path) -> None:
    folder = tmp_path / "keys"

    def verdict(endpoint: str = "tcp://0.0.0.0:9872") -> tuple[str, str]:
        (found,) = check_keys(PublishParams(endpoints=(endpoint,), keys=str(folder)))
        return found.verdict, found.line

    assert check_keys(PublishParams()) == []
    assert verdict() == (
        "fail",
        f"keys: {folder}: no such folder -> make one: tactiled keys make NAME --folder {folder}",
    )
    KeyFolder(folder).make("left-gripper", tmp_path / "left-gripper.toml")
    assert verdict() == ("ok", f"keys: {folder}: may connect from other hosts: left-gripper")
    assert "not used" in verdict("tcp://127.0.0.1:9872")[1]
    (folder / "daemon.toml").chmod(0o644)
    open_to_all = (
        f"keys: {folder}/daemon.toml: others can read the secret key: chmod 600 {folder}/daemon.toml"
    )
    assert verdict() == ("fail", open_to_all)
    (folder / "daemon.toml").chmod(0o600)
    (folder / "clients/left-gripper.toml").unlink()
    assert verdict()[0] == "warn"


def test_disk(setup: Setup) -> None:
    record = setup.config.record
    assert failed(check_disk(record)) == []
    (finding,) = check_disk(record.model_copy(update={"directory": None}))
    assert (finding.verdict, "nothing is recorded" in finding.words) == ("ok", True)
    full = check_disk(record.model_copy(update={"min_free_mb": 1e12}))
    assert "recording stops below" in failed(full)[0]
    assert "no such directory" in failed(check_disk(record.model_copy(update={"directory": "/no"})))[0]


def test_files_that_a_configuration_names_are_checked_without_a_board(setup: Setup, tmp_path: Path) -> None:
    config, folder = setup.config, tmp_path / "keys"

    def check(keys: Path | None, endpoint: str = "tcp://0.0.0.0:9872", **record: object) -> list[str]:
        publish = PublishParams(endpoints=(endpoint,), keys=None if keys is None else str(keys))
        tables = {"publish": publish, "record": config.record.model_copy(update=record)}
        return check_files(replace(setup, config=config.model_copy(update=tables)), "t.toml")

    with pytest.raises(ConfigError, match=rf"t\.toml: publish\.keys: {folder}: no such folder -> make one"):
        check(folder)
    KeyFolder(folder).make("left", tmp_path / "left.toml")
    assert check(folder) == []
    (missing, none) = check(tmp_path / "none", "tcp://127.0.0.1:9872", directory=str(tmp_path / "disk"))
    assert "none: not used" in missing
    assert "no such folder" in missing
    assert none.startswith(
        f"record.directory: {tmp_path}/disk: no such directory; the daemon starts without recording"
    )
    (full,) = check(None, "tcp://127.0.0.1:9872", directory=str(tmp_path), min_free_mb=1e12)
    assert "the daemon starts without recording" in full

"""Setup of a service: proposal, files, and their removal, below a folder instead of /."""

import hashlib
import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from pages import robot
from serial.tools import list_ports

from tactiled.config import Config
from tactiled.daemon.serial import device
from tactiled.doctor.finding import Finding
from tactiled.errors import ConfigError, OperatorError
from tactiled.resources import shipped
from tactiled.setup import run as setup_run
from tactiled.setup.apply import remove, taken_ports, write
from tactiled.setup.find import FoundBoard, FoundPort, find_ports
from tactiled.setup.plan import SetupPlan, make_plan, serves_all_boards

FTDI = FoundPort("/dev/serial/by-id/usb-FTDI_A5-if00-port0", "A5", "0403", "6001")
OTHER = FoundPort("/dev/serial/by-id/usb-1a86-if00", "B7", "1a86", "7523")
BY_PATH = "pci-0000:00:14.0-usb-0:1.2:1.0-port0"


def board(port: FoundPort = FTDI, serial: str = "TS0001") -> FoundBoard:
    return FoundBoard(port, "board-v1", "wang2019-3x3", 0, serial)


def tree(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): p.read_text() for p in sorted(root.rglob("*")) if p.is_file()}


def test_the_proposal_is_a_valid_configuration_and_names_what_was_found() -> None:
    plan = make_plan(board(), None)
    config = Config.model_validate(tomllib.loads(plan.files[0].text))
    assert (plan.name, config.port.url, config.session.board_serial) == ("A5", FTDI.url, "TS0001")
    assert (config.board.protocol, config.board.array) == ("board-v1", "wang2019-3x3")
    paths = [file.path for file in plan.files]
    assert "/etc/udev/rules.d/99-tactiled.rules" in paths
    assert ("systemctl", "enable", "--now", "tactiled@A5.service") in plan.commands


def test_an_adapter_that_the_shipped_rule_does_not_know_gets_its_own() -> None:
    (rule,) = [file for file in make_plan(board(OTHER), "left").files if "rules.d" in file.path]
    assert rule.path == "/etc/udev/rules.d/99-tactiled-left.rules"
    assert 'ATTRS{idVendor}=="1a86"' in rule.text
    assert 'ENV{ID_SERIAL_SHORT}=="B7"' in rule.text
    assert "tactiled@left.service" in rule.text


@pytest.mark.parametrize("port", [FTDI, OTHER])
def test_a_port_keeps_its_name_at_later_events(port: FoundPort) -> None:
    """Udev removes a link that no rule gives at an event, such as the change of `udevadm trigger`."""
    plan = make_plan(board(port), None)
    text = "".join(file.text for file in plan.files if "rules.d" in file.path).replace("\\\n", "")
    actions = {line.split(", ")[0] for line in text.splitlines() if "SYMLINK+=" in line}
    assert actions == {'ACTION!="remove"'}


def test_setup_triggers_no_devices_but_serial_ports() -> None:
    (trigger,) = [command for command in make_plan(board(), None).commands if "trigger" in command]
    assert {word for word in trigger if "match" in word} == {
        "--subsystem-match=tty", "--subsystem-match=usb-serial",
    }  # fmt: skip


def own_rule(plan: SetupPlan) -> str:
    (text,) = [file.text for file in plan.files if f"99-tactiled-{plan.name}.rules" in file.path]
    return text


@pytest.mark.parametrize(
    "serial",
    [
        '*", RUN+="/bin/touch X", ENV{z}=="',
        "*",
        "A?",
        "[A-Z]",
        "A|B",
        "$env{X}",
        "A,5",
        "\U0001f600",
        "a" * 127,
    ],
)
@pytest.mark.parametrize("port", [FTDI, OTHER])
def test_a_serial_number_that_may_not_stand_in_a_rule_is_refused_with_the_reason(
    port: FoundPort, serial: str
) -> None:
    with pytest.raises(ConfigError, match=r"serial number .*may not stand in a udev rule"):
        make_plan(board(replace(port, serial_number=serial)), "left")


def test_a_rule_has_the_serial_number_as_udev_sees_it() -> None:
    plan = make_plan(board(replace(OTHER, serial_number=" B  7:x ")), "left")
    assert 'ENV{ID_SERIAL_SHORT}=="B_7:x", GROUP' in own_rule(plan)
    assert make_plan(board(replace(FTDI, serial_number="A 5")), None).name == "A_5"


@pytest.mark.parametrize("port", [FTDI, OTHER])
def test_an_adapter_without_serial_number_is_matched_by_its_socket(port: FoundPort) -> None:
    plan = make_plan(board(replace(port, serial_number="", socket=BY_PATH)), "left")
    assert 'ENV{ID_PATH}=="pci-0000:00:14.0-usb-0:1.2:1.0", GROUP' in own_rule(plan)
    assert "ID_SERIAL_SHORT" not in own_rule(plan)
    assert any("follow the USB socket" in note for note in plan.notes)
    unnamed = make_plan(board(replace(port, serial_number=" ", socket="")), "left")
    assert not any("99-tactiled-left" in file.path for file in unnamed.files)
    assert any("gets no udev rule" in note for note in unnamed.notes)


def test_ports_of_adapters_without_serial_number_have_the_name_of_their_socket(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def entry(node: str, serial: str | None) -> SimpleNamespace:
        return SimpleNamespace(device=node, serial_number=serial, vid=0x1A86, pid=0x7523)

    monkeypatch.setattr(
        list_ports, "comports", lambda: [entry("/dev/ttyUSB0", None), entry("/dev/ttyUSB1", "B7")]
    )
    monkeypatch.setattr(device, "stable_name", lambda node, folder=device.BY_ID: folder / f"of-{node[-4:]}")
    nameless, named = find_ports()
    assert (nameless.url, nameless.socket) == ("/dev/serial/by-path/of-USB0", "of-USB0")
    assert (named.url, named.serial_number) == ("/dev/serial/by-id/of-USB1", "B7")


def test_a_port_of_any_name_becomes_valid_toml() -> None:
    odd = '/dev/\U0001f600"\\x'
    plan = make_plan(board(replace(FTDI, url=odd)), "left")
    assert tomllib.loads(plan.files[0].text)["port"]["url"] == odd
    for unprintable in ("/dev/\x7f", "/dev/\udc80", "/dev/a\nb"):
        with pytest.raises(ConfigError, match="cannot be printed"):
            make_plan(board(replace(FTDI, url=unprintable)), "left")


def test_where_one_daemon_reads_all_boards_it_is_restarted_and_no_instance_is_enabled(tmp_path: Path) -> None:
    wanted = tmp_path / "etc/systemd/system/multi-user.target.wants/tactiled.service"
    assert not serves_all_boards(tmp_path)
    wanted.parent.mkdir(parents=True)
    wanted.symlink_to("/etc/systemd/system/tactiled.service")  # as `systemctl enable` does
    plan = make_plan(board(), "left", for_all=serves_all_boards(tmp_path))
    assert not any("tactiled@left.service" in command for command in plan.commands)
    assert plan.commands[-1][-1].endswith(
        "check-config /etc/tactiled >/dev/null && systemctl restart tactiled.service"
    )
    assert not any("tactiled@" in file.path for file in plan.files)
    unit = shipped("systemd", "tactiled@.service").read_text()
    assert f"ConditionPathExists=!/{wanted.relative_to(tmp_path)}" in unit


@pytest.mark.parametrize("name", ["../left", "left hand", "-x", "a" * 65])
def test_a_name_that_is_no_instance_is_refused(name: str) -> None:
    with pytest.raises(ConfigError):
        make_plan(board(), name)


def test_doing_it_twice_changes_nothing_and_removal_leaves_nothing(tmp_path: Path) -> None:
    said: list[str] = []
    plan = make_plan(board(), "left")
    write(plan, tmp_path, said.append)
    once = tree(tmp_path)
    assert len(once) == len(plan.files) + 1
    write(plan, tmp_path, said.append)
    assert tree(tmp_path) == once
    assert sum(line.startswith("unchanged") for line in said) == len(plan.files)
    remove("left", tmp_path, said.append)
    assert tree(tmp_path) == {}
    with pytest.raises(OperatorError, match="not set up"):
        remove("left", tmp_path, said.append)


def test_removal_takes_the_folder_of_recordings_only_if_it_is_empty(tmp_path: Path) -> None:
    places = [tmp_path / f"var/lib/tactiled/{name}" for name in ("left", "right")]
    for place in places:  # systemd makes them for the units
        place.mkdir(parents=True)
        write(make_plan(board(), place.name), tmp_path, lambda _: None)
    recording = places[1] / "one.mcap"
    recording.write_text("scans")
    remove("left", tmp_path, lambda _: None)
    assert not places[0].exists()
    remove("right", tmp_path, lambda _: None)
    assert recording.exists()


def test_edited_files_are_kept(tmp_path: Path) -> None:
    said: list[str] = []
    plan = make_plan(board(), "left")
    write(plan, tmp_path, said.append)
    config = tmp_path / "etc/tactiled/left.toml"
    config.write_text(config.read_text() + "# mine\n")
    write(plan, tmp_path, said.append)
    assert config.read_text().endswith("# mine\n")
    remove("left", tmp_path, said.append)
    assert list(tree(tmp_path)) == ["etc/tactiled/left.toml"]
    assert any("it was edited" in line for line in said)


def test_a_file_of_somebody_else_is_neither_overwritten_nor_removed(tmp_path: Path) -> None:
    unit = tmp_path / "etc/systemd/system/tactiled@.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("# the operator's own\n")
    write(make_plan(board(), "left"), tmp_path, lambda _: None)
    remove("left", tmp_path, lambda _: None)
    assert tree(tmp_path) == {"etc/systemd/system/tactiled@.service": "# the operator's own\n"}


def test_an_equal_file_that_was_here_before_stays(tmp_path: Path) -> None:
    plan = make_plan(board(), "left")
    before = next(file for file in plan.files if file.shared)
    path = tmp_path / before.path.lstrip("/")
    path.parent.mkdir(parents=True)
    path.write_text(before.text)
    for _ in range(2):
        write(plan, tmp_path, lambda _: None)
    remove("left", tmp_path, lambda _: None)
    assert tree(tmp_path) == {before.path.lstrip("/"): before.text}


def test_what_the_debian_package_installed_gets_no_copy(tmp_path: Path) -> None:
    plan = make_plan(board(), "left")
    for file in plan.files:
        if file.shared:
            packaged = tmp_path / file.path.replace("/etc/", "usr/lib/", 1)
            packaged.parent.mkdir(parents=True)
            packaged.write_text(file.text)
    write(plan, tmp_path, lambda _: None)
    written = {name for name in tree(tmp_path) if name.startswith("etc/")}
    assert written == {"etc/tactiled/left.toml", "etc/tactiled/left.setup.json"}
    remove("left", tmp_path, lambda _: None)
    assert not [name for name in tree(tmp_path) if name.startswith("etc/")]


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "--now", "a b", "a/../../evil"])
def test_removal_of_what_is_no_name_touches_nothing(tmp_path: Path, name: str) -> None:
    victim = tmp_path / "etc/systemd/system/victim"
    victim.parent.mkdir(parents=True)
    victim.write_text("mine")
    listed = {"/etc/systemd/system/victim": hashlib.sha256(b"mine").hexdigest()}
    (tmp_path / "etc/evil.setup.json").write_text(json.dumps(listed))
    before = tree(tmp_path)
    with pytest.raises(OperatorError, match="is no name"):
        setup_run.run_remove(name, tmp_path)
    assert tree(tmp_path) == before


def test_a_unit_of_somebody_else_is_not_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    run: list[tuple[str, ...]] = []
    monkeypatch.setattr(setup_run, "run_commands", lambda commands, _: run.extend(commands))
    with pytest.raises(OperatorError, match="not set up here"):
        setup_run.run_remove("made-by-hand", Path("/"))
    assert run == []


@pytest.mark.parametrize(
    "listed",
    [b"\xff\x00", b"[]", b"[" * 50_000, b'{"/etc/passwd": "0"}', b'{"/etc/tactiled/../passwd": "0"}'],
)
def test_a_damaged_list_of_files_removes_nothing(tmp_path: Path, listed: bytes) -> None:
    write(make_plan(board(), "left"), tmp_path, lambda _: None)
    (tmp_path / "etc/tactiled/left.setup.json").write_bytes(listed)
    files = sorted(tmp_path.rglob("*"))
    for name in ("left", "right"):
        with pytest.raises(OperatorError, match="is no list of what"):
            write(make_plan(board(), name), tmp_path, lambda _: None)
    with pytest.raises(OperatorError, match="is no list of what"):
        remove("left", tmp_path, lambda _: None)
    assert sorted(tmp_path.rglob("*")) == files


@pytest.mark.parametrize("kind", ["bytes", "folder", "fifo"])
def test_what_is_no_text_file_is_kept(tmp_path: Path, kind: str) -> None:
    said: list[str] = []
    plan = make_plan(board(), "left")
    write(plan, tmp_path, said.append)
    for planned in plan.files:
        path = tmp_path / planned.path.lstrip("/")
        path.unlink()
        if kind == "bytes":
            path.write_bytes(b"\xff\xfe\x00")
        else:
            path.mkdir() if kind == "folder" else os.mkfifo(path)
    write(plan, tmp_path, said.append)
    assert sum("it is no text file" in line for line in said) == len(plan.files)
    remove("left", tmp_path, said.append)
    assert all((tmp_path / planned.path.lstrip("/")).exists() for planned in plan.files)


def test_what_was_written_before_a_failure_can_be_removed(tmp_path: Path) -> None:
    plan = make_plan(board(), "left")
    blocked = tmp_path / plan.files[-1].path.lstrip("/")
    blocked.parent.parent.mkdir(parents=True)
    blocked.parent.write_text("a file where a folder must be")
    with pytest.raises(OperatorError, match="cannot be written"):
        write(plan, tmp_path, lambda _: None)
    remove("left", tmp_path, lambda _: None)
    assert list(tree(tmp_path)) == [str(blocked.parent.relative_to(tmp_path))]


def test_shared_files_go_with_the_last_board(tmp_path: Path) -> None:
    for name in ("left", "right"):
        write(make_plan(board(), name), tmp_path, lambda _: None)
    remove("left", tmp_path, lambda _: None)
    assert "etc/systemd/system/tactiled@.service" in tree(tmp_path)
    assert "etc/tactiled/left.toml" not in tree(tmp_path)
    remove("right", tmp_path, lambda _: None)
    assert tree(tmp_path) == {}


def test_files_of_an_older_version_are_renewed_and_stay_for_the_other_board(tmp_path: Path) -> None:
    new = make_plan(board(), "left")
    old = [replace(file, text="# older\n" + file.text) if file.shared else file for file in new.files]
    write(replace(new, files=tuple(old)), tmp_path, lambda _: None)
    write(make_plan(board(OTHER), "right"), tmp_path, lambda _: None)
    remove("left", tmp_path, lambda _: None)
    shared = {
        file.path.lstrip("/"): file.text for file in make_plan(board(OTHER), "right").files if file.shared
    }
    assert shared.items() <= tree(tmp_path).items()


def test_the_configuration_of_a_board_is_not_overwritten_with_another_port(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Boards of one layout may all have one serial number, and adapters none."""
    first, second = tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"
    root = tmp_path / "root"
    found = (Finding("bytes", "ok", "scans"),)
    monkeypatch.setattr(setup_run, "examine", lambda port, _: replace(board(port, "LEGACY"), findings=found))
    monkeypatch.setattr(setup_run, "port_at", lambda url: FoundPort(url, "", "1a86", "7523"))

    def setup(name: str | None, port: Path) -> None:
        assert setup_run.run_setup(name, str(port), None, None, root, dry_run=False) == 0

    for port in (first, second):
        port.touch()
    setup(None, first)
    before = tree(root)
    for name in (None, "LEGACY"):
        with pytest.raises(ConfigError, match=f"NAME.*LEGACY is set up for {first}"):
            setup(name, second)
    assert tree(root) == before
    (tmp_path / "alias").symlink_to(first)
    setup("right", second)
    setup(None, tmp_path / "alias")  # the same board
    first.unlink()  # it was plugged in elsewhere
    setup(None, second)
    assert str(second) in (root / "etc/tactiled/LEGACY.toml").read_text()


def test_the_unit_starts_a_program_that_is_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "bin/tactiled"
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python3"))
    monkeypatch.setattr(sys, "argv", [str(program)])
    with pytest.raises(ConfigError, match="no such program"):
        make_plan(board(), "left")
    program.parent.mkdir()
    program.touch()
    (unit,) = [file.text for file in make_plan(board(), "left").files if "tactiled@" in file.path]
    assert f"ExecStart={program} " in unit


def test_each_daemon_gets_a_tcp_port_of_its_own(tmp_path: Path) -> None:
    def text(name: str, *, for_all: bool = False) -> str:
        plan = make_plan(board(), name, taken=taken_ports(tmp_path), for_all=for_all)
        write(plan, tmp_path, lambda _: None)
        return plan.files[0].text

    assert "127.0.0.1:9872" in text("left")
    assert "127.0.0.1:9882" in text("right")
    assert "127.0.0.1:9892" in text("thumb")
    assert "127.0.0.1:9882" in text("right")  # a second call proposes the same
    assert "127.0.0.1:9872" in text("fourth", for_all=True)  # one daemon has one port
    remove("right", tmp_path, lambda _: None)
    remove("thumb", tmp_path, lambda _: None)
    (tmp_path / "etc/tactiled/other.toml").write_text(
        "metrics.port = 9892\npublish.endpoints = ['tcp://*:9881']"
    )
    (tmp_path / "etc/tactiled/torn.toml").write_text("publish = [")
    (tmp_path / "etc/tactiled/odd.toml").write_text("publish = 3")
    (tmp_path / "etc/tactiled/word.toml").write_text("metrics.port = 'any'")
    (tmp_path / "etc/tactiled/number.toml").write_text("publish.endpoints = [3]")
    assert "127.0.0.1:9902" in text("fifth")  # 9882 is for requests to `other`, whose metrics have 9892


def test_no_port_is_said_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(setup_run, "find_ports", list)
    assert setup_run.run_setup(None, None, None, None, tmp_path, dry_run=False) == 1
    assert "plug the board in" in capsys.readouterr().err
    assert tree(tmp_path) == {}


@pytest.mark.system
def test_an_emulated_board_is_recognised_proposed_and_served(tmp_path: Path) -> None:
    with robot(tmp_path) as made:
        made.plug()
        made.line("board", "ready")
        root = tmp_path / "root"
        command = [sys.executable, "-m", "tactiled", "setup", "left", "--port", str(tmp_path / "board")]

        def setup(*options: str) -> "subprocess.CompletedProcess[str]":
            return subprocess.run(
                [*command, "--root", str(root), *options],
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )

        dry = setup("--dry-run")
        assert dry.returncode == 0, dry.stderr
        assert 'board_serial = "TS0001"' in dry.stdout
        assert "would run: systemctl daemon-reload" in dry.stdout
        assert not root.exists()
        done = setup()
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["name"] == "left"
        check = [sys.executable, "-m", "tactiled", "check-config", str(root / "etc/tactiled/left.toml")]
        assert subprocess.run(check, capture_output=True, timeout=60, check=False).returncode == 0
        assert setup("--remove").returncode == 0
        assert tree(root) == {}
        assert setup("--remove").returncode == 2

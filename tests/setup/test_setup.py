"""Setup of a service: proposal, files, and their removal, below a folder instead of /."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from pages import robot

from tactiled.config import Config
from tactiled.errors import ConfigError, OperatorError
from tactiled.resources import shipped
from tactiled.setup import run as setup_run
from tactiled.setup.apply import remove, write
from tactiled.setup.find import FoundBoard, FoundPort
from tactiled.setup.plan import make_plan, serves_all_boards

FTDI = FoundPort("/dev/serial/by-id/usb-FTDI_A5-if00-port0", "A5", "0403", "6001")
OTHER = FoundPort("/dev/serial/by-id/usb-1a86-if00", "B7", "1a86", "7523")


def board(port: FoundPort = FTDI, serial: str = "TS0001") -> FoundBoard:
    return FoundBoard(port, "board-v1", "wang2019-3x3", 0, serial, 100.0)


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


@pytest.mark.parametrize("name", ["../left", "left hand", "", "-x", "a" * 65])
def test_a_name_that_is_no_instance_is_refused(name: str) -> None:
    if name:
        with pytest.raises(ConfigError):
            make_plan(board(), name)
    else:
        assert make_plan(board(), name).name == "A5"


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


def test_no_port_is_said_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(setup_run, "find_ports", list)
    assert setup_run.run_setup(None, None, None, 9872, tmp_path, dry_run=False) == 1
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
        assert "scan 0" in done.stderr
        assert json.loads(done.stdout)["name"] == "left"
        check = [sys.executable, "-m", "tactiled", "check-config", str(root / "etc/tactiled/left.toml")]
        assert subprocess.run(check, capture_output=True, timeout=60, check=False).returncode == 0
        assert setup("--remove").returncode == 0
        assert tree(root) == {}
        assert setup("--remove").returncode == 2

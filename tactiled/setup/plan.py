"""Files and commands of a service for one board, as data: what `tactiled setup` writes, or prints."""

import json
import re
import shlex
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from tactiled import resources, tomlfile
from tactiled.config import Config
from tactiled.errors import ConfigError
from tactiled.setup.find import FoundBoard

_INSTALLED = "/opt/tactiled/bin/tactiled"  # ExecStart of the shipped unit
_ALL = "tactiled.service"
# The condition of tactiled@.service names this path.
_ALL_ENABLED = f"/etc/systemd/system/multi-user.target.wants/{_ALL}"
_SHIPPED_RULE = {"0403:6001", "0403:6015"}  # adapters of the shipped udev rule
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_OTHER_RULE = """\
# Written by `tactiled setup` for {name}: the port of this adapter, with a name that follows it.
ACTION=="add", SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS{{idVendor}}=="{vendor}", \\
    ATTRS{{idProduct}}=="{product}", ENV{{ID_SERIAL_SHORT}}=="{serial}", GROUP="dialout", MODE="0660", \\
    SYMLINK+="tactiled-{name}", \\
    TAG+="systemd", ENV{{SYSTEMD_WANTS}}+="tactiled@{name}.service"
"""
_CONFIG = """\
# Written by `tactiled setup`; config/tactiled.toml of the source explains every key.
[port]
url = {url}
{baud}
[board]
protocol = {protocol}
array = {array}

[session]
{board_serial}
[publish]
endpoints = ["ipc://{{runtime}}/events.ipc", "tcp://127.0.0.1:{tcp_port}"]

[record]
# directory = "/var/lib/tactiled/{name}"
"""


@dataclass(frozen=True)
class PlannedFile:
    """File to write; `shared` is used by all boards of this host, and goes with the last one."""

    path: str
    text: str
    shared: bool = False


@dataclass(frozen=True)
class SetupPlan:
    """All files of a service, and the commands that make the system read them."""

    name: str
    files: tuple[PlannedFile, ...]
    commands: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def manifest(self) -> str:
        """Path of the list of what was written, from which `--remove` works."""
        return f"/etc/tactiled/{self.name}.setup.json"


def serves_all_boards(root: Path) -> bool:
    """Return True where the unit of all boards is enabled; instances of the other are then skipped."""
    return (root / _ALL_ENABLED.lstrip("/")).is_symlink()


def make_plan(
    board: FoundBoard, name: str | None, tcp_port: int = 9872, *, for_all: bool = False
) -> SetupPlan:
    """Return what the service of a board needs.

    Parameters
    ----------
    board : FoundBoard
    name : str, optional
        Name of the instance; by default the serial number of the adapter, by which the udev rule starts it.
    tcp_port : int
        Loopback port of its events; each daemon of a host needs one of its own.
    for_all : bool
        `tactiled.service` reads this configuration with those of the other boards (`serves_all_boards`).

    Raises
    ------
    ConfigError
        The name is no name of a unit, or the configuration would be invalid.
    """
    port = board.port
    name = name or port.serial_number or board.board_serial or "board"
    if not _NAME.fullmatch(name):
        raise ConfigError("NAME", [f"{name!r}: letters, digits, '-', '_' and '.', as in left-hand"])
    config = _CONFIG.format(
        url=json.dumps(port.url),
        baud=f"baud = {board.baud}\n" if board.baud else "",
        protocol=json.dumps(board.protocol),
        array=json.dumps(_absolute(board.array)),
        board_serial=f"board_serial = {json.dumps(board.board_serial)}\n" if board.board_serial else "",
        tcp_port=tcp_port,
        name=name,
    )
    tomlfile.parse(tomllib.loads(config), Config, "the proposed configuration")
    program = str(Path(sys.executable).with_name("tactiled"))
    unit = resources.shipped("systemd", "tactiled@.service").read_text().replace(_INSTALLED, program)
    sysusers = resources.shipped("systemd", "tactiled.sysusers").read_text()
    files = [
        PlannedFile(f"/etc/tactiled/{name}.toml", config),
        PlannedFile("/etc/sysusers.d/tactiled.conf", sysusers, shared=True),
    ]
    if not for_all:
        files.append(PlannedFile("/etc/systemd/system/tactiled@.service", unit, shared=True))
    commands = [("systemd-sysusers",), ("systemctl", "daemon-reload")]
    if f"{port.vendor}:{port.product}" in _SHIPPED_RULE:
        rule = resources.shipped("systemd", "99-tactiled.rules").read_text()
        files.append(PlannedFile("/etc/udev/rules.d/99-tactiled.rules", rule, shared=True))
    elif port.vendor:
        rule = _OTHER_RULE.format(
            name=name, vendor=port.vendor, product=port.product, serial=port.serial_number
        )
        files.append(PlannedFile(f"/etc/udev/rules.d/99-tactiled-{name}.rules", rule))
    if port.vendor:
        commands += [("udevadm", "control", "--reload"), ("udevadm", "trigger", "--action=add")]
    if for_all:
        # Files that do not fit together would stop the daemon of all boards.
        check = f"{shlex.quote(program)} check-config /etc/tactiled >/dev/null"
        commands.append(("sh", "-c", f"{check} && systemctl restart {_ALL}"))
    else:
        commands.append(("systemctl", "enable", "--now", f"tactiled@{name}.service"))
    notes = [
        "members of group tactiled may command the daemon: sudo usermod -aG tactiled USER, then log in anew"
    ]
    if for_all:
        notes.append(
            f"{_ALL} is enabled: it reads this board with the others, and tactiled@{name} is not used"
        )
    if program != _INSTALLED and Path(program).resolve().is_relative_to("/home"):
        notes.append(
            f"{program} is in /home, which the unit may not see: install tactiled into /opt/tactiled"
        )
    return SetupPlan(name, tuple(files), tuple(commands), tuple(notes))


def _absolute(array: str) -> str:
    return array if resources.is_name(array) else str(Path(array).absolute())

"""Files and commands of a service for one board, as data: what `tactiled setup` writes, or prints."""

import re
import shlex
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from tactiled import resources, tomlfile, tomltext
from tactiled.config import Config
from tactiled.errors import ConfigError, DataError
from tactiled.outside import name_of, rule_value, shown
from tactiled.setup.find import FoundBoard, FoundPort

_INSTALLED = "/opt/tactiled/bin/tactiled"  # ExecStart of the shipped unit
_FIRST_PORT, _PORTS_EACH = 9872, 10  # the port after that of events answers commands
_ALL = "tactiled.service"
# The condition of tactiled@.service names this path.
_ALL_ENABLED = f"/etc/systemd/system/multi-user.target.wants/{_ALL}"
_SHIPPED_RULE = {"0403:6001", "0403:6015"}  # adapters of the shipped udev rule
_OTHER_RULE = """\
# Written by `tactiled setup` for {name}: the port of this {follows}, with a name that follows it.
ACTION!="remove", SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS{{idVendor}}=="{vendor}", \\
    ATTRS{{idProduct}}=="{product}", ENV{{{key}}}=="{value}", GROUP="dialout", MODE="0660", \\
    SYMLINK+="tactiled-{name}", \\
    TAG+="systemd", ENV{{SYSTEMD_WANTS}}+="tactiled@{name}.service"
"""
# For adapters that are plugged in already; no other device of the host is asked to begin anew.
_TRIGGER = ("udevadm", "trigger", "--action=add", "--subsystem-match=tty", "--subsystem-match=usb-serial")
_SOCKET = (
    "the adapter has no serial number: the rule and the port follow the USB socket that it is plugged into; "
    "leave it there, or run this again"
)
_NEITHER = (
    "the adapter has neither a serial number nor a name in /dev/serial/by-path: it gets no udev rule, and "
    "the port may have another name after the next start"
)
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


class TakenPorts(NamedTuple):
    """TCP ports of a configuration."""

    events: set[int]
    every: set[int]  # with those of requests and metrics


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


def serves_all_boards(root: Path) -> bool:
    """Return True where the unit of all boards is enabled; instances of the other are then skipped."""
    return (root / _ALL_ENABLED.lstrip("/")).is_symlink()


def make_plan(
    board: FoundBoard,
    name: str | None,
    tcp_port: int | None = None,
    *,
    taken: Mapping[str, TakenPorts] | None = None,
    for_all: bool = False,
) -> SetupPlan:
    """Return what the service of a board needs.

    `ConfigError` if the name is no name of a unit, the configuration would be invalid, or the program was not
    found.

    Parameters
    ----------
    name : str, optional
        Name of the instance; by default the serial number of the adapter, by which the udev rule starts it.
    tcp_port : int, optional
        Loopback port of its events; by default one that no other daemon of this host has.
    taken : mapping of str to TakenPorts, optional
        Ports of the configurations that are there, by name (`tactiled.setup.apply.taken_ports`).
    for_all : bool
        `tactiled.service` reads this configuration with those of the other boards (`serves_all_boards`).
    """
    port = board.port
    serial = _serial_of(port)
    try:
        name = name_of(name or serial or board.board_serial or "board")
    except DataError as error:
        told = "" if name else " (from the adapter or the board; give one: tactiled setup left-hand)"
        raise ConfigError("NAME", [f"{error}{told}"]) from None
    for text in (port.url, board.array):
        if not text.isprintable():
            raise ConfigError("setup", [f"{shown(text)}: has characters that cannot be printed"])
    config = _CONFIG.format(
        url=tomltext.quoted(port.url),
        baud=f"baud = {board.baud}\n" if board.baud else "",
        protocol=tomltext.quoted(board.protocol),
        array=tomltext.quoted(_absolute(board.array)),
        board_serial=f"board_serial = {tomltext.quoted(board.board_serial)}\n" if board.board_serial else "",
        tcp_port=tcp_port or _event_port(name, taken or {}, for_all=for_all),
        name=name,
    )
    tomlfile.parse(tomllib.loads(config), Config, "the proposed configuration")
    program = _program()
    unit = resources.shipped("systemd", "tactiled@.service").read_text().replace(_INSTALLED, program)
    sysusers = resources.shipped("systemd", "tactiled.sysusers").read_text()
    files = [
        PlannedFile(f"/etc/tactiled/{name}.toml", config),
        PlannedFile("/etc/sysusers.d/tactiled.conf", sysusers, shared=True),
    ]
    if not for_all:
        files.append(PlannedFile("/etc/systemd/system/tactiled@.service", unit, shared=True))
    commands = [("systemd-sysusers",), ("systemctl", "daemon-reload")]
    notes = [
        "members of group tactiled may command the daemon: sudo usermod -aG tactiled USER, then log in anew"
    ]
    has_shipped_rule = f"{port.vendor}:{port.product}" in _SHIPPED_RULE
    if has_shipped_rule:
        rule = resources.shipped("systemd", "99-tactiled.rules").read_text()
        files.append(PlannedFile("/etc/udev/rules.d/99-tactiled.rules", rule, shared=True))
    if port.vendor and not serial:
        notes.append(_SOCKET if port.socket else _NEITHER)
    if port.vendor and (port.socket if not serial else not has_shipped_rule):
        rule = _own_rule(name, port, serial)
        files.append(PlannedFile(f"/etc/udev/rules.d/99-tactiled-{name}.rules", rule))
    if port.vendor:
        commands += [("udevadm", "control", "--reload"), _TRIGGER]
    if for_all:
        # Files that do not fit together would stop the daemon of all boards.
        check = f"{shlex.quote(program)} check-config /etc/tactiled >/dev/null"
        commands.append(("sh", "-c", f"{check} && systemctl restart {_ALL}"))
        notes.append(
            f"{_ALL} is enabled: it reads this board with the others, and tactiled@{name} is not used"
        )
    else:
        commands.append(("systemctl", "enable", "--now", f"tactiled@{name}.service"))
    if program != _INSTALLED and Path(program).resolve().is_relative_to("/home"):
        notes.append(
            f"{program} is in /home, which the unit may not see: install tactiled into /opt/tactiled"
        )
    return SetupPlan(name, tuple(files), tuple(commands), tuple(notes))


def _program() -> str:
    """Return the path of the program: beside the interpreter, or as it was started (``pip --user``)."""
    beside = Path(sys.executable).with_name("tactiled")
    for path in (beside, Path(sys.argv[0]).absolute()):
        if path.name == beside.name and path.is_file():
            return str(path)
    raise ConfigError(str(beside), ["no such program, which the unit would start: install tactiled there"])


def _event_port(name: str, taken: Mapping[str, TakenPorts], *, for_all: bool) -> int:
    """Return the port that this board has already, that all share in one daemon, or the next free one."""
    kept = [ports.events for of, ports in taken.items() if for_all or of == name]
    if own := set().union(*kept):
        return min(own)
    used = set().union(*(ports.every for ports in taken.values()))
    candidates = range(_FIRST_PORT, 2**16 - _PORTS_EACH, _PORTS_EACH)
    return next((port for port in candidates if not {port, port + 1} & used), _FIRST_PORT)


def _serial_of(port: FoundPort) -> str:
    """Return the serial number of an adapter as udev sees it; empty where it has none."""
    try:
        return rule_value(port.serial_number) if port.serial_number.strip(" ") else ""
    except DataError as error:
        remedy = "use an adapter with another serial number, or write its rule and configuration by hand"
        raise ConfigError("serial number of the adapter", [f"{error}; {remedy}"]) from None


def _own_rule(name: str, port: FoundPort, serial: str) -> str:
    """Return the udev rule of one adapter, by its serial number, or by its USB socket where it has none."""
    if serial:
        key, value, follows = "ID_SERIAL_SHORT", serial, "adapter"
    else:
        # udev names the link after ID_PATH and the number of the port.
        try:
            socket = rule_value(re.sub(r"-port\d+$", "", port.socket))
        except DataError as error:
            remedy = "use another USB socket, or write its rule by hand"
            raise ConfigError("USB socket of the adapter", [f"{error}; {remedy}"]) from None
        key, value, follows = "ID_PATH", socket, "USB socket"
    return _OTHER_RULE.format(
        name=name, vendor=port.vendor, product=port.product, key=key, value=value, follows=follows
    )


def _absolute(array: str) -> str:
    return array if resources.is_name(array) else str(Path(array).absolute())

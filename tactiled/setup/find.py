"""Search for a board: adapter, bytes, layout, array."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from tactiled import resources
from tactiled.config import BoardFiles, default_config
from tactiled.daemon.serial import device
from tactiled.daemon.serial.port import PortParams
from tactiled.doctor.board import check_board
from tactiled.doctor.finding import Finding
from tactiled.doctor.port import check_port
from tactiled.errors import ConfigError

_TRIES = 3  # as configured, with the layout that was found, with the array that the board named


@dataclass(frozen=True)
class FoundPort:
    """Serial port with its adapter."""

    url: str  # name that follows the adapter, where udev gives it one
    # serial_number, vendor, product: of a USB adapter; vendor and product are four hexadecimal digits. Empty
    # where unknown
    serial_number: str = ""
    vendor: str = ""
    product: str = ""
    socket: str = ""  # name in /dev/serial/by-path, which follows the USB socket. Empty where udev gives none


@dataclass(frozen=True)
class FoundBoard:
    """Port with what answers there; `protocol` is empty where no board was recognised."""

    port: FoundPort
    protocol: str = ""
    array: str = ""
    baud: int = 0
    board_serial: str = ""
    findings: tuple[Finding, ...] = field(default=(), repr=False)


def find_ports() -> list[FoundPort]:
    """Return the USB serial ports of this host, by names that follow the adapter."""
    found = []
    for entry in sorted(list_ports.comports(), key=lambda entry: str(entry.device)):
        if entry.vid is None:
            continue  # a port of the mainboard, which exists whether anything is connected or not
        serial = entry.serial_number or ""
        socket = device.stable_name(entry.device, device.BY_PATH)
        # Adapters without a serial number share one name in by-id.
        stable = (device.stable_name(entry.device) if serial else socket) or entry.device
        product = f"{entry.pid or 0:04x}"
        found.append(
            FoundPort(str(stable), serial, f"{entry.vid:04x}", product, socket.name if socket else "")
        )
    return found


def port_at(url: str) -> FoundPort:
    """Return the port with this name, with its adapter where it has one."""
    node = str(Path(url).resolve())
    for found in find_ports():
        if str(Path(found.url).resolve()) == node:
            return replace(found, url=url)
    return FoundPort(url)


def examine(port: FoundPort, array: str | None = None) -> FoundBoard:
    """Open a port, and recognise layout and array of the board behind it; `array` is a file of the user."""
    findings = check_port(port.url)
    if any(finding.verdict == "fail" for finding in findings):
        return FoundBoard(port, findings=tuple(findings))
    protocol, baud, chosen = "board-v1", 0, array or "wang2019-3x3"
    line: list[Finding] = []
    for _ in range(_TRIES):
        try:
            setup = default_config(
                port.url,
                port=PortParams(url=port.url, baud=baud),
                board=BoardFiles(protocol=protocol, array=chosen),
            )
        except ConfigError as error:
            line = [Finding("array", "fail", error.faults[0], "name the array: --array FILE")]
            break
        line, _ = check_board(setup)
        searched = _values(line, "search")
        identity = _values(line, "board")
        named = str(identity.get("array_id", ""))
        if searched and (searched["protocol"], searched["baud"]) != (protocol, baud):
            protocol, baud = str(searched["protocol"]), int(searched["baud"])
            chosen = array or _array_of(protocol)
        elif array is None and named != chosen and named in resources.shipped_names("config/arrays"):
            chosen = named
        else:
            break
    found = (*findings, *line)
    if any(finding.verdict == "fail" for finding in line):
        return FoundBoard(port, findings=found)
    return FoundBoard(port, protocol, chosen, baud, str(identity.get("board_serial", "")), found)


def _values(findings: list[Finding], check: str) -> dict[str, Any]:
    return next((finding.values for finding in findings if finding.check == check and finding.values), {})


def _array_of(protocol: str) -> str:
    """Return the shipped array that boards of a layout have: as many channels as its scans."""
    from tactiled.array import load_array
    from tactiled.wire.layout import load_layout

    n_channels = load_layout(protocol).n_channels
    fitting = [n for n in resources.shipped_names("config/arrays") if load_array(n).n_channels == n_channels]
    return "wang2019-3x3" if "wang2019-3x3" in fitting or not fitting else fitting[0]

"""Search for the ipc endpoint of the daemon on this host that accepts commands of this user."""

import os
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path

from tactiled.errors import OperatorError

_OF_UNITS = Path("/run/tactiled")  # RuntimeDirectory= of each unit is a folder in it


def _is_ours(folder: Path) -> bool:
    """Return False for a folder that somebody else made in the place of this user's own."""
    try:
        return folder.lstat().st_uid == os.getuid()
    except OSError:
        return False


def _answering(folder: Path) -> Iterator[Path]:
    """Yield the sockets for requests that a daemon serves; PermissionError where this user may not connect.

    The name of such a socket follows from that of the endpoint for events (`control_endpoint`).
    """
    for path in sorted(folder.iterdir()):
        if "control" not in path.name:
            continue
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(str(path))
            except PermissionError:
                raise
            except OSError:
                continue  # a file that a killed daemon left, or no socket
        yield path


def _events_beside(control: Path) -> str:
    """Endpoint for events to which a socket for requests belongs."""
    is_added = control.name.endswith(".control")
    name = control.name.removesuffix(".control") if is_added else control.name.replace("control", "events")
    return f"ipc://{control.with_name(name)}"


def control(environ: Mapping[str, str] = os.environ, of_units: Path = _OF_UNITS) -> str:
    """Return the endpoint for requests of the one daemon on this host, run by this user or as a unit.

    Raises
    ------
    OperatorError
        There is none, or more than one, or this user may not connect; the message says what to do.
    """
    session = environ.get("XDG_RUNTIME_DIR")
    own = Path(session) / "tactiled" if session else Path(f"/tmp/tactiled-{os.getuid()}")
    units = sorted(of_units.iterdir()) if of_units.is_dir() else []
    found: list[Path] = []
    closed: list[Path] = []
    for folder in ([own] if _is_ours(own) else []) + [one for one in units if one.is_dir()]:
        try:
            found += _answering(folder)
        except PermissionError:
            closed.append(folder)
    if len(found) == 1:
        return f"ipc://{found[0]}"
    if found:
        names = ", ".join(map(_events_beside, found))
        raise OperatorError(f"several daemons run here: give --endpoint, one of {names}")
    if closed:
        raise OperatorError(
            f"{', '.join(map(str, closed))}: this user may not command the daemon there; join its group: "
            "sudo usermod -aG tactiled USER, then log in anew"
        )
    raise OperatorError(
        f"no daemon that takes commands has a socket in {own} or {of_units}/*: start one, or give --endpoint "
        "(and --keys), as for one whose publish.endpoints are elsewhere"
    )

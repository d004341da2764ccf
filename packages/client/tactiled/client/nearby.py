"""Search for the ipc endpoint of the daemon on this host that accepts commands of this user."""

import os
import socket
from collections.abc import Mapping
from pathlib import Path

from tactiled.errors import OperatorError
from tactiled.events.endpoints import control_endpoint

_OF_UNITS = Path("/run/tactiled")  # RuntimeDirectory= of each unit is a folder in it


def _is_ours(folder: Path) -> bool:
    """Return False for a folder that somebody else made in the place of this user's own."""
    try:
        return folder.lstat().st_uid == os.getuid()
    except OSError:
        return False


def _answering(folder: Path) -> list[tuple[Path, Path]]:
    """Return the sockets for events and requests that daemons of a folder serve.

    Where there are those by default, they alone count: a daemon may have several. Raises PermissionError
    where this user may not connect.
    """
    there = {path.name: path for path in folder.iterdir()}
    found = []
    for name in sorted(there, key=lambda name: (name != "events.ipc", name)):
        requests = there.get(control_endpoint(f"ipc://{name}").removeprefix("ipc://"))
        if requests is None:
            continue
        with socket.socket(socket.AF_UNIX) as probe:
            probe.setblocking(False)
            try:
                probe.connect(str(requests))
            except BlockingIOError:
                pass  # it listens, and takes no connection now: its daemon is busy or hangs
            except PermissionError:
                raise
            except OSError:
                continue  # a file that a killed daemon left, or no socket
        found.append((there[name], requests))
        if name == "events.ipc":
            break
    return found


def control(environ: Mapping[str, str] = os.environ, of_units: Path = _OF_UNITS) -> str:
    """Return the endpoint for requests of the one daemon on this host, run by this user or as a unit.

    `OperatorError` where there is none, or more than one, or this user may not connect.
    """
    session = environ.get("XDG_RUNTIME_DIR")
    own = Path(session) / "tactiled" if session else Path(f"/tmp/tactiled-{os.getuid()}")
    units = sorted(of_units.iterdir()) if of_units.is_dir() else []
    found: list[tuple[Path, Path]] = []
    closed: list[Path] = []
    for folder in ([own] if _is_ours(own) else []) + [one for one in units if one.is_dir()]:
        try:
            found += _answering(folder)
        except PermissionError:
            closed.append(folder)
        except OSError:
            continue  # a unit that stops meanwhile, or no folder
    if len(found) == 1:
        return f"ipc://{found[0][1]}"
    if found:
        names = ", ".join(f"ipc://{events}" for events, _ in found)
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

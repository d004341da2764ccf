"""Search for the ipc endpoint of the daemon on this host that accepts commands of this user."""

import os
import socket
from collections.abc import Mapping
from pathlib import Path

from tactiled.errors import OperatorError

_OF_UNITS = Path("/run/tactiled")  # RuntimeDirectory= of each unit is a folder in it
_NAME = "control.ipc"


def _is_ours(folder: Path) -> bool:
    """Return False for a folder that somebody else made in the place of this user's own."""
    try:
        return folder.lstat().st_uid == os.getuid()
    except OSError:
        return False


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
    for folder in (own, *units):
        if folder == own and not _is_ours(own):
            continue
        try:
            with socket.socket(socket.AF_UNIX) as probe:
                probe.connect(str(folder / _NAME))
            found.append(folder / _NAME)
        except PermissionError:
            closed.append(folder)
        except OSError:
            continue  # no daemon, or the file of one that was killed
    if len(found) == 1:
        return f"ipc://{found[0]}"
    if found:
        names = ", ".join(f"ipc://{path.with_name('events.ipc')}" for path in found)
        raise OperatorError(f"several daemons run here: give --endpoint, one of {names}")
    if closed:
        raise OperatorError(
            f"{', '.join(map(str, closed))}: this user may not command the daemon there; join its group: "
            "sudo usermod -aG tactiled USER, then log in anew"
        )
    raise OperatorError("no daemon that takes commands runs here: start one, or give --endpoint (and --keys)")

"""Control socket of the emulator: a controller changes the grip on a held object while the scene runs.

Lines of JSON, one answer for each, in order::

    {"grip_n": 25.0}   ->  {"ok": true, "scene_s": 3.21, "grip_n": 18.4, "slipping": 0.0, ...}
    {}                 ->  the same answer, grip unchanged
    anything else      ->  {"ok": false, "error": "..."}

A grip takes effect from the next scan on; the grip force follows it at the scene's `grip_rate_n_s`, and the
answer contains the present force.
"""

import json
import socket
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.emulator.line.links import HostLink, TcpLink, make_link
from tactiled.emulator.scene.contact import SceneContact
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.errors import ConfigError

_LONGEST_LINE = 4096  # bytes; longer lines are no command and are dropped, which bounds memory


def move_grip(contact: SceneContact, force_n: float) -> None:
    """Set the grip on a held object.

    Raises
    ------
    ConfigError
        The scene has no held object, or the force is not from 0 to 2000 N.
    """
    if not isinstance(contact, PhysicalContact):
        raise ConfigError("grip", ["this scene has no held object: there is nothing to grip"])
    contact.grip(force_n)


class ControlLines:
    """Protocol of the control socket, without I/O: bytes of one peer in, answers out."""

    def __init__(self, contact: SceneContact) -> None:
        self._contact = contact
        self._pending = b""

    def receive(self, data: bytes, scene_s: float) -> bytes:
        """Answer the lines that `data` completes."""
        *lines, self._pending = (self._pending + data).split(b"\n")
        answers = [self._answer(line, scene_s) for line in lines if line.strip()]
        if len(self._pending) > _LONGEST_LINE:
            self._pending = b""
            answers.append(_refusal(f"a line of more than {_LONGEST_LINE} bytes is no command"))
        return b"".join(json.dumps(answer).encode() + b"\n" for answer in answers)

    def _answer(self, line: bytes, scene_s: float) -> dict[str, Any]:
        try:
            command = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal("no JSON")
        if not isinstance(command, dict) or command.keys() - {"grip_n"}:
            return _refusal('say {"grip_n": NEWTONS}, or {} to ask')
        if "grip_n" in command:
            force_n = command["grip_n"]
            if isinstance(force_n, bool) or not isinstance(force_n, int | float):
                return _refusal("grip_n: a number of newtons")
            try:
                move_grip(self._contact, float(force_n))
            except (ConfigError, OverflowError) as error:
                return _refusal(str(error))
        return {"ok": True, "scene_s": scene_s} | contact_report(self._contact, scene_s)


def contact_report(contact: SceneContact, scene_s: float) -> dict[str, Any]:
    """Truth about the contact at one instant as plain data."""
    state = contact.state(np.array([max(scene_s, 0.0)]))
    return {
        "grip_n": float(state.load_n[0]),
        "slipping": float(state.slipping_share[0]),
        "travel_mm": state.travel_mm[0].tolist(),
        "velocity_mm_s": state.velocity_mm_s[0].tolist(),
        "normal_n": state.normal_n[0].tolist(),
        "tangential_n": state.tangential_n[0].tolist(),
        "fallen": isinstance(contact, PhysicalContact) and contact.has_fallen,
    }


class UnixLink(TcpLink):
    """Unix socket for one controller at a time; its file is removed at close."""

    def __init__(self, path: Path) -> None:
        super().__init__("", 0)
        self._path = path

    def open(self) -> None:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            if self._path.is_socket():
                self._path.unlink()  # left by an emulator that was killed
            listener.bind(str(self._path))
        except OSError as error:
            listener.close()
            why = error.strerror or str(error)
            raise ConfigError("control", [f"cannot listen on {self._path}: {why}"]) from None
        listener.listen()
        listener.setblocking(False)
        self._listener = listener

    def close(self) -> None:
        if self._listener is not None:
            self._path.unlink(missing_ok=True)
        super().close()

    def describe(self) -> dict[str, str]:
        return {"link": f"unix://{self._path}"}


def control_link(address: str) -> HostLink:
    """Socket at ``unix:///PATH`` or ``tcp://HOST:PORT``; `ConfigError` for anything else."""
    if address.startswith("unix://"):
        return UnixLink(Path(address.removeprefix("unix://")))
    return make_link(None, address)


def _refusal(why: str) -> dict[str, Any]:
    return {"ok": False, "error": why}

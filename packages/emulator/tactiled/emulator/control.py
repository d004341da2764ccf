"""Control socket of the emulator: a controller changes the grip on a held object while the scene runs.

Lines of JSON, one answer for each, in order::

    {"grip_n": 25.0}   ->  {"ok": true, "scene_s": 3.21, "duration_s": 7.0, "grip_n": 18.4, ...}
    {}                 ->  the same answer, grip unchanged
    anything else      ->  {"ok": false, "error": "..."}

A grip takes effect from the next scan on; the grip force follows it at the scene's `grip_rate_n_s`, and the
answer contains the present force.
"""

import json
from typing import Any

import numpy as np

from tactiled.emulator.scene.contact import SceneContact
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.errors import ConfigError

_LONGEST_LINE = 4096  # bytes; longer lines are no command and are dropped, which bounds memory


def move_grip(contact: SceneContact, force_n: float) -> None:
    """Set the grip on a held object; `ConfigError` if there is none, or the force is not from 0 to 2000 N."""
    if not isinstance(contact, PhysicalContact) or contact.held is None:
        raise ConfigError("grip", ["this scene has no held object: there is nothing to grip"])
    contact.held.grip(force_n)


class ControlLines:
    """Protocol of the control socket, without I/O: bytes of one peer in, answers out.

    `duration_s` is that of the scene.
    """

    def __init__(self, contact: SceneContact, duration_s: float) -> None:
        self._contact, self._duration_s = contact, duration_s
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
        times = {"scene_s": scene_s, "duration_s": self._duration_s}
        return {"ok": True, **times, **contact_report(self._contact, scene_s)}


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
        "fallen": has_fallen(contact),
    }


def has_fallen(contact: SceneContact) -> bool:
    """Return whether a held object has slipped out of the grip."""
    return isinstance(contact, PhysicalContact) and contact.held is not None and contact.held.has_fallen


def _refusal(why: str) -> dict[str, Any]:
    return {"ok": False, "error": why}

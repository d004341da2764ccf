"""Controller that shows what the gripper allows: it is told the truth, and reacts at once."""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from bench.hold.play import MOST_N
from tactiled.emulator.scene.families.holding import START_N

# Set on seeds 500 to 739 (true messages): twice or half of each changes the mean grip by at most 6 %.
_LEAD_S = 0.04  # growth of shear is extrapolated by a gripper's delay
_GROWTH_SCANS = 3
_SQUEEZE = 1.5  # times the present force, while everything slides
_CALM_S, _EASE_PER_S = 0.05, 5.0
_GROWS, _LEAST = 0.08, 0.05  # of the shear; of the load


class UtilisationController:
    """Grip that keeps the true utilisation at a target, for messages that are true (`TrueMessages`).

    Parameters
    ----------
    target : float
        Utilisation.
    """

    def __init__(self, target: float) -> None:
        self._target = target
        self._command_n, self._eases_from_s = START_N, 0.0
        self._shears: deque[float] = deque(maxlen=_GROWTH_SCANS + 1)
        self._last_s = 0.0

    def take(self, message: Mapping[str, Any], present_n: float) -> float:
        """Return the force to command (N)."""
        now_s, friction = message["timestamp"], message["friction"]
        step_s, self._last_s = now_s - self._last_s, now_s
        if not message["valid"] or message["state"] == "none":
            return self._command_n
        shear = math.hypot(message["shear_x"], message["shear_y"])
        self._shears.append(shear)
        ahead = min(_LEAD_S * max(shear - self._shears[0], 0.0) / (_GROWTH_SCANS * step_s), shear / 2)
        wanted_n = max(shear / (friction * self._target), (shear + ahead) / friction)
        slides = message["state"] == "gross"
        if slides:
            wanted_n = max(wanted_n, _SQUEEZE * present_n)
        if slides or ahead > _GROWS * shear or wanted_n > self._command_n or shear < _LEAST * message["load"]:
            self._eases_from_s = now_s + (2 if slides else 1) * _CALM_S
        if wanted_n > self._command_n:
            self._command_n = min(wanted_n, MOST_N)
        elif now_s > self._eases_from_s:
            self._command_n -= _EASE_PER_S * step_s * (self._command_n - wanted_n)
        return self._command_n

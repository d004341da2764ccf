"""Hold an object of unknown weight and friction with as little force as is safe.

Try it on an emulated object, in three terminals::

    tactiled emulate --scene hold --link /tmp/board --control unix:///tmp/gripper
    tactiled run --config hold.toml
    python examples/hold.py unix:///tmp/gripper

`hold.toml`::

    port.url = "/tmp/board"
    detect.grip.enabled = true

Assumptions; check them for your hand:

- The gripper takes a force in newtons, tells the force that it exerts now, and follows within 50 ms.
- The fingers press for 0.6 s before they lift: in this time the sensor's zero in shear is measured.
- The object's weight is carried by the sensorised finger and an equal one opposite.
- Load readings are about proportional to the force. They may be in any unit.
"""

import contextlib
import json
import math
import socket
import sys
from collections import deque
from collections.abc import Mapping
from typing import Any

from tactiled.client import Message, Stale, Subscription

# Set on emulated grasps (`./run bench hold`, seeds from 500); docs/hold.md has what they give on others.
TARGET = 0.75  # utilisation (95 % quantile) at which an object is held
PROBE = 0.8  # by likely friction: the grip is eased so far once, because friction shows near the limit only
LEAD_S = 0.08  # growing shear is extrapolated so far: sensing, a gripper's delay and its travel
LEAD_MOST = 0.5  # of the shear, that is added so at most: jerks end
GROWTH_S = 0.03  # over which the growth of shear is measured
GROWS = 0.08  # of the shear, by which it is extrapolated where it clearly grows
REST_S, FALL_S = 0.6, 0.15  # shear is compared with what was borne so long ago
FALL = 0.04  # of the shear that was borne, by which it falls only if the object slides or is set down
LEAST = 0.05  # of the load: less shear is no object in the air
STEADY, STEADY_S = 0.03, 0.1  # a grip that has changed by less than this part for this time is steady
UNSTEADY = 1.2  # newtons over readings of a changing grip, over those of a steady one, at most
FORGET_PER_S = 0.005  # rate at which the friction bound is lost: surfaces get wet
RECOVER_PER_S = 0.1  # rate at which the ratio of the last slip is forgotten
CALM_S, CALM_AFTER_SLIP_S = 0.2, 1.0  # without growth of shear or slip, before the grip is eased
EASE_PER_S = 3.0  # rate at which the grip in excess is eased
GRASP_AGAIN = 1.3  # times the present force, while everything slides
GRASP_MOST = 2.0  # times the command before the slip, at most
BLIND = 1.3  # times the grip that was wanted last, while tactile data are stale


class HoldController:
    """Compute the grip from `grip` messages; pure, so that it can be simulated.

    Parameters
    ----------
    target : float
        Highest utilisation (95 % quantile) that is left as it is.
    start_n, least_n, most_n : float
        Grip before the object's weight is felt, and the limits of the grip.
    """

    def __init__(
        self, target: float = TARGET, start_n: float = 6.0, least_n: float = 1.0, most_n: float = 40.0
    ) -> None:
        self._target, self._least_n, self._most_n = target, least_n, most_n
        self.command_n = start_n
        self._forget()

    def _forget(self) -> None:
        """Begin with another object."""
        self._friction = 0.0  # shear over load that is borne with 95 %, in units of the readings
        self._slid = math.inf  # shear over load at the last slip
        self._past: deque[tuple[float, float, float]] = deque()  # time, shear, load
        self._calm_from_s = 0.0
        self._held_n, self._wanted_n = self.command_n, 0.0
        self._level_n = self._newtons = self._steady_from_s = 0.0
        self._probes = True

    def take(self, grip: Mapping[str, Any], present_n: float) -> float:
        """Return the force to command (N), from a `grip` message and the force exerted now."""
        now_s, load = grip["timestamp"], grip["load"]
        if grip["state"] == "none":
            self._forget()
        if grip["state"] == "none" or not grip["valid"] or grip["late"] or load <= 0:
            return self.command_n
        shear = math.hypot(grip["shear_x"], grip["shear_y"])
        step_s = min(now_s - self._past[-1][0], 0.1) if self._past else 0.0
        slides = grip["state"] == "gross" or self._falls(now_s, shear, load)
        self._slid *= 1 + RECOVER_PER_S * step_s
        if slides:
            self._slid = max(shear / load, 1e-6)
        self._friction *= 1 - FORGET_PER_S * step_s
        self._friction = min(max(self._friction, grip["friction_low"]), self._slid)
        newtons = self._newtons_per_load(now_s, present_n, load)
        # Growth is met with likely friction: with the bound, each lift would be a squeeze.
        likely = max(math.sqrt(self._friction * grip["friction"]), self._friction)
        bearable = self._friction * self._target
        if self._probes:
            bearable = max(bearable, PROBE * likely)
            self._probes = not slides and (now_s < self._calm_from_s or shear / load < 0.97 * bearable)
        ahead = shear + min(LEAD_S * self._growth(now_s, shear), LEAD_MOST * shear)
        wanted_n = newtons * max(shear / bearable, ahead / likely)
        if not slides:
            self._held_n = self.command_n
        else:
            wanted_n = max(wanted_n, min(GRASP_AGAIN * present_n, GRASP_MOST * self._held_n))
        if slides or not self._past:
            self._calm_from_s = now_s + CALM_AFTER_SLIP_S
        elif wanted_n > self.command_n or ahead > (1 + GROWS) * shear or shear < LEAST * load:
            self._calm_from_s = max(now_s + CALM_S, self._calm_from_s)
        self._wanted_n = wanted_n
        if wanted_n > self.command_n:
            self.command_n = wanted_n
        elif now_s > self._calm_from_s:
            self.command_n -= EASE_PER_S * step_s * (self.command_n - wanted_n)
        self.command_n = min(max(self.command_n, self._least_n), self._most_n)
        self._past.append((now_s, shear, load))
        return self.command_n

    def blind(self) -> float:
        """Return the force to command while tactile data are stale: tighter, and not eased."""
        self.command_n = min(max(self.command_n, BLIND * self._wanted_n), self._most_n)
        self._past.clear()
        return self.command_n

    def _newtons_per_load(self, now_s: float, present_n: float, load: float) -> float:
        """Force over load reading, measured while the grip is steady: message and gripper differ in age."""
        if abs(present_n - self._level_n) > STEADY * self._level_n:
            self._level_n, self._steady_from_s = present_n, now_s + STEADY_S
        now = present_n / load
        if now_s >= self._steady_from_s or not self._newtons:
            self._newtons = now
        return min(max(now, self._newtons), UNSTEADY * self._newtons)

    def _falls(self, now_s: float, shear: float, load: float) -> bool:
        """Return True where shear fell below all that was borne lately, and not by a tighter grip."""
        while self._past and self._past[0][0] < now_s - REST_S:
            self._past.popleft()
        borne = [s for t, s, _ in self._past if t < now_s - FALL_S]
        if len(borne) < 10 or shear < LEAST * load:
            return False
        return shear < (1 - FALL) * min(borne) and load < 1.02 * min(p for _, _, p in self._past)

    def _growth(self, now_s: float, shear: float) -> float:
        """Rate at which shear has grown over `GROWTH_S`, 0 where it has not."""
        before = [s for t, s, _ in self._past if t >= now_s - GROWTH_S - 1e-3]
        return max(shear - before[0], 0.0) / GROWTH_S if before else 0.0


class EmulatedGripper:
    """Gripper of `tactiled emulate --control`; replace it by yours."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(address.removeprefix("unix://"))
        self._answers = self._socket.makefile()

    def move(self, force_n: float) -> float:
        """Command a force; return the one that is exerted now."""
        self._socket.sendall(json.dumps({"grip_n": force_n}).encode() + b"\n")
        return float(json.loads(self._answers.readline())["grip_n"])


def main(address: str, endpoint: str = "tcp://127.0.0.1:9872") -> None:
    """Hold until Ctrl-C."""
    gripper, controller = EmulatedGripper(address), HoldController()
    present_n = gripper.move(controller.command_n)
    with Subscription(endpoint, topics=("grip",)) as subscription:
        while True:
            match subscription.next_item():
                case Message(topic="grip", data=grip) if subscription.fresh:
                    present_n = gripper.move(controller.take(grip, present_n))
                case Stale():
                    present_n = gripper.move(controller.blind())


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main(*sys.argv[1:])

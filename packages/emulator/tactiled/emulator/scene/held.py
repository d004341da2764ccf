"""Motion of a held object under its load, friction and the force of a spring.

Newton's second law for the place u of the skin over the object, ``m u'' = pull + spring (end - u) +
friction - damping``, stepped semi-implicitly (velocity first: stable for oscillators up to ``step < 2 /
omega``, Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, section I.1). All directions are
those in which the skin moves over the object.
"""

import math
from collections.abc import Callable

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import TaxelForces, stacked
from tactiled.emulator.mechanics.lumped import indentation_mm
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import MotionState
from tactiled.emulator.scene.phases import LARGEST_FORCE_N, HeldObject, LoadPhase, PressPhase
from tactiled.errors import ConfigError

Feel = Callable[[float, FloatArray, float], TaxelForces]

_STABLE = 0.5  # step times omega; 2 is the limit of stability
# Tangential stiffness of a taxel at rest over its load per indentation (`lumped`).
_STIFFNESS = 0.6
# Damping of the object by the sticking skin; silicones have about 0.2 of critical.
DAMPING_RATIO = 0.2


class HeldMotion:
    """Load and place of the skin over a held object; `step_s` is the longest, or shorter to be stable."""

    def __init__(self, scene: Scene, params: HeldObject, longest_step_s: float) -> None:
        self._params = params
        forces = [p.force_n for p in scene.phases if isinstance(p, PressPhase | LoadPhase) and p.force_n]
        # A controller may grip four times as hard as the scene before the margin of stability is used up.
        self._stiffness_n_mm = stiffness_n_mm(max(forces))
        rate = math.sqrt((self._stiffness_n_mm + params.spring_n_mm) * 1e3 / params.mass_kg)
        self.step_s = longest_step_s / math.ceil(max(longest_step_s * rate / _STABLE, 1.0))
        self._delay_steps = round(params.grip_delay_s / self.step_s)
        self._commands: list[tuple[int, float]] = []
        self.reset()

    def reset(self) -> None:
        """Return to scene time 0; a controller's grips are repeated at their instants."""
        self._k = 0
        self._done = 0
        self._grip_goal_n: float | None = None
        self._grip_n = 0.0
        self._place = self._velocity = self._friction = 0j  # x + iy
        self._held_share = 1.0
        self.has_fallen = False

    def grip(self, force_n: float) -> None:
        """Set a controller's grip, in place of the scene's load, from the end of the gripper's delay on."""
        if not 0 <= force_n <= LARGEST_FORCE_N:
            raise ConfigError("grip", [f"{force_n} N is not a force from 0 to {LARGEST_FORCE_N:g} N"])
        if step_n := self._params.grip_step_n:
            force_n = step_n * round(force_n / step_n)
        if not self._commands or self._commands[-1][1] != force_n:
            self._commands.append((self._k + self._delay_steps, force_n))

    def play(self, drive: MotionState, feel: Feel) -> tuple[FloatArray, FloatArray, TaxelForces]:
        """Do the next n steps: loads (n,), places (n, 2) and forces with a leading axis n.

        `drive` is the motion of the scene at the steps; `feel` converts grip, place of the skin (2,) and
        friction over that of the plate to the forces of a step.
        """
        end = drive.travel_x_mm + 1j * drive.travel_y_mm
        force = drive.pull_x_n + 1j * drive.pull_y_n + self._params.spring_n_mm * end
        load_n, place_mm, felt = np.empty(len(end)), np.empty((len(end), 2)), []
        for k in range(len(end)):
            self._grip(float(drive.load_n[k]))
            if self._k > 0:
                self._move(complex(force[k]))
            self._k += 1
            load_n[k] = self._grip_n
            place_mm[k] = self._place.real, self._place.imag
            felt.append(feel(self._grip_n, place_mm[k], float(drive.friction_part[k])))
            x, y = felt[-1].tangential_n.sum(axis=0)
            self._friction = complex(x, y)
            self._held_share = 1 - float(felt[-1].slipping.mean()) if self._grip_n > 0 else 0.0
        return load_n, place_mm, stacked(felt)

    def _grip(self, scene_n: float) -> None:
        """Follow the controller, or the scene without one."""
        while self._done < len(self._commands) and self._commands[self._done][0] <= self._k:
            self._grip_goal_n = self._commands[self._done][1]
            self._done += 1
        if self._grip_goal_n is None:
            self._grip_n = scene_n
        else:
            most = self._params.grip_rate_n_s * self.step_s
            self._grip_n += min(max(self._grip_goal_n - self._grip_n, -most), most)

    def _move(self, force: complex) -> None:
        """Move the object by one step under `force` (pull and far end of the spring), friction and spring."""
        params = self._params
        mass = params.mass_kg * 1e-3  # N s2/mm
        damping = 2 * DAMPING_RATIO * math.sqrt(self._stiffness_n_mm * mass) * self._held_share
        force += self._friction - params.spring_n_mm * self._place
        self._velocity = (self._velocity + force * self.step_s / mass) / (1 + damping * self.step_s / mass)
        self._place = self._place + self._velocity * self.step_s
        way = abs(self._place)
        if way > params.fall_mm and not params.spring_n_mm:
            self.has_fallen = True
            self._place = self._place * (params.fall_mm / way)
            self._velocity = 0j


def stiffness_n_mm(force_n: float) -> float:
    """Tangential stiffness at rest of nine taxels under `force_n`."""
    each = force_n / 9
    return float(9 * _STIFFNESS * each / indentation_mm(np.array(each)))

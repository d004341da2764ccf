"""Motion of a held object under its load, friction and the force of a spring.

Newton's second law for the place u of the skin over the object, ``m u'' = pull + spring (end - u) +
friction - damping``, stepped semi-implicitly (velocity first: stable for oscillators up to ``step < 2 /
omega``, Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, section I.1). All directions are
those in which the skin moves over the object.
"""

import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import TaxelForces
from tactiled.emulator.mechanics.lumped import Lumped, indentation_mm
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import MotionState
from tactiled.emulator.scene.phases import LARGEST_FORCE_N, HeldObject, LoadPhase, PressPhase
from tactiled.errors import ConfigError

_STABLE = 0.5  # step times omega; 2 is the limit of stability
# Tangential stiffness of a taxel at rest over its load per indentation (`lumped`).
_STIFFNESS = 0.6
# Damping of the object by the sticking skin; silicones have about 0.2 of critical.
DAMPING_RATIO = 0.2


class HeldMotion:
    """Load and place of the skin over a held object.

    `share` (t,) is that of each taxel in the load; `taxel_mm` (t, 2) are the places of the taxels, of which
    the surface is at `offset_mm`.
    """

    def __init__(
        self,
        scene: Scene,
        params: HeldObject,
        model: Lumped,
        share: FloatArray,
        taxel_mm: FloatArray,
        offset_mm: FloatArray,
    ) -> None:
        self._params, self._model, self._share = params, model, share
        self._taxel_mm, self._offset_mm = taxel_mm, offset_mm
        forces = [p.force_n for p in scene.phases if isinstance(p, PressPhase | LoadPhase) and p.force_n]
        # A controller may grip four times as hard as the scene before the margin of stability is used up.
        stiffness = stiffness_n_mm(max(forces))
        self._mass = params.mass_kg * 1e-3  # N s2/mm
        self._damping = 2 * DAMPING_RATIO * math.sqrt(stiffness * self._mass)  # N s/mm, of all taxels
        rate = math.sqrt((stiffness + params.spring_n_mm) * 1e3 / params.mass_kg)
        # That of the model, or shorter to be stable.
        self.step_s = model.step_s / math.ceil(max(model.step_s * rate / _STABLE, 1.0))
        self._delay_steps = round(params.grip_delay_s / self.step_s)
        self._commands: list[tuple[int, float]] = []
        self._k = self._newest = 0
        self.has_fallen = False
        self.reset()

    def reset(self) -> None:
        """Return to scene time 0, to look back; a controller's grips are repeated at their instants."""
        self._newest = max(self._newest, self._k)
        self._k = 0
        self._done = 0
        self._grip_goal_n: float | None = None
        self._grip_n = 0.0
        self._place = self._velocity = self._friction = 0j  # x + iy
        self._held_share = 1.0

    def grip(self, force_n: float) -> None:
        """Set a controller's grip, in place of the scene's load, from the end of the gripper's delay on."""
        if not 0 <= force_n <= LARGEST_FORCE_N:
            raise ConfigError("grip", [f"{force_n} N is not a force from 0 to {LARGEST_FORCE_N:g} N"])
        if step_n := self._params.grip_step_n:
            force_n = step_n * round(force_n / step_n)
        if not self._commands or self._commands[-1][1] != force_n:
            now = max(self._newest, self._k)
            self._commands.append((now + self._delay_steps, force_n))

    def play(self, drive: MotionState) -> tuple[FloatArray, FloatArray, TaxelForces]:
        """Do the next n steps, with the scene's motion at them: loads (n,), places (n, 2) and forces."""
        model, n, t = self._model, len(drive.load_n), len(self._share)
        load_n = np.array(
            [self._grip(self._k + k, scene_n) for k, scene_n in enumerate(drive.load_n.tolist())]
        )
        pressed = model.press(load_n[:, None] * self._share)
        force = (drive.pull_n + self._params.spring_n_mm * drive.travel_mm).tolist()
        place_mm, tangential_n, slipping = np.empty((n, 2)), np.empty((n, 2, t)), np.empty((n, t))
        for k, friction_part in enumerate(drive.friction_part.tolist()):
            if self._k > 0:
                self._move(force[k])
            self._k += 1
            place_mm[k] = self._place.real, self._place.imag
            model.friction_part = friction_part
            base_mm = self._taxel_mm + place_mm[k] - self._offset_mm
            pull_n, slips = model.slide(pressed.step(k), base_mm[None], self.step_s)
            tangential_n[k], slipping[k] = pull_n[0].T, slips[0]
            x, y = np.add.reduce(pull_n[0])
            self._friction = complex(x, y)
            self._held_share = 1 - float(np.add.reduce(slips[0])) / t if load_n[k] > 0 else 0.0
        return load_n, place_mm, model.felt(pressed, tangential_n.swapaxes(1, 2), slipping)

    def _grip(self, k: int, scene_n: float) -> float:
        """Grip at step k, by the controller, or by the scene without one."""
        while self._done < len(self._commands) and self._commands[self._done][0] <= k:
            self._grip_goal_n = self._commands[self._done][1]
            self._done += 1
        if self._grip_goal_n is None:
            self._grip_n = scene_n
        else:
            most = self._params.grip_rate_n_s * self.step_s
            self._grip_n += min(max(self._grip_goal_n - self._grip_n, -most), most)
        return self._grip_n

    def _move(self, force: complex) -> None:
        """Move the object by one step under `force` (pull and far end of the spring), friction and spring."""
        params, mass, step_s = self._params, self._mass, self.step_s
        damping = self._damping * self._held_share
        force += self._friction - params.spring_n_mm * self._place
        self._velocity = (self._velocity + force * step_s / mass) / (1 + damping * step_s / mass)
        self._place = self._place + self._velocity * step_s
        way = abs(self._place)
        if way > params.fall_mm and not params.spring_n_mm:
            self.has_fallen = True
            self._place = self._place * (params.fall_mm / way)
            self._velocity = 0j


def stiffness_n_mm(force_n: float) -> float:
    """Tangential stiffness at rest of nine taxels under `force_n`."""
    each = force_n / 9
    return float(9 * _STIFFNESS * each / indentation_mm(np.array(each)))

"""Many held objects at once: the emulator's contact model, electronics and equation of motion in arrays.

`HeldBatch` does for scenes of `families.holding` what `Simulation` does for one: a test compares the two.
Scans are taken at one instant for all channels, and arrive without line or clock.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray, load_array
from tactiled.emulator.board import electronics
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.held import DAMPING_RATIO, stiffness_n_mm
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.phases import FlatPlate, PressPhase
from tactiled.emulator.scene.taxels import ChannelForces, offset_mm, taxel_shares

ARRAY = load_array("wang2019-3x3")
STEP_S = 1e-3  # a fifth of the period of the lightest object on the skin
RATE_HZ = 100.0
_STEPS = round(1 / RATE_HZ / STEP_S)
ADC_BITS, ADC_V = 12, 3.0  # of the 2019 circuit
ALL_SLIDES = 0.99  # share of the contact area from which all of it slips


class HeldBatch:
    """Held objects (e,) in grippers, all stepped together.

    Scenes are of contact model lumped and of equal duration, with a held object without spring.
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        held = [scene.held_object for scene in scenes]
        plates = [scene.surface for scene in scenes]
        motions = [SceneMotion(scene) for scene in scenes]
        e, t = len(scenes), ARRAY.n_taxels
        self.n_scans = round(scenes[0].duration_s * RATE_HZ)
        time_s: FloatArray = np.arange(self.n_scans * _STEPS + 1) * np.float64(STEP_S)
        drives = [motion.at(time_s) for motion in motions]
        self._scene_n = np.stack([drive.load_n for drive in drives])
        self._pull_n = np.stack([drive.pull_n for drive in drives])
        self._friction_part = np.stack([drive.friction_part for drive in drives])
        self._share = np.concatenate([taxel_shares(motion, ARRAY) for motion in motions])
        self._mass = np.array([1e-3 * h.mass_kg for h in held if h])  # N s2/mm
        self._fall_mm = np.array([h.fall_mm for h in held if h])
        self._most_n = np.array([h.grip_rate_n_s * STEP_S for h in held if h])
        self._delay = np.array([round(h.grip_delay_s / STEP_S) for h in held if h])
        self._step_n = np.array([h.grip_step_n or 1e-9 for h in held if h])
        presses = [next(p.force_n for p in scene.phases if isinstance(p, PressPhase)) for scene in scenes]
        self._stiffness = np.array([stiffness_n_mm(force_n) for force_n in presses])
        self._at_rest = np.array([plate.friction * plate.static_ratio for plate in plates])
        read = [ChannelForces(motion, ARRAY) for motion in motions]
        self._area, self._gain = read[0].area, np.stack([one.gain for one in read])
        surface = _surfaces([plate for plate in plates if isinstance(plate, FlatPlate)], t)
        self._model = Lumped(surface, read[0].azimuth_deg, e * t)
        places = np.stack([ARRAY.x_mm, ARRAY.y_mm], axis=-1)
        offsets = [offset_mm(plate, scene.seed) for plate, scene in zip(plates, scenes, strict=True)]
        self._base_mm = np.concatenate([places - offset for offset in offsets])
        self._electronics = scenes[0].electronics
        self._noise_v = np.array([scene.electronics.noise_v for scene in scenes])
        self._rngs = [np.random.default_rng([scene.seed, 3]) for scene in scenes]
        self._crept_n = np.zeros(e)
        self._e, self._t, self._k = e, t, 0
        self.grip_n = np.zeros(e)  # present grip, and the one that the gripper follows
        self._goals = np.full((int(self._delay.max()) + 1, e), np.nan)  # by step, in a ring
        self.goal_n = np.full(e, np.nan)
        self._place, self._velocity = np.zeros(e, complex), np.zeros(e, complex)
        self._friction_n, self._held_share = np.zeros(e, complex), np.ones(e)
        self.has_fallen: NDArray[np.bool_] = np.zeros(e, dtype=np.bool_)
        self.sliding = np.zeros(e)  # share of the taxels' contact area that slips
        self.friction = self._at_rest  # coefficient at rest

    @property
    def place_mm(self) -> FloatArray:
        """How far each object has moved over the skin, (e, 2)."""
        return np.stack([self._place.real, self._place.imag], axis=-1)

    @property
    def shear_n(self) -> FloatArray:
        """Friction on the skin (e, 2), against its motion over each object."""
        return np.stack([self._friction_n.real, self._friction_n.imag], axis=-1)

    def command(self, grip_n: FloatArray) -> None:
        """Command the grip of each gripper (e,)."""
        goal = np.clip(self._step_n * np.round(grip_n / self._step_n), 0.0, None)
        self._goals[(self._k + self._delay) % len(self._goals), np.arange(self._e)] = goal

    def scan(self) -> FloatArray:
        """Step to the next scan and return its volts (e, channels)."""
        for _ in range(_STEPS):
            self._step()
        return self._volts()

    def _step(self) -> None:
        k = self._k
        ring = self._goals[k % len(self._goals)]
        self.goal_n = np.where(np.isnan(ring), self.goal_n, ring)
        ring[:] = np.nan
        toward = np.clip(self.goal_n - self.grip_n, -self._most_n, self._most_n)
        self.grip_n = np.where(np.isnan(self.goal_n), self._scene_n[:, k], self.grip_n + toward)
        if k > 0:
            damping = 2 * DAMPING_RATIO * np.sqrt(self._stiffness * self._mass) * self._held_share
            force = self._pull_n[:, k] + self._friction_n
            self._velocity = (self._velocity + force * STEP_S / self._mass) / (
                1 + damping * STEP_S / self._mass
            )
            self._place = self._place + self._velocity * STEP_S
            way = np.abs(self._place)
            fallen = way > self._fall_mm
            self.has_fallen |= fallen
            self._place = np.where(fallen, self._place * (self._fall_mm / np.maximum(way, 1e-9)), self._place)
            self._velocity = np.where(fallen, 0.0, self._velocity)
        self._k += 1
        t = self._t
        self.friction = self._at_rest * self._friction_part[:, k]
        self._model.friction_part = np.repeat(self._friction_part[:, k], t)
        base_mm = self._base_mm + np.repeat(self.place_mm, t, axis=0)
        self._felt = self._model.step(np.repeat(self.grip_n, t) * self._share, base_mm, STEP_S)
        tangential = self._felt.tangential_n.reshape(self._e, t, 2).sum(axis=1)
        self._friction_n = tangential[:, 0] + 1j * tangential[:, 1]
        self.sliding = self._felt.slipping.reshape(self._e, t).mean(axis=1)
        self._held_share = np.where(self.grip_n > 0, 1 - self.sliding, 0.0)
        self._crept_n += (self.grip_n - self._crept_n) * STEP_S / self._electronics.creep_time_s

    def _volts(self) -> FloatArray:
        """Readings of the present contact, with noise and the converter's rounding."""
        params = self._electronics
        side = (
            self._felt.side_n.reshape(self._e, self._t, -1)[:, ARRAY.channel_taxel, self._area] * self._gain
        )
        quarter = electronics.quarter_n(side)
        spread = electronics.spread_n(params, quarter, ARRAY.channel_taxel, ARRAY.azimuth_deg)
        crept = spread * electronics.creep_gain(params, self._crept_n)[:, None]
        volts = electronics.divider_v(params, electronics.conductance_s(params, crept))
        volts = np.where(ARRAY.sign < 0, ADC_V - volts, volts)
        noise = np.stack([rng.standard_normal(volts.shape[1]) for rng in self._rngs])
        counts = electronics.adc_counts(volts + self._noise_v[:, None] * noise, ADC_BITS, ADC_V)
        return np.asarray(counts * (ADC_V / 2**ADC_BITS))


def _surfaces(plates: Sequence[FlatPlate], taxels: int) -> Surface:
    """Plates as one surface whose numbers are arrays (plates * taxels,), which the contact model allows."""
    columns = {
        name: np.repeat([getattr(plate, name) for plate in plates], taxels)
        for name in ("friction", "static_ratio", "stribeck_mm_s", "unevenness")
    }
    return Surface(**columns)  # type: ignore[arg-type]  # its arithmetic is elementwise

"""A scene on a physical contact model: forces on the channels and truth about the contact, at any instant."""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics.base import TaxelForces, TaxelModel
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.periodic import Periodic
from tactiled.emulator.mechanics.stepper import GridInterpolator
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.held import HeldMotion
from tactiled.emulator.scene.loading import CreepLag
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.slip_instants import SlipEpisodeTracker
from tactiled.emulator.scene.taxels import ChannelForces, model_surface, offset_mm, taxel_shares
from tactiled.errors import ConfigError

_SCAN_S = 0.01  # computed at once where a controller may change the grip
_BLOCK_S = 0.16  # computed at once otherwise: some scans, and a short pause of a real-time loop
# Least steps of the grid in a period of a sine, and in a pulse. Between steps contacts are interpolated: that
# takes a twentieth of such a sine and a seventh of such a pulse; of a sine of two steps nothing is left.
_SINE_STEPS, _PULSE_STEPS = 8, 4
_ROUNDING = 1e-9
# Columns of `PhysicalContact` after those of channels and taxels.
_SLIPPING, _LOAD, _TRAVEL, _VELOCITY, _RELAXED, _WHOLE = 0, 1, slice(2, 4), slice(4, 6), 6, 7


@dataclass(frozen=True, eq=False)
class ContactState:
    """Truth at n instants, for t taxels."""

    normal_n: FloatArray  # (n, t)
    tangential_n: FloatArray  # (n, t, 2): friction on the skin, against its motion
    slipping: FloatArray  # (n, t): share of each taxel's contact area that slips
    slipping_share: FloatArray  # (n,): share of the whole contact area that slips
    load_n: FloatArray  # (n,)
    # travel_mm, velocity_mm_s: (n, 2): of the middle of the array over the surface
    travel_mm: FloatArray
    velocity_mm_s: FloatArray


class PhysicalContact:
    """Contact of the skin with the surfaces of a scene, stepped on a model of single taxels.

    The constructor raises `ConfigError` where the model cannot play the scene.

    Columns of the rows on the grid of its steps: forces on the channels; normal force, x and y of the
    tangential force, and slipping share of each taxel; then for the whole contact the slipping share, load,
    travel (2), velocity (2) and the load through the creep's lag.
    """

    def __init__(self, motion: SceneMotion, array: Array, model: type[TaxelModel]) -> None:
        scene = motion.scene
        self._motion = motion
        self._n_channels, self._n_taxels = array.n_channels, array.n_taxels
        self._share = taxel_shares(motion, array)
        self._read = ChannelForces(motion, array)
        surfaces = [model_surface(plate) for plate in motion.surfaces]
        self._models = [model(surface, self._read.azimuth_deg, array.n_taxels) for surface in surfaces]
        self._middle_mm = np.array([array.x_mm.mean(), array.y_mm.mean()])
        self._from_middle = np.stack([array.x_mm, array.y_mm], axis=-1) - self._middle_mm
        self._offset_mm = [offset_mm(plate, scene.seed) for plate in motion.surfaces]
        self.held: HeldMotion | None = None
        self._step_s, block_s = model.step_s, _BLOCK_S
        if scene.held_object is not None:
            (flat,) = self._models
            assert isinstance(flat, Lumped)  # a held object has one flat surface
            taxel_mm = self._middle_mm + self._from_middle
            self.held = HeldMotion(scene, scene.held_object, flat, self._share, taxel_mm, self._offset_mm[0])
            self._step_s, block_s = self.held.step_s, _SCAN_S
        _check_grid(scene, self._step_s)
        self._lag = CreepLag(self._step_s, scene.electronics.creep_time_s)
        # Slip as far as the contact was ever computed; a look back does not shorten it.
        self.watch = SlipEpisodeTracker()
        block = max(1, round(block_s / self._step_s))
        self._stepper = GridInterpolator(self, step_s=self._step_s, block=block)

    @property
    def has_tables(self) -> bool:
        """Return whether the plates of the scene are played from tables, which may have to be solved."""
        return isinstance(self._models[0], Periodic)

    @property
    def played_s(self) -> float:
        """Scene time up to which the contact is computed."""
        return self._stepper.made_s

    def play_until(self, end_s: float) -> None:
        """Compute the contact up to an instant of scene time."""
        while self.played_s < end_s:
            self._stepper.at(np.array([[self.played_s + _BLOCK_S]]), np.zeros(1, dtype=np.int64))

    def forces(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forces (N) on the channels' read-out areas, and the total load (N) through the lag of creep.

        Each channel is at its own instants of scene time; `time_s` and both results are (n, channels).
        Normal force for ``side`` and ``normal`` channels (0 or more), signed tangential force of the taxel
        for ``shear_x`` and ``shear_y``.
        """
        columns = np.full(2 * self._n_channels, self._n_channels + 4 * self._n_taxels + _RELAXED)
        columns[: self._n_channels] = np.arange(self._n_channels)
        found = self._stepper.at(np.concatenate([time_s, time_s], axis=1), columns)
        return found[:, : self._n_channels], found[:, self._n_channels :]

    def state(self, time_s: FloatArray) -> ContactState:
        """Truth at instants (n,) of scene time."""
        columns = self._n_channels + np.arange(4 * self._n_taxels + _WHOLE)
        rows = self._stepper.at(time_s[:, None], columns)
        normal, tx, ty, slipping, whole = np.split(rows, np.arange(1, 5) * self._n_taxels, axis=1)
        return ContactState(
            normal_n=normal,
            tangential_n=np.stack([tx, ty], axis=-1),
            slipping=slipping,
            slipping_share=whole[:, _SLIPPING],
            load_n=whole[:, _LOAD],
            travel_mm=whole[:, _TRAVEL],
            velocity_mm_s=whole[:, _VELOCITY],
        )

    def reset(self) -> None:
        """Return to scene time 0, for the grid; what `watch` has found stays."""
        for model in self._models:
            model.reset()
        self._is_fresh = [True] * len(self._models)
        self._before_mm: FloatArray | None = None
        self._lag.reset()
        if self.held:
            self.held.reset()

    def advance(self, time_s: FloatArray) -> FloatArray:
        """Rows (n, width) at the next n grid points."""
        state = self._motion.at(time_s)
        if self.held is not None:
            return self._rows(time_s, *self.held.play(state))
        travel_mm = np.stack([state.travel_mm.real, state.travel_mm.imag], axis=-1)
        felt = self._step(time_s, state.load_n, travel_mm, np.deg2rad(state.turn_deg))
        return self._rows(time_s, state.load_n, travel_mm, felt)

    def _step(
        self, time_s: FloatArray, load_n: FloatArray, travel_mm: FloatArray, turn: FloatArray
    ) -> TaxelForces:
        """Forces (n, t) of all taxels on the plates that the skin touches at these instants."""
        loads_n = np.maximum(load_n[:, None] * self._share, 0.0)
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = self._from_middle[:, 0], self._from_middle[:, 1]
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        base_mm = self._middle_mm + turned + travel_mm[:, None, :]
        parts: list[tuple[FloatArray, TaxelForces]] = []
        for number, model in enumerate(self._models):
            share = self._motion.surface_share(number, time_s)
            if not share.any():
                if not self._is_fresh[number]:
                    model.reset()
                self._is_fresh[number] = True
                continue
            self._is_fresh[number] = False
            felt = model.run(loads_n, base_mm - self._offset_mm[number], self._step_s)
            parts.append((share, felt))
        return parts[0][1] if len(parts) == 1 else _blended(parts)

    def _rows(
        self, time_s: FloatArray, load_n: FloatArray, travel_mm: FloatArray, felt: TaxelForces
    ) -> FloatArray:
        slipping_share = _slipping_share(felt)
        before = travel_mm[:1] if self._before_mm is None else self._before_mm[None]
        velocity = np.diff(travel_mm, axis=0, prepend=before) / self._step_s
        self._before_mm = travel_mm[-1]
        shear_n = np.linalg.norm(felt.tangential_n, axis=-1).sum(axis=1)
        self.watch.feed(time_s, slipping_share, felt.normal_n.sum(axis=1), shear_n, travel_mm)
        return np.concatenate(
            [
                self._read.channels(felt),
                felt.normal_n,
                felt.tangential_n[..., 0],
                felt.tangential_n[..., 1],
                felt.slipping,
                slipping_share[:, None],
                load_n[:, None],
                travel_mm,
                velocity,
                self._lag.feed(load_n)[:, None],
            ],
            axis=1,
        )


def _check_grid(scene: Scene, step_s: float) -> None:
    """Raise `ConfigError` for a disturbance that is too fast for the grid of the contact model."""
    for number, extra in enumerate(scene.disturbances):
        place, fault = f"disturbances[{number}]", ""
        if extra.on == "temperature_k":  # is not stepped
            continue
        if extra.shape == "sine" and extra.frequency_hz * step_s * _SINE_STEPS > 1 + _ROUNDING:
            most_hz = 1 / (step_s * _SINE_STEPS)
            fault = f"{place}.frequency_hz: this contact plays {most_hz:g} Hz at most"
        elif extra.shape == "pulse" and extra.duration_s < step_s * _PULSE_STEPS * (1 - _ROUNDING):
            fault = f"{place}.duration_s: this contact plays pulses of {step_s * _PULSE_STEPS:g} s at least"
        if fault:
            raise ConfigError(f"scene {scene.name}", [fault])


def _slipping_share(felt: TaxelForces) -> FloatArray:
    """Share (n,) of the contact area that slips; the area of a ball is proportional to its indentation."""
    area = felt.indentation_mm * (felt.normal_n > 0)
    return np.asarray((felt.slipping * area).sum(axis=1) / np.maximum(area.sum(axis=1), 1e-12))


def _blended(parts: list[tuple[FloatArray, TaxelForces]]) -> TaxelForces:
    """Forces on a skin that is partly on one plate and partly on the next."""

    def blend(name: str) -> FloatArray:
        return np.asarray(
            sum(
                share.reshape(-1, *[1] * (vars(felt)[name].ndim - 1)) * vars(felt)[name]
                for share, felt in parts
            )
        )

    names = ("normal_n", "tangential_n", "side_n", "slipping", "indentation_mm")
    return TaxelForces(**{name: blend(name) for name in names})

"""What a scene imposes on each taxel, step by step: the source behind `physical`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics.base import (
    BEYOND_REFERENCES,
    Rung,
    Surface,
    TaxelForces,
    beyond_references,
)
from tactiled.emulator.mechanics.lumped import indentation_mm
from tactiled.emulator.mechanics.stepper import play
from tactiled.emulator.scene.held import HeldMotion
from tactiled.emulator.scene.loading import LoadMemory
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.slip_instants import SlipEpisodeTracker
from tactiled.emulator.scene.taxels import ChannelForces, offset_mm, rung_surface, taxel_shares

Build = Callable[[Surface, FloatArray, int], Rung]


class TaxelDrive:
    """A `stepper.Source` of a scene on a rung.

    Parameters as for `physical.PhysicalContact`. Columns of its rows: forces on the channels; normal, x and
    y forces and slipping share of each taxel; of the whole contact slipping share, load, travel (2), velocity
    (2), load through the scene's creep, and the largest load since it was made.
    """

    def __init__(self, motion: SceneMotion, array: Array, build: Build, step_s: float, name: str) -> None:
        scene = motion.scene
        self._motion = motion
        self._array = array
        self._imposes = scene.held
        self._share = taxel_shares(motion, array)
        self._read = ChannelForces(motion, array)
        surfaces = [rung_surface(plate, name) for plate in motion.surfaces]
        self._rungs = [build(surface, self._read.azimuth_deg, array.n_taxels) for surface in surfaces]
        middle = np.array([array.x_mm.mean(), array.y_mm.mean()])
        self._from_middle = np.stack([array.x_mm, array.y_mm], axis=-1) - middle
        self._middle_mm = middle
        self._offset_mm = [offset_mm(plate) for plate in motion.surfaces]
        self.held = HeldMotion(scene, scene.held_object, step_s) if scene.held_object else None
        self.step_s = self.held.step_s if self.held else step_s
        self._memory = LoadMemory(self.step_s, scene.electronics.creep_time_s)
        self.reset()

    def reset(self) -> None:
        for rung in self._rungs:
            rung.reset()
        self._is_fresh = [True] * len(self._rungs)
        self._k = 0
        self._before_mm: FloatArray | None = None
        self._memory.reset()
        self.watch = SlipEpisodeTracker()
        self.warnings: dict[int, float] = {}
        if self.held:
            self.held.reset()

    def advance(self, n: int) -> FloatArray:
        time_s: FloatArray = np.arange(self._k, self._k + n) * np.float64(self.step_s)
        self._k += n
        if self.held is None:
            state = self._motion.at(time_s)
            travel_mm = np.stack([state.travel_x_mm, state.travel_y_mm], axis=-1)
            felt = self._step(time_s, state.load_n, travel_mm, np.deg2rad(state.turn_deg))
            return self._rows(time_s, state.load_n, travel_mm, felt)
        load_n, travel_mm, felt = self.held.play(self._motion.at(time_s), self._feel)
        return self._rows(time_s, load_n, travel_mm, felt)

    def _feel(self, load_n: float, place_mm: FloatArray) -> TaxelForces:
        """One step on a held object, which has one surface."""
        base_mm = self._middle_mm + self._from_middle + place_mm - self._offset_mm[0]
        return self._rungs[0].step("force", load_n * self._share, base_mm, self.step_s)

    def _step(
        self, time_s: FloatArray, load_n: FloatArray, travel_mm: FloatArray, turn: FloatArray
    ) -> TaxelForces:
        """Forces of all taxels (n, t) on whatever plates there are."""
        value = np.maximum(load_n[:, None] * self._share, 0.0)
        if self._imposes == "displacement":
            value = indentation_mm(value)
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = self._from_middle[:, 0], self._from_middle[:, 1]
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        base_mm = self._middle_mm + turned + travel_mm[:, None, :]
        parts: list[tuple[FloatArray, TaxelForces]] = []
        for number, rung in enumerate(self._rungs):
            share = self._motion.surface_share(number, time_s)
            if not share.any():
                if not self._is_fresh[number]:
                    rung.reset()
                self._is_fresh[number] = True
                continue
            self._is_fresh[number] = False
            felt = play(rung, self._imposes, value, base_mm - self._offset_mm[number], self.step_s)
            parts.append((share, felt))
        return parts[0][1] if len(parts) == 1 else _mixed(parts)

    def _rows(
        self, time_s: FloatArray, load_n: FloatArray, travel_mm: FloatArray, felt: TaxelForces
    ) -> FloatArray:
        overall = _overall(felt)
        before = travel_mm[:1] if self._before_mm is None else self._before_mm[None]
        velocity = np.diff(travel_mm, axis=0, prepend=before) / self.step_s
        self._before_mm = travel_mm[-1]
        shear_n = np.linalg.norm(felt.tangential_n, axis=-1).sum(axis=1)
        self.watch.feed(time_s, overall, felt.normal_n.sum(axis=1), shear_n, travel_mm)
        self._warn(time_s, felt.warnings | np.where(beyond_references(felt), BEYOND_REFERENCES, 0))
        return np.concatenate(
            [
                self._read.channels(felt),
                felt.normal_n,
                felt.tangential_n[..., 0],
                felt.tangential_n[..., 1],
                felt.slipping,
                overall[:, None],
                load_n[:, None],
                travel_mm,
                velocity,
                self._memory.feed(load_n),
            ],
            axis=1,
        )

    def _warn(self, time_s: FloatArray, bits: NDArray[np.int64]) -> None:
        seen = np.bitwise_or.reduce(bits, axis=1)
        for bit in (1 << k for k in range(8)):
            if bit not in self.warnings and (seen & bit).any():
                self.warnings[bit] = float(time_s[np.argmax((seen & bit) > 0)])


def _overall(felt: TaxelForces) -> FloatArray:
    """Share of the whole contact that slips: a ball's contact area grows as the indentation (n,)."""
    area = felt.indentation_mm * (felt.normal_n > 0)
    return np.asarray((felt.slipping * area).sum(axis=1) / np.maximum(area.sum(axis=1), 1e-12))


def _mixed(parts: list[tuple[FloatArray, TaxelForces]]) -> TaxelForces:
    """The skin is partly on one plate and partly on the next."""

    def blend(name: str) -> FloatArray:
        return np.asarray(
            sum(
                share.reshape(-1, *[1] * (vars(felt)[name].ndim - 1)) * vars(felt)[name]
                for share, felt in parts
            )
        )

    names = ("normal_n", "tangential_n", "side_n", "slipping", "indentation_mm")
    warnings = np.bitwise_or.reduce([felt.warnings for _, felt in parts])
    return TaxelForces(**{name: blend(name) for name in names}, warnings=warnings)

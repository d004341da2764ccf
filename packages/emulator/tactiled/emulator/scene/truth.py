"""Ground truth of a scene, against which detectors are scored."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tactiled.array import FloatArray, load_array
from tactiled.emulator.scene.contact import SceneContact, make_contact
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.phases import FlatPlate, GroovedPlate
from tactiled.emulator.scene.physical import ContactState, PhysicalContact


@dataclass(frozen=True)
class TruePhase:
    """A phase with its times, and the plate at its end."""

    kind: str
    start_s: float
    end_s: float
    surface: FlatPlate | GroovedPlate


@dataclass(frozen=True)
class TrueSlip:
    """Motion of the skin over the surface from `onset_s` to `end_s`."""

    onset_s: float  # beginning of the motion with contact model `signal`; `incipient_s` with a physical one
    end_s: float  # infinite while the slip continues
    direction_deg: float | None  # at the beginning; None where the skin turned on the spot
    surface: FlatPlate | GroovedPlate
    # shear_s, incipient_s, gross_s: the tangential load begins to grow; 10 % and 90 % of the contact area
    # slip. None for prescribed signals; `gross_s` also where slip did not become gross
    shear_s: float | None = None
    incipient_s: float | None = None
    gross_s: float | None = None


class Truth:
    """Truth of a scene, with instants on the caller's clock.

    `t0_s` is the instant at which the scene began: 0 for scene time, or the host's monotonic instant of the
    ``start`` command, which the emulator reports. `contact` is the one that played the scene, with any grip
    of a controller; without it the scene is played again.
    """

    def __init__(self, scene: Scene, t0_s: float = 0.0, contact: SceneContact | None = None) -> None:
        self.scene = scene
        self.t0_s = t0_s
        self.motion = SceneMotion(scene)
        self.phases = self._phases()
        self._given_contact = contact

    @cached_property
    def contact(self) -> SceneContact:
        """Contact model of the scene; if none was given, one that has played the scene to its end."""
        if self._given_contact is not None:
            return self._given_contact
        contact = make_contact(self.motion, load_array(self.scene.array))
        if isinstance(contact, PhysicalContact):
            contact.play_until(self.scene.duration_s)
        return contact

    @property
    def slips(self) -> list[TrueSlip]:
        """Gross slips; with a physical contact model as far as the scene has been played."""
        if isinstance(self.contact, PhysicalContact):
            return [slip for slip in self.episodes if slip.gross_s is not None]
        return self._prescribed_slips

    @property
    def episodes(self) -> list[TrueSlip]:
        """All times that a tenth or more of the contact slipped, as far as the scene has been played."""
        if not isinstance(self.contact, PhysicalContact):
            return self._prescribed_slips
        t0_s = self.t0_s
        return [
            TrueSlip(
                onset_s=t0_s + e.incipient_s,
                end_s=t0_s + (np.inf if e.end_s is None else e.end_s),
                direction_deg=e.direction_deg,
                surface=self._surface_at(e.incipient_s),
                shear_s=t0_s + e.shear_s,
                incipient_s=t0_s + e.incipient_s,
                gross_s=None if e.gross_s is None else t0_s + e.gross_s,
            )
            for e in self.contact.watch.episodes
        ]

    def state(self, time_s: FloatArray) -> ContactState:
        """Forces, slipping shares and motion at instants (n,)."""
        return self.contact.state(time_s - self.t0_s)

    def utilisation(self, time_s: FloatArray) -> FloatArray:
        """Return the tangential load (n,) over the limit of friction at rest; NaN without contact.

        The limit is that of the phase's plate; friction that a held object changes is not taken into account.
        """
        state = self.state(time_s)
        plates = [self._surface_at(t) for t in time_s - self.t0_s]
        limit_n = np.array([p.friction * p.static_ratio for p in plates]) * state.normal_n.sum(axis=1)
        shear_n = np.linalg.norm(state.tangential_n.sum(axis=1), axis=1)
        used = np.full(len(time_s), np.nan)
        np.divide(shear_n, limit_n, out=used, where=limit_n > 0)
        return used

    def speed_mm_s(self, time_s: FloatArray) -> FloatArray:
        """Speed (n,) of the skin over the surface."""
        if self.scene.held_object is None:
            return self.motion.at(time_s - self.t0_s).speed_mm_s
        return np.asarray(np.linalg.norm(self.state(time_s).velocity_mm_s, axis=-1))

    def to_map(self) -> dict[str, Any]:
        """Truth as plain data for JSON; slips as far as the scene has been played."""
        return {
            "scene": self.scene.name,
            "contact": self.scene.contact,
            "t0_s": self.t0_s,
            "duration_s": self.scene.duration_s,
            "phases": [vars(p) | {"surface": p.surface.model_dump()} for p in self.phases],
            "slips": [plain_slip(slip) for slip in self.slips],
        }

    def _surface_at(self, scene_s: float) -> FlatPlate | GroovedPlate:
        """Plate at an instant of scene time."""
        number = int(np.searchsorted(self.motion.phase_start_s, scene_s, side="right")) - 1
        return self.phases[min(max(number, 0), len(self.phases) - 1)].surface

    def _phases(self) -> list[TruePhase]:
        starts = self.motion.phase_start_s + self.t0_s
        phases, surface = [], self.scene.surface
        for phase, start, end in zip(self.scene.phases, starts[:-1], starts[1:], strict=True):
            surface = phase.surface or surface
            phases.append(TruePhase(phase.kind, float(start), float(end), surface))
        return phases

    @cached_property
    def _prescribed_slips(self) -> list[TrueSlip]:
        """Longest times of motion in one direction over one plate."""
        edges = self.motion.segment_start_s
        middles = (edges[:-1] + edges[1:]) / 2
        state = self.motion.at(middles)
        slips: list[TrueSlip] = []
        for k in np.flatnonzero(state.speed_mm_s > 0):
            surface = self.phases[state.phase[k]].surface
            onset, end = float(edges[k] + self.t0_s), float(edges[k + 1] + self.t0_s)
            direction = float(state.direction_deg[k])
            last = slips[-1] if slips else None
            if last and (last.end_s, last.direction_deg, last.surface) == (onset, direction, surface):
                slips[-1] = TrueSlip(last.onset_s, end, direction, surface)
            else:
                slips.append(TrueSlip(onset, end, direction, surface))
        return slips


def plain_slip(slip: TrueSlip) -> dict[str, Any]:
    """Slip as plain data for JSON, which has no infinity."""
    end_s = slip.end_s if np.isfinite(slip.end_s) else None
    return vars(slip) | {"surface": slip.surface.model_dump(), "end_s": end_s}

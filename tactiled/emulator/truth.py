"""Ground truth of a scene: what a detector is scored against."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.motion import Motion
from tactiled.emulator.scene import Flat, Grooves, Scene

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TruePhase:
    """A phase with its place in time and the plate that is there at its end."""

    kind: str
    start_s: float
    end_s: float
    surface: Flat | Grooves


@dataclass(frozen=True)
class TrueSlip:
    """The skin moves over the surface, from `onset_s` to `end_s`, in one direction."""

    onset_s: float
    end_s: float
    direction_deg: float
    surface: Flat | Grooves


class Truth:
    """Truth of a scene, with its instants on the clock of the caller.

    Parameters
    ----------
    scene : Scene
    t0_s : float
        Instant at which the scene began: 0 for scene time, or the host's monotonic instant of the
        ``start`` command, which the emulator reports.
    """

    def __init__(self, scene: Scene, t0_s: float = 0.0) -> None:
        self.scene = scene
        self.t0_s = t0_s
        self.motion = Motion(scene)
        self.phases = self._phases()
        self.slips = self._slips()

    def speed_mm_s(self, time_s: FloatArray) -> FloatArray:
        return self.motion.at(time_s - self.t0_s).speed_mm_s

    def travel_mm(self, time_s: FloatArray) -> FloatArray:
        """Way of the skin since the scene began: ``(..., 2)``, x and y."""
        state = self.motion.at(time_s - self.t0_s)
        return np.stack([state.travel_x_mm, state.travel_y_mm], axis=-1)

    def load_n(self, time_s: FloatArray) -> FloatArray:
        """Normal load in total."""
        return self.motion.at(time_s - self.t0_s).load_n

    def to_map(self) -> dict[str, Any]:
        """Truth as plain data for JSON, on the caller's clock."""
        return {
            "scene": self.scene.name,
            "t0_s": self.t0_s,
            "duration_s": self.scene.duration_s,
            "phases": [_plain(phase) for phase in self.phases],
            "slips": [_plain(slip) for slip in self.slips],
        }

    def _phases(self) -> list[TruePhase]:
        starts = self.motion.phase_start_s + self.t0_s
        phases, surface = [], self.scene.surface
        for phase, start, end in zip(self.scene.phases, starts[:-1], starts[1:], strict=True):
            surface = phase.surface or surface
            phases.append(TruePhase(phase.kind, float(start), float(end), surface))
        return phases

    def _slips(self) -> list[TrueSlip]:
        """Longest spans of motion in one direction over one plate."""
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


def _plain(item: TruePhase | TrueSlip) -> dict[str, Any]:
    return vars(item) | {"surface": item.surface.model_dump()}

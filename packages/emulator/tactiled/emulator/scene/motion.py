"""Kinematics and load of a scene in closed form.

A scene is divided into segments in which load and speed are linear in time and the direction is constant. All
other quantities follow exactly, without steps, so that nothing depends on chunking.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.phases import (
    Disturbance,
    FlatPlate,
    GroovedPlate,
    LiftPhase,
    LoadPhase,
    Phase,
    PressPhase,
    RestPhase,
    RotatePhase,
    SlidePhase,
)

ComplexArray = NDArray[np.complex128]

# Presliding distance of the skin: the paper's voltages settle within some 0.1 mm of travel.
PRESLIDING_MM = 0.1
# A viscoelastic skin loses part of its shear at constant displacement, so that the end of a slide and its
# resumption can be seen. The paper shows no stop; the numbers are plausible for PDMS, not measured.
_SHEAR_KEPT = 0.7
SHEAR_RELAXATION_S = 0.5
_ENTRY_MM = 1.0  # travel over which a sliding skin comes fully onto another plate
_SWELL = 0.1  # part of its time over which a sine grows, and fades, so that it begins and ends without a kink
_LEAST_FRICTION = 0.01  # part of the plate's: contact models need a limit above zero


@dataclass(frozen=True)
class Segment:
    """Values at the beginning of a segment, and their rates in it; vectors are x + iy."""

    surface: int
    surface_before: int
    phase: int = 0
    t0: float = 0.0
    load: float = 0.0
    load_rate: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    direction_deg: float = 0.0
    place: complex = 0j
    path: float = 0.0
    path_at_change: float = 0.0
    shear: complex = 0j
    turn: float = 0.0
    turn_rate: float = 0.0
    pull: complex = 0j
    pull_rate: complex = 0j

    @property
    def stands(self) -> bool:
        return self.speed == 0 and self.acceleration == 0

    @property
    def direction(self) -> complex:
        return unit_vector(self.direction_deg)

    @property
    def shear_goal(self) -> complex:
        """Limit of the tangential state."""
        if not self.stands:
            return self.direction
        return min(1.0, _SHEAR_KEPT / max(abs(self.shear), 1e-9)) * self.shear

    def after(self, dt: float) -> "Segment":
        """State after `dt`, at which the next segment begins."""
        way = self.speed * dt + self.acceleration * dt * dt / 2
        left = math.exp(-way / PRESLIDING_MM - self.stands * dt / SHEAR_RELAXATION_S)
        return replace(
            self,
            t0=self.t0 + dt,
            load=self.load + self.load_rate * dt,
            place=self.place + self.direction * way,
            path=self.path + way,
            shear=self.shear_goal + (self.shear - self.shear_goal) * left,
            turn=self.turn + self.turn_rate * dt,
            pull=self.pull + self.pull_rate * dt,
        )


@dataclass(frozen=True)
class MotionState:
    """State of the skin at given instants; all arrays have their shape, vectors are x + iy."""

    load_n: FloatArray  # total normal load
    travel_mm: ComplexArray  # of the skin over the surface since the scene began
    speed_mm_s: FloatArray  # speed along `direction_deg`
    direction_deg: FloatArray  # direction of the phase's motion; of the last motion where nothing moves
    shear: ComplexArray  # tangential state, a vector of length 0 (fresh contact) to 1 (gross slip)
    turn_deg: FloatArray  # angle by which the skin has turned about the middle of the array
    pull_n: ComplexArray  # tangential load of a held object, in the direction in which the skin would slip
    friction_part: FloatArray  # friction of a held object over that of its plate
    phase: NDArray[np.int64]  # number of the scene's phase


class SceneMotion:
    """Closed form of a scene's load, travel and tangential state.

    The tangential state follows Dahl's law ``ds/dL = (d - s) / L0`` along the travel L in direction d (Dahl
    1968 with exponent 1, in vector form), so that it saturates in `PRESLIDING_MM` and reverses with the
    direction: ``s(L) = d + (s0 - d) exp(-L / L0)``. At rest it relaxes towards `_SHEAR_KEPT` of
    full shear; loss of contact clears it.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        # Instant at which each phase begins; the last is the end of the scene.
        self.phase_start_s = np.array([0.0, *itertools.accumulate(p.duration_s for p in scene.phases)])
        # Distinct plates, in order of appearance.
        self.surfaces: list[FlatPlate | GroovedPlate] = []
        self._segments = self._build()
        names = (*vars(self._segments[0]), "stands", "direction", "shear_goal")
        self._table: dict[str, NDArray[Any]] = {
            name: np.array([getattr(s, name) for s in self._segments]) for name in names
        }

    @property
    def segment_start_s(self) -> FloatArray:
        return self._table["t0"]

    def at(self, time_s: FloatArray) -> MotionState:
        """State at instants of scene time, of any shape."""
        i, dt, way = self._locate(time_s)
        table = self._table
        goal = table["shear_goal"][i]
        direction: ComplexArray = table["direction"][i]
        left = np.exp(-way / PRESLIDING_MM - table["stands"][i] * dt / SHEAR_RELAXATION_S)
        extras = self.scene.disturbances
        return MotionState(
            load_n=np.maximum(
                table["load"][i] + table["load_rate"][i] * dt + _disturbed(extras, "load_n", time_s), 0.0
            ),
            travel_mm=table["place"][i] + direction * way,
            speed_mm_s=table["speed"][i] + table["acceleration"][i] * dt,
            direction_deg=table["direction_deg"][i],
            shear=goal + (table["shear"][i] - goal) * left,
            turn_deg=table["turn"][i] + table["turn_rate"][i] * dt,
            pull_n=table["pull"][i] + table["pull_rate"][i] * dt + _pull_n(extras, time_s),
            friction_part=np.maximum(1.0 + _disturbed(extras, "friction", time_s), _LEAST_FRICTION),
            phase=table["phase"][i],
        )

    def surface_share(self, number: int, time_s: FloatArray) -> FloatArray:
        """Share of the skin on plate `number`: between 0 and 1 while it slides from one plate to another.

        A change of plate without contact is immediate; in contact the skin comes onto the plate smoothly over
        `_ENTRY_MM` of travel.
        """
        i, _, way = self._locate(time_s)
        table = self._table
        since_mm = table["path"][i] + way - table["path_at_change"][i]
        part = np.clip(since_mm / _ENTRY_MM, 0.0, 1.0)
        entered = part * part * (3 - 2 * part)
        now = table["surface"][i] == number
        before = table["surface_before"][i] == number
        return np.where(now & before, 1.0, np.where(now, entered, np.where(before, 1.0 - entered, 0.0)))

    def temperature_k(self, time_s: FloatArray) -> FloatArray:
        """Warming (K) of the sensor since the scene began."""
        return _disturbed(self.scene.disturbances, "temperature_k", np.maximum(time_s, 0.0))

    def _locate(self, time_s: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Segment of each instant, time since its beginning, and travel in it."""
        table = self._table
        time_s = np.maximum(time_s, 0.0)
        i = np.searchsorted(table["t0"], time_s, side="right") - 1
        dt = time_s - table["t0"][i]
        return i, dt, table["speed"][i] * dt + table["acceleration"][i] * dt * dt / 2

    def _build(self) -> list[Segment]:
        surface = self._number(self.scene.surface)
        now = Segment(surface, surface)
        segments: list[Segment] = []
        for number, phase in enumerate(self.scene.phases):
            now = self._on_surface_of(phase, now)
            goal, knots = now.load, [(0.0, 0.0), (phase.duration_s, 0.0)]
            if isinstance(phase, PressPhase):
                goal = phase.force_n
            elif isinstance(phase, RestPhase | LiftPhase):
                goal = 0.0
            elif isinstance(phase, SlidePhase):
                knots = speed_knots(phase)
                now = replace(now, direction_deg=phase.direction_deg)
            pull, turn_rate = now.pull, 0.0
            if isinstance(phase, LoadPhase):
                goal = now.load if phase.force_n is None else phase.force_n
                pull = phase.tangential_n * unit_vector(phase.direction_deg)
            elif isinstance(phase, RotatePhase):
                turn_rate = phase.angle_deg / phase.duration_s
            now = replace(
                now,
                phase=number,
                load_rate=(goal - now.load) / phase.duration_s,
                pull_rate=(pull - now.pull) / phase.duration_s,
                turn_rate=turn_rate,
            )
            for (start, speed), (stop, speed_after) in itertools.pairwise(knots):
                acceleration = (speed_after - speed) / (stop - start)
                segments.append(replace(now, speed=speed, acceleration=acceleration))
                now = segments[-1].after(stop - start)
            # Set exactly, so that rounding does not accumulate.
            end_s = float(self.phase_start_s[number + 1])
            now = replace(now, t0=end_s, load=goal, pull=pull, shear=now.shear if goal else 0j)
        # After the scene the skin stays in its last state.
        now = replace(now, load_rate=0.0, speed=0.0, acceleration=0.0, turn_rate=0.0, pull_rate=0j)
        return [*segments, now]

    def _on_surface_of(self, phase: Phase, now: Segment) -> Segment:
        if phase.surface is None or (new := self._number(phase.surface)) == now.surface:
            return now
        # (A change within the entry of the plate before blends from that plate as if it were reached.)
        before = now.surface if now.load > 0 else new
        return replace(now, surface=new, surface_before=before, path_at_change=now.path)

    def _number(self, surface: FlatPlate | GroovedPlate) -> int:
        if surface not in self.surfaces:
            self.surfaces.append(surface)
        return self.surfaces.index(surface)


def unit_vector(direction_deg: float) -> complex:
    """Direction as x + iy, rounded to be exact along the axes: cos(90 deg) is else 6e-17."""
    angle = math.radians(direction_deg)
    return complex(round(math.cos(angle), 15), round(math.sin(angle), 15))


def speed_knots(slide: SlidePhase) -> list[tuple[float, float]]:
    """Speed of a slide as a polyline of (seconds into the phase, mm/s)."""
    end, speed = slide.duration_s, slide.speed_mm_s
    # Rounding must not leave a last piece of zero length.
    times = {t for t in (0.0, slide.ramp_s) if t < end - 1e-6} | {end}
    return [(t, speed * t / slide.ramp_s if t < slide.ramp_s else speed) for t in sorted(times)]


def _disturbed(disturbances: Sequence[Disturbance], on: str, time_s: FloatArray) -> FloatArray:
    """Sum of the disturbances of a quantity without direction, in the shape of `time_s`."""
    out = np.zeros(np.shape(time_s))
    for extra in disturbances:
        if extra.on == on:
            out += _value(extra, time_s)
    return out


def _pull_n(disturbances: Sequence[Disturbance], time_s: FloatArray) -> ComplexArray:
    """Extra pull on a held object."""
    out = np.zeros(np.shape(time_s), dtype=np.complex128)
    for extra in disturbances:
        if extra.on == "pull_n":
            angle = np.deg2rad(extra.direction_deg)  # numpy may round the last bit unlike `unit_vector`
            out += _value(extra, time_s) * complex(round(np.cos(angle), 15), round(np.sin(angle), 15))
    return out


def _value(extra: Disturbance, time_s: FloatArray) -> FloatArray:
    since_s = np.asarray(time_s) - extra.start_s
    part = np.clip(since_s / extra.duration_s, 0.0, 1.0)
    if extra.shape == "ramp":
        return np.asarray(extra.amplitude * part)
    if extra.shape == "pulse":  # sin(pi) is not exactly 0
        return np.asarray(extra.amplitude * np.sin(np.pi * part) ** 2 * (part < 1))
    swell = np.clip(np.minimum(part, 1 - part) / _SWELL, 0.0, 1.0)
    wave = np.sin(2 * np.pi * extra.frequency_hz * since_s)
    return np.asarray(extra.amplitude * swell * swell * (3 - 2 * swell) * wave)

"""Pieces of a scene in which load and speed are linear in time and the direction is constant."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tactiled.emulator.scene.phases import Slide

# Presliding distance of the skin on the plate: the paper's voltages settle within some 0.1 mm of travel.
PRESLIDING_MM = 0.1
# A viscoelastic skin that stops loses part of its shear at constant displacement, so a slide's end and its
# resumption can be seen. The paper does not show a stop; the numbers are plausible for PDMS, no more.
_SHEAR_KEPT = 0.7
SHEAR_RELAXATION_S = 0.5
_KNOT_S = 0.005  # step at which a sine on the speed is cut into straight pieces: exact to 1e-4 at 5 Hz


@dataclass(frozen=True)
class Segment:
    """Values at the beginning of a segment, and how they change in it."""

    t0: float
    load: float
    load_rate: float
    speed: float
    acceleration: float
    direction_deg: float
    x: float
    y: float
    path: float
    shear_x: float
    shear_y: float
    phase: int
    surface: int
    surface_before: int
    path_at_change: float
    turn: float
    turn_rate: float
    pull_x: float
    pull_y: float
    pull_x_rate: float
    pull_y_rate: float

    @property
    def stands(self) -> bool:
        return self.speed == 0 and self.acceleration == 0

    @property
    def direction(self) -> tuple[float, float]:
        # cos(90 deg) is 6e-17 in floating point; motion along y has no x at all.
        angle = math.radians(self.direction_deg)
        return round(math.cos(angle), 15), round(math.sin(angle), 15)

    @property
    def shear_goal(self) -> tuple[float, float]:
        """What the tangential state tends to."""
        if not self.stands:
            return self.direction
        kept = min(1.0, _SHEAR_KEPT / max(math.hypot(self.shear_x, self.shear_y), 1e-9))
        return kept * self.shear_x, kept * self.shear_y

    def after(self, dt: float) -> "Segment":
        """Beginning of a segment that follows after `dt`."""
        way = self.speed * dt + self.acceleration * dt * dt / 2
        (dx, dy), (goal_x, goal_y) = self.direction, self.shear_goal
        left = math.exp(-way / PRESLIDING_MM - self.stands * dt / SHEAR_RELAXATION_S)
        return replace(
            self,
            t0=self.t0 + dt,
            load=self.load + self.load_rate * dt,
            x=self.x + dx * way,
            y=self.y + dy * way,
            path=self.path + way,
            shear_x=goal_x + (self.shear_x - goal_x) * left,
            shear_y=goal_y + (self.shear_y - goal_y) * left,
            turn=self.turn + self.turn_rate * dt,
            pull_x=self.pull_x + self.pull_x_rate * dt,
            pull_y=self.pull_y + self.pull_y_rate * dt,
        )


def speed_knots(slide: Slide) -> list[tuple[float, float]]:
    """Speed of a slide as a polyline of (seconds into the phase, mm/s)."""
    end = slide.duration_s
    if slide.profile:
        knots = list(slide.profile)
        return knots if knots[-1][0] == end else [*knots, (end, knots[-1][1])]
    speed = slide.speed_mm_s or 0.0
    times = {0.0, slide.ramp_s}
    if slide.ripple_mm_s:
        times |= set(np.arange(slide.ramp_s, end, _KNOT_S).tolist())
    # Rounding must not leave a last piece without a length to divide by.
    times = {t for t in times if t < end - 1e-6} | {end}

    def at(t: float) -> float:
        if t < slide.ramp_s:
            return speed * t / slide.ramp_s
        return speed + slide.ripple_mm_s * float(np.sin(2 * np.pi * slide.ripple_hz * (t - slide.ramp_s)))

    return [(t, at(t)) for t in sorted(times)]

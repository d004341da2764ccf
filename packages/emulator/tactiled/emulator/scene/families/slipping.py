"""Scenes with gross slip, which a detector must report."""

import numpy as np

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    begin,
    disturb,
    friction_n,
    hold_phase,
    load_phase,
    log_uniform,
    made,
    slide_phase,
    turned,
)

_TAXELS = 9  # of the shipped array


def steady_slide(seed: int) -> Scene:
    """Press, hold, slide in any direction at a steady speed."""
    rng, scene = begin("steady-slide", seed)
    scene["phases"] += [slide_phase(rng, duration_s=3.0, speed_mm_s=log_uniform(rng, 0.25, 10.0))]
    return made(scene)


def accelerating_slide(seed: int) -> Scene:
    """The speed grows evenly from rest."""
    rng, scene = begin("accelerating-slide", seed)
    top = log_uniform(rng, 2.0, 20.0)
    scene["phases"] += [slide_phase(rng, duration_s=4.0, profile=[[0.0, 0.0], [4.0, top]])]
    return made(scene)


def reversing_slide(seed: int) -> Scene:
    """Slides to and fro along one line."""
    rng, scene = begin("reversing-slide", seed)
    way = slide_phase(rng, duration_s=1.5, speed_mm_s=log_uniform(rng, 1.0, 8.0), ramp_s=0.1)
    back = way | {"direction_deg": turned(way["direction_deg"], 180.0)}
    scene["phases"] += [way, back, way, hold_phase(1.0)]
    return made(scene)


def stick_slip(seed: int) -> Scene:
    """An object is dragged by a spring, with more friction at rest than in motion."""
    rng, scene = begin("stick-slip", seed)
    scene["surface"] |= {"static_ratio": rng.uniform(1.3, 1.8), "stribeck_mm_s": rng.uniform(1.0, 4.0)}
    spring_n_mm = log_uniform(rng, 1.0, 5.0)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.2, 1.0), "spring_n_mm": spring_n_mm}
    # The spring reaches the friction limit at rest in 2 to 4 s.
    speed_mm_s = scene["surface"]["static_ratio"] * friction_n(scene) / spring_n_mm / rng.uniform(2.0, 4.0)
    scene["phases"] += [slide_phase(rng, duration_s=12.0, speed_mm_s=speed_mm_s)]
    return made(scene)


def creep_into_slip(seed: int) -> Scene:
    """The load on a held object grows slowly beyond the friction limit."""
    rng, scene = begin("creep-into-slip", seed)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 1.0)}
    scene["phases"] += [load_phase(rng, scene, duration_s=rng.uniform(4.0, 12.0), of_friction=1.3)]
    return made(scene)


def jerk_into_slip(seed: int) -> Scene:
    """A held object is jerked beyond the friction limit."""
    rng, scene = begin("jerk-into-slip", seed)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 0.5)}
    weight = load_phase(rng, scene, duration_s=1.0, of_friction=rng.uniform(0.2, 0.5))
    scene["phases"] += [weight, hold_phase(4.0)]
    strength, start_s = friction_n(scene) * rng.uniform(1.5, 2.5), rng.uniform(4.0, 5.0)
    along = {"direction_deg": weight["direction_deg"]}
    disturb(scene, "pull_n", "pulse", strength, start_s, rng.uniform(0.2, 0.4), **along)
    return made(scene)


def turning(seed: int) -> Scene:
    """The skin turns about the normal, to and fro; the middle taxel may stick while all others slip."""
    rng, scene = begin("turning", seed)
    angle = float(rng.choice([-1, 1]) * rng.uniform(15.0, 60.0))
    for part in (1.0, -1.0):
        scene["phases"] += [{"kind": "rotate", "duration_s": 3.0, "angle_deg": part * angle}]
    return made(scene)


def partial_contact(seed: int) -> Scene:
    """A slide with some of the taxels in contact, under a tilted surface."""
    rng, scene = begin("partial-contact", seed)
    touching = np.sort(rng.choice(_TAXELS, size=int(rng.integers(2, _TAXELS)), replace=False))
    scene["touching"] = touching.tolist()
    scene["load_gradient_per_mm"] = rng.uniform(-0.1, 0.1, 2).tolist()
    scene["phases"] += [slide_phase(rng, duration_s=3.0, speed_mm_s=log_uniform(rng, 0.5, 5.0))]
    return made(scene)


def grooves(seed: int) -> Scene:
    """A slide over grooves of random period, angle and offset."""
    rng, scene = begin("grooves", seed)
    period_mm = rng.uniform(0.8, 2.0)
    scene["surface"] |= {
        "kind": "grooves",
        "period_mm": period_mm,
        "angle_deg": rng.uniform(-60.0, 60.0),
        "offset_mm": rng.uniform(0.0, period_mm),
    }
    scene["phases"] += [slide_phase(rng, duration_s=12.0, speed_mm_s=log_uniform(rng, 0.5, 3.0))]
    return made(scene)

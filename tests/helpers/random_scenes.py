"""Random scenes of the emulator; only `steady_slide` and `creep_into_slip` slip."""

import numpy as np

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    Document,
    any_direction_deg,
    begin,
    disturb,
    friction_n,
    hold_phase,
    load_phase,
    log_uniform,
    made,
    slide_phase,
)


def begin_quiet(name: str, seed: int, hold_s: float = 0.0) -> tuple[np.random.Generator, Document]:
    """Begin a scene with a held object whose weight is a small part of the friction limit."""
    rng, scene = begin(name, seed)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 0.5)}
    scene["phases"] += [load_phase(rng, scene, 0.5, rng.uniform(0.05, 0.2))]
    scene["phases"] += [hold_phase(hold_s)] if hold_s else []
    return rng, scene


def steady_slide(seed: int) -> Scene:
    """Press, hold, slide in any direction at a steady speed."""
    rng, scene = begin("steady-slide", seed)
    scene["phases"] += [slide_phase(rng, duration_s=3.0, speed_mm_s=log_uniform(rng, 0.25, 10.0))]
    return made(scene)


def creep_into_slip(seed: int) -> Scene:
    """The load on a held object grows slowly beyond the friction limit."""
    rng, scene = begin("creep-into-slip", seed)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 1.0)}
    scene["phases"] += [load_phase(rng, scene, duration_s=rng.uniform(4.0, 12.0), of_friction=1.3)]
    return made(scene)


def taps(seed: int) -> Scene:
    """The skin is tapped during a hold."""
    rng, scene = begin("taps", seed)
    scene["phases"] += [hold_phase(8.0)]
    for start_s in np.sort(rng.uniform(3.5, 10.0, 8)):
        disturb(scene, "load_n", "pulse", log_uniform(rng, 0.5, 8.0), start_s, rng.uniform(0.01, 0.08))
    return made(scene)


def grip_changes(seed: int) -> Scene:
    """The grip on a weight changes, well above the force that friction needs."""
    rng, scene = begin_quiet("grip-changes", seed)
    least_n = scene["phases"][0]["force_n"]
    for _ in range(5):
        force_n = least_n * rng.uniform(1.0, 2.0)
        scene["phases"] += [
            {"kind": "press", "duration_s": rng.uniform(0.05, 1.0), "force_n": force_n},
            hold_phase(rng.uniform(0.3, 2.0)),
        ]
    return made(scene)


def arm_acceleration(seed: int) -> Scene:
    """The arm starts and stops: the inertia of the object pulls in opposite directions."""
    rng, scene = begin_quiet("arm-acceleration", seed, hold_s=8.0)
    strength = 0.3 * friction_n(scene) * rng.uniform(0.3, 1.0)
    direction_deg, start_s, length_s = any_direction_deg(rng), rng.uniform(3.5, 6.0), rng.uniform(0.1, 0.8)
    for sign, later_s in ((1, 0.0), (-1, length_s + rng.uniform(0.1, 2.0))):
        when_s = start_s + later_s
        disturb(scene, "pull_n", "pulse", sign * strength, when_s, length_s, direction_deg=direction_deg)
    return made(scene)


def load_and_back(seed: int) -> Scene:
    """The load on a held object grows to less than the friction limit, and falls again."""
    rng, scene = begin_quiet("load-and-back", seed)
    for part in rng.uniform(0.3, 0.7, 3):
        length_s = rng.uniform(0.3, 2.0)
        scene["phases"] += [load_phase(rng, scene, length_s, part), load_phase(rng, scene, length_s, 0.1)]
    return made(scene)


def inclined_load(seed: int) -> Scene:
    """Normal and tangential load grow, stay and fall together, within the friction cone."""
    rng, scene = begin("inclined-load", seed)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 0.5)}
    press = scene["phases"][0]
    slanted = load_phase(rng, scene, rng.uniform(0.5, 2.0), rng.uniform(0.3, 0.7)) | {
        "force_n": press["force_n"]
    }
    less = slanted | {"force_n": 0.7 * press["force_n"], "tangential_n": 0.5 * slanted["tangential_n"]}
    scene["phases"] = [slanted, scene["phases"][1], less, hold_phase(1.0)]
    return made(scene)

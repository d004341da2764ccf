"""Random grasps: an object of unknown weight and friction is lifted in a gripper, and then disturbed.

The press is the same for all objects, because a controller does not know them either. Weight and friction are
those that one sensorised finger bears; the other finger bears as much.
"""

import numpy as np

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    Document,
    any_direction_deg,
    disturb,
    hold_phase,
    log_uniform,
    made,
    turned,
)

_SHORTEST_S = 0.001  # of a phase, as `description` has it
HOLD_S = 7.0
"""Duration of a grasp."""
LIFTED_S = 2.4
"""Scene time from which the object hangs freely."""
START_N = 6.0
"""Grip of the press."""
# Least grip of the objects in newtons: below, the skin would carry less than 80 g; six times the largest is
# more than the array was published with.
_LEAST_N = (2.5, 6.0)
_GRAVITY_M_S2 = 9.81
EVENTS = ("none", "jerks", "filling", "easing", "collision")


def hold(seed: int) -> Scene:
    """Lift, and one kind of event after it: jerks, filling, easing friction, a collision, or none."""
    rng = np.random.default_rng([seed, *b"hold"])
    friction = log_uniform(rng, 0.3, 1.0)
    static_ratio = float(rng.uniform(1.0, 1.25))
    weight_n = friction * static_ratio * log_uniform(rng, *_LEAST_N)
    down_deg = any_direction_deg(rng)
    lift_s = float(rng.uniform(0.3, LIFTED_S - 1.4))
    settle_s = LIFTED_S - 0.4 - lift_s
    pull = {"kind": "load", "tangential_n": weight_n, "direction_deg": down_deg}
    scene: Document = {
        "name": f"hold-{seed}",
        "contact": "mechanics",
        "seed": seed,
        "surface": {
            "kind": "flat",
            "friction": friction,
            "static_ratio": static_ratio,
            "stribeck_mm_s": float(rng.uniform(1.0, 5.0)),
        },
        "load_gradient_per_mm": rng.uniform(-0.1, 0.1, 2).tolist(),
        "held_object": {
            "mass_kg": weight_n / _GRAVITY_M_S2,
            "fall_mm": 20.0,  # about the length of a fingertip: then the object has left it
            "grip_rate_n_s": float(rng.uniform(40.0, 120.0)),
            "grip_delay_s": float(rng.uniform(0.01, 0.04)),
            "grip_step_n": float(rng.uniform(0.02, 0.1)),
        },
        "electronics": {"noise_v": log_uniform(rng, 0.2e-3, 2e-3)},
        "phases": [
            {"kind": "press", "duration_s": 0.4, "force_n": START_N},
            hold_phase(settle_s),
            pull | {"duration_s": lift_s},
        ],
        "disturbances": [],
    }
    # The inertia of an object that leaves the table.
    _pull(scene, float(rng.uniform(0.0, 0.1)) * weight_n, settle_s + 0.4 + lift_s, 0.3)
    event = EVENTS[int(rng.integers(len(EVENTS)))]
    _add_event(rng, scene, event, weight_n)
    left_s = HOLD_S - sum(phase["duration_s"] for phase in scene["phases"])
    if left_s >= _SHORTEST_S:
        scene["phases"] += [hold_phase(left_s)]
    elif left_s > 0:  # the phase before ends a moment later
        scene["phases"][-1]["duration_s"] += left_s
    scene["description"] = event
    return made(scene)


def _add_event(rng: np.random.Generator, scene: Document, event: str, weight_n: float) -> None:
    start_s = float(rng.uniform(LIFTED_S + 0.6, LIFTED_S + 2.0))
    if event == "jerks":
        for _ in range(int(rng.integers(1, 4))):
            part = float(rng.uniform(0.2, 0.8))
            _pull(scene, part * weight_n, start_s, log_uniform(rng, 0.1, 0.5))
            start_s += float(rng.uniform(0.6, 1.0))
    elif event == "collision":  # short and strong, in any direction
        part = float(rng.uniform(0.5, 2.0))
        _pull(scene, part * weight_n, start_s, log_uniform(rng, 0.015, 0.06), any_direction_deg(rng))
    elif event == "filling":
        filled_s = {"duration_s": float(rng.uniform(1.0, 2.5))}
        filled_n = {"tangential_n": weight_n * float(rng.uniform(1.2, 2.0))}
        lift = scene["phases"][-1]
        scene["phases"] += [hold_phase(start_s - LIFTED_S + 0.4), lift | filled_s | filled_n]
    elif event == "easing":
        part = -float(rng.uniform(0.1, 0.5))
        disturb(scene, "friction", "ramp", part, start_s, float(rng.uniform(0.5, 2.5)))


def _pull(
    scene: Document, amplitude_n: float, start_s: float, duration_s: float, aside_deg: float = 0.0
) -> None:
    """Pull at the object, at an angle to its weight."""
    towards_deg = turned(scene["phases"][-1].get("direction_deg", 0.0), aside_deg)
    disturb(scene, "pull_n", "pulse", amplitude_n, start_s, duration_s, direction_deg=towards_deg)

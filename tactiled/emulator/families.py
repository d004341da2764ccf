"""Randomised scenes: each family is a function of a seed, the same seed the same scene on any machine.

Families with slip are what a detector must find, those without are what it must not mistake for it. Names say
which: ``SLIPPING`` and ``QUIET``; `FAMILIES` has both.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from tactiled.emulator.scene import Scene

Family = Callable[[int], Scene]
Document = dict[str, Any]

_TAXELS = 9  # of the shipped array


def steady_slide(seed: int) -> Scene:
    """Press, hold, slide in any direction at a steady speed."""
    rng, scene = _begin("steady-slide", seed)
    scene["phases"] += [_slide(rng, duration_s=3.0, speed_mm_s=_log(rng, 0.25, 10.0))]
    return _made(scene)


def accelerating_slide(seed: int) -> Scene:
    """The speed grows from rest, evenly."""
    rng, scene = _begin("accelerating-slide", seed)
    top = _log(rng, 2.0, 20.0)
    scene["phases"] += [_slide(rng, duration_s=4.0, profile=[[0.0, 0.0], [4.0, top]])]
    return _made(scene)


def reversing_slide(seed: int) -> Scene:
    """To and fro along one line."""
    rng, scene = _begin("reversing-slide", seed)
    way = _slide(rng, duration_s=1.5, speed_mm_s=_log(rng, 1.0, 8.0), ramp_s=0.1)
    back = way | {"direction_deg": _turned(way["direction_deg"], 180.0)}
    scene["phases"] += [way, back, way, {"kind": "hold", "duration_s": 1.0}]
    return _made(scene)


def stick_slip(seed: int) -> Scene:
    """An object dragged through a spring on a plate with more friction at rest than in motion."""
    rng, scene = _begin("stick-slip", seed)
    scene["surface"] |= {"static_ratio": rng.uniform(1.3, 1.8), "stribeck_mm_s": rng.uniform(1.0, 4.0)}
    spring_n_mm = _log(rng, 1.0, 5.0)
    scene["held_object"] = {"mass_kg": _log(rng, 0.2, 1.0), "spring_n_mm": spring_n_mm}
    # The spring is stretched to what friction bears at rest in 2 to 4 s.
    speed_mm_s = scene["surface"]["static_ratio"] * _friction_n(scene) / spring_n_mm / rng.uniform(2.0, 4.0)
    scene["phases"] += [_slide(rng, duration_s=12.0, speed_mm_s=speed_mm_s)]
    return _made(scene)


def creep_into_slip(seed: int) -> Scene:
    """The load on a held object grows slowly beyond what friction bears."""
    rng, scene = _begin("creep-into-slip", seed)
    scene["held_object"] = {"mass_kg": _log(rng, 0.1, 1.0)}
    scene["phases"] += [_load(rng, scene, duration_s=rng.uniform(4.0, 12.0), of_friction=1.3)]
    return _made(scene)


def jerk_into_slip(seed: int) -> Scene:
    """A held object is jerked harder than friction bears."""
    rng, scene = _begin("jerk-into-slip", seed)
    scene["held_object"] = {"mass_kg": _log(rng, 0.1, 0.5)}
    weight = _load(rng, scene, duration_s=1.0, of_friction=rng.uniform(0.2, 0.5))
    scene["phases"] += [weight, {"kind": "hold", "duration_s": 4.0}]
    jerk = {"on": "pull_n", "shape": "pulse", "direction_deg": weight["direction_deg"]}
    strength = _friction_n(scene) * rng.uniform(1.5, 2.5)
    scene["disturbances"] += [
        jerk | {"amplitude": strength, "start_s": rng.uniform(4.0, 5.0), "duration_s": rng.uniform(0.2, 0.4)}
    ]
    return _made(scene)


def turning(seed: int) -> Scene:
    """The skin turns about the normal, to and fro; the middle taxel may hold on while all others slip."""
    rng, scene = _begin("turning", seed)
    angle = float(rng.choice([-1, 1]) * rng.uniform(15.0, 60.0))
    for part in (1.0, -1.0):
        scene["phases"] += [{"kind": "rotate", "duration_s": 3.0, "angle_deg": part * angle}]
    return _made(scene)


def partial_contact(seed: int) -> Scene:
    """Some taxels only, under a tilted surface, slide."""
    rng, scene = _begin("partial-contact", seed)
    touching = np.sort(rng.choice(_TAXELS, size=int(rng.integers(2, _TAXELS)), replace=False))
    scene["touching"] = touching.tolist()
    scene["load_gradient_per_mm"] = rng.uniform(-0.1, 0.1, 2).tolist()
    scene["phases"] += [_slide(rng, duration_s=3.0, speed_mm_s=_log(rng, 0.5, 5.0))]
    return _made(scene)


def grooves(seed: int) -> Scene:
    """A slide over grooves of any period and angle, the plate put down anywhere."""
    rng, scene = _begin("grooves", seed)
    scene["needs"] = ["direction", "groove-phase"]  # no rung has the ripple's amplitude to better than 60 %
    period_mm = rng.uniform(0.8, 2.0)
    scene["surface"] |= {
        "kind": "grooves",
        "period_mm": period_mm,
        "angle_deg": rng.uniform(-60.0, 60.0),
        "offset_mm": rng.uniform(0.0, period_mm),
    }
    scene["phases"] += [_slide(rng, duration_s=12.0, speed_mm_s=_log(rng, 0.5, 3.0))]
    return _made(scene)


def taps(seed: int) -> Scene:
    """An untouched skin, then a held one, is tapped."""
    rng, scene = _begin("taps", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 8.0}]
    for start_s in np.sort(rng.uniform(3.5, 10.0, 8)):
        _disturb(scene, "load_n", "pulse", _log(rng, 0.5, 8.0), start_s, rng.uniform(0.01, 0.08))
    return _made(scene)


def grip_changes(seed: int) -> Scene:
    """A gripper that holds a weight tightens and eases, well above what friction needs."""
    rng, scene = _quiet("grip-changes", seed)
    least_n = scene["phases"][0]["force_n"]
    for _ in range(5):
        force_n = least_n * rng.uniform(1.0, 2.0)
        scene["phases"] += [
            {"kind": "press", "duration_s": rng.uniform(0.05, 1.0), "force_n": force_n},
            {"kind": "hold", "duration_s": rng.uniform(0.3, 2.0)},
        ]
    return _made(scene)


def motor_hum(seed: int) -> Scene:
    """The gripper's motor shakes grip and object, with its harmonic."""
    rng, scene = _quiet("motor-hum", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 8.0}]
    hum_hz, start_s = rng.uniform(8.0, 90.0), rng.uniform(3.5, 5.0)
    for on, part in (("load_n", 0.02), ("pull_n", 0.05)):
        for times in (1, 2):
            amplitude = part / times * rng.uniform(0.3, 1.0) * scene["phases"][0]["force_n"]
            _disturb(scene, on, "sine", amplitude, start_s, 5.0, frequency_hz=times * hum_hz)
    return _made(scene)


def arm_acceleration(seed: int) -> Scene:
    """The arm starts and stops: the object's inertia pulls one way, then the other."""
    rng, scene = _quiet("arm-acceleration", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 8.0}]
    strength = 0.3 * _friction_n(scene) * rng.uniform(0.3, 1.0)
    direction_deg, start_s, length_s = _direction(rng), rng.uniform(3.5, 6.0), rng.uniform(0.1, 0.8)
    for sign, later_s in ((1, 0.0), (-1, length_s + rng.uniform(0.1, 2.0))):
        when_s = start_s + later_s
        _disturb(scene, "pull_n", "pulse", sign * strength, when_s, length_s, direction_deg=direction_deg)
    return _made(scene)


def cable_tug(seed: int) -> Scene:
    """Somebody tugs at what is held, within what friction bears."""
    rng, scene = _quiet("cable-tug", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 8.0}]
    for start_s in rng.uniform(3.5, 9.0, 3):
        strength = 0.3 * _friction_n(scene) * rng.uniform(0.3, 1.0)
        length_s = rng.uniform(0.05, 0.4)
        _disturb(scene, "pull_n", "pulse", strength, start_s, length_s, direction_deg=_direction(rng))
    return _made(scene)


def load_and_back(seed: int) -> Scene:
    """The load on a held object grows below what friction bears, and goes again."""
    rng, scene = _quiet("load-and-back", seed)
    for part in rng.uniform(0.3, 0.7, 3):
        length_s = rng.uniform(0.3, 2.0)
        scene["phases"] += [_load(rng, scene, length_s, part), _load(rng, scene, length_s, 0.1)]
    return _made(scene)


def thermal_drift(seed: int) -> Scene:
    """Persistent contact on a sensor that warms or cools."""
    rng, scene = _begin("thermal-drift", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 60.0}]
    warming_k = float(rng.choice([-1, 1]) * rng.uniform(2.0, 15.0))
    _disturb(scene, "temperature_k", "ramp", warming_k, 3.0, rng.uniform(10.0, 55.0))
    return _made(scene)


def persistent_contact(seed: int) -> Scene:
    """A grip that stays, and creeps into the rubber."""
    _, scene = _begin("persistent-contact", seed)
    scene["phases"] += [{"kind": "hold", "duration_s": 120.0}]
    return _made(scene)


SLIPPING: dict[str, Family] = {
    "steady-slide": steady_slide,
    "accelerating-slide": accelerating_slide,
    "reversing-slide": reversing_slide,
    "stick-slip": stick_slip,
    "creep-into-slip": creep_into_slip,
    "jerk-into-slip": jerk_into_slip,
    "turning": turning,
    "partial-contact": partial_contact,
    "grooves": grooves,
}
QUIET: dict[str, Family] = {
    "taps": taps,
    "grip-changes": grip_changes,
    "motor-hum": motor_hum,
    "arm-acceleration": arm_acceleration,
    "cable-tug": cable_tug,
    "load-and-back": load_and_back,
    "thermal-drift": thermal_drift,
    "persistent-contact": persistent_contact,
}
FAMILIES: dict[str, Family] = SLIPPING | QUIET


def _begin(name: str, seed: int) -> tuple[np.random.Generator, Document]:
    """A press of 6 to 20 N on a plate of friction 0.3 to 0.9, and a hold."""
    # The name is in the seed, so that families do not share their luck.
    rng = np.random.default_rng([seed, *name.encode()])
    scene: Document = {
        "name": f"{name}-{seed}",
        "contact": "auto",
        "needs": ["gross-slip", "transients"],
        "tolerance": 0.15,
        "seed": seed,
        "surface": {"kind": "flat", "friction": rng.uniform(0.3, 0.9)},
        "phases": [
            {"kind": "press", "duration_s": rng.uniform(0.2, 1.5), "force_n": rng.uniform(6.0, 20.0)},
            {"kind": "hold", "duration_s": rng.uniform(0.5, 1.5)},
        ],
        "disturbances": [],
    }
    return rng, scene


def _quiet(name: str, seed: int) -> tuple[np.random.Generator, Document]:
    """The same, with a held object whose weight is a small part of what friction bears."""
    rng, scene = _begin(name, seed)
    scene["held_object"] = {"mass_kg": _log(rng, 0.1, 0.5)}
    scene["phases"] += [_load(rng, scene, 0.5, rng.uniform(0.05, 0.2))]
    return rng, scene


def _made(scene: Document) -> Scene:
    return Scene.model_validate(scene)


def _friction_n(scene: Document) -> float:
    return float(scene["surface"]["friction"] * scene["phases"][0]["force_n"])


def _direction(rng: np.random.Generator) -> float:
    return float(rng.uniform(-180.0, 180.0))


def _turned(direction_deg: float, by_deg: float) -> float:
    return (direction_deg + by_deg + 180.0) % 360.0 - 180.0


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _slide(rng: np.random.Generator, **rest: Any) -> Document:
    return {"kind": "slide", "direction_deg": _direction(rng), **rest}


def _load(rng: np.random.Generator, scene: Document, duration_s: float, of_friction: float) -> Document:
    """A load that goes to a part of what friction bears."""
    return {
        "kind": "load",
        "duration_s": duration_s,
        "tangential_n": of_friction * _friction_n(scene),
        "direction_deg": _direction(rng),
    }


def _disturb(
    scene: Document, on: str, shape: str, amplitude: float, start_s: float, duration_s: float, **rest: float
) -> None:
    scene["disturbances"] += [
        {
            "on": on,
            "shape": shape,
            "amplitude": amplitude,
            "start_s": float(start_s),
            "duration_s": duration_s,
            **rest,
        }
    ]

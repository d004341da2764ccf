"""Loads below the friction limit that come to rest, or swing: scenes that must not be called gross slip.

The total shear of a load that comes to rest and of one that makes the contact slip is the same: it grows and
stops. On a surface of unknown friction only the taxels' shares differ.
"""

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    any_direction_deg,
    begin,
    disturb,
    friction_n,
    load_phase,
    made,
)

_REST_S, _SWING_S, _STEPS = 1.0, 3.0, 4


def loaded(load: str, seed: int) -> Scene:
    """Scene of one of `LOADS`."""
    rng, scene = begin(load, seed)
    scene["held_object"] = {"mass_kg": 0.3}
    part = rng.uniform(*LOADS[load])
    if load == _SWING:
        scene["phases"] += [
            load_phase(rng, scene, 0.5, 0.05),
            {"kind": "hold", "duration_s": _SWING_S + _REST_S},
        ]
        start_s = sum(phase["duration_s"] for phase in scene["phases"][:-1])
        pull_n, rate_hz = part * friction_n(scene), rng.uniform(0.5, 2.5)
        direction_deg = any_direction_deg(rng)
        swing = {"frequency_hz": rate_hz, "direction_deg": direction_deg}
        disturb(scene, "pull_n", "sine", pull_n, start_s, _SWING_S, **swing)
    elif load == _IN_STEPS:
        whole = load_phase(rng, scene, 0.0, part)
        for step in range(1, _STEPS + 1):
            tangential_n = whole["tangential_n"] * step / _STEPS
            grown = {"duration_s": rng.uniform(0.1, 0.5), "tangential_n": tangential_n}
            scene["phases"] += [whole | grown, {"kind": "hold", "duration_s": rng.uniform(0.2, 1.0)}]
    else:
        grown = load_phase(rng, scene, rng.uniform(0.1, 1.0), part)
        scene["phases"] += [grown, {"kind": "hold", "duration_s": _REST_S}]
    return made(scene)


_SWING, _IN_STEPS = "swings by 30 to 75 %", "comes in steps, to 30 to 75 %"
# Loads as parts of the friction limit.
LOADS = {
    "rests at 20 to 40 %": (0.2, 0.4),
    "rests at 40 to 60 %": (0.4, 0.6),
    "rests at 60 to 80 %": (0.6, 0.8),
    "rests at 80 to 90 %": (0.8, 0.9),
    _SWING: (0.3, 0.75),
    _IN_STEPS: (0.3, 0.75),
}

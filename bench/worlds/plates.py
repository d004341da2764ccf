"""Worlds of plates: the emulator's skin under motion that is given, and objects under loads that are drawn.

Loads of the taxels are equal or grow along the array; friction is even, or differs from place to place.
Slides over a plate, pulls that end before the contact slips, and loads on a held object at which it rests or
swings: the emulator's mechanics, with motion instead of a gripper as in `grasps`.
"""

from collections.abc import Callable, Mapping

import numpy as np

from bench.worlds.emulated import play, world_of
from bench.worlds.world import World
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    Document,
    any_direction_deg,
    begin,
    disturb,
    friction_n,
    load_phase,
    log_uniform,
    made,
    slide_phase,
    turned,
)

_NOISE_V = (0.1e-3, 10e-3)
_FORCE_N = (2.0, 25.0)
_SPEED_MM_S = (0.25, 20.0)
_REACH_MM = 0.4  # travel from rest to gross slip over friction, under usual loads (`mechanics.lumped`)
_TILTED, _PARTIAL = 0.5, 0.15  # share of plates that are tilted, or that reach some taxels only
_UNEVEN, _UNEVENNESS = 0.75, (0.01, 0.15)  # share of plates with friction that differs from place to place
_STATIC = 0.3  # share of plates with more friction at rest


def draw_worlds(seeds: range, minutes: float, hands: tuple[str, ...] = ()) -> list[World]:
    """Play scenes of so many minutes."""
    worlds = []
    for seed in seeds:
        rng = np.random.default_rng([59, seed])
        hand = str(rng.choice(hands or HANDS))
        scene = _scene(rng, hand, seed, 60 * minutes)
        worlds.append(world_of("plates", hand, scene, play(scene)))
    return worlds


def _scene(rng: np.random.Generator, hand: str, seed: int, duration_s: float) -> Scene:
    _, scene = begin(f"plates-{hand}", seed)
    press, hold = scene["phases"]
    press |= {"force_n": log_uniform(rng, *_FORCE_N), "duration_s": log_uniform(rng, 0.05, 1.5)}
    scene["electronics"] = {"noise_v": log_uniform(rng, *_NOISE_V)}
    if rng.random() < _TILTED:
        scene["load_gradient_per_mm"] = rng.uniform(-0.1, 0.1, 2).tolist()
    if rng.random() < _PARTIAL:
        touching = rng.choice(9, size=int(rng.integers(2, 9)), replace=False)
        scene["touching"] = np.sort(touching).tolist()
    if rng.random() < _STATIC:
        scene["surface"] |= {
            "static_ratio": rng.uniform(1.0, 1.4),
            "stribeck_mm_s": log_uniform(rng, 0.1, 4.0),
        }
    uneven = rng.random() < _UNEVEN
    scene["surface"]["unevenness"] = log_uniform(rng, *_UNEVENNESS) if uneven else 0.0
    COURSES[hand](rng, scene, duration_s - press["duration_s"] - hold["duration_s"])
    return made(scene)


def _hold(length_s: float) -> Document:
    return {"kind": "hold", "duration_s": max(length_s, 0.01)}


def _ramp(rng: np.random.Generator, length_s: float) -> Document:
    """Time in which a motor comes to its speed; half of them are there at once."""
    return {"ramp_s": min(log_uniform(rng, 0.01, 0.5), length_s / 2)} if rng.random() < 0.5 else {}


def _slide(rng: np.random.Generator, length_s: float) -> Document:
    speed = log_uniform(rng, *_SPEED_MM_S)
    return slide_phase(rng, duration_s=length_s, speed_mm_s=speed, **_ramp(rng, length_s))


def _slides(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    length_s = rng.uniform(1.0, left_s - 1.0)
    scene["phases"] += [_slide(rng, length_s), _hold(left_s - length_s)]


def _grooves(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    period_mm = log_uniform(rng, 0.6, 4.0)
    angle_deg = rng.uniform(-60.0, 60.0)
    scene["surface"] |= {
        "kind": "grooves",
        "period_mm": period_mm,
        "angle_deg": angle_deg,
        "static_ratio": 1.0,
    }
    _slides(rng, scene, left_s)


def _to_and_fro(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    n = max(2, round(left_s / log_uniform(rng, 1.5, 6.0)))
    way = _slide(rng, left_s / n * 0.8)
    for _ in range(n):
        scene["phases"] += [way, _hold(left_s / n * 0.2 * rng.uniform(0.1, 1.0))]
        way = way | {"direction_deg": turned(way["direction_deg"], float(rng.choice([180.0, 0.0, 90.0])))}


def _gripped(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    """Slide while the load changes."""
    start_s = sum(phase["duration_s"] for phase in scene["phases"])
    _slides(rng, scene, left_s)
    for at_s in rng.uniform(0.0, left_s - 1.0, 3):
        change_n = scene["phases"][0]["force_n"] * rng.uniform(0.05, 0.3) * rng.choice([-1, 1])
        disturb(scene, "load_n", "ramp", float(change_n) / 2, start_s + at_s, log_uniform(rng, 0.1, 2.0))


def _short(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    """Move, and stop before the contact slips; some go on later."""
    reach_mm = _REACH_MM * scene["surface"]["friction"]
    n = int(rng.integers(1, 4))
    goes_on = rng.random() < 0.3
    way = slide_phase(rng, speed_mm_s=1.0)
    for part in rng.uniform(0.15, 0.75, n) / n**0.5:
        length_s = min(log_uniform(rng, 0.03, 2.0), left_s / 2 / n)
        one = way | {
            "duration_s": length_s,
            "speed_mm_s": float(part) * reach_mm / length_s,
            **_ramp(rng, length_s),
        }
        scene["phases"] += [one, _hold(left_s / n * 0.8 - length_s)]
    if goes_on:
        scene["phases"] += [way | {"duration_s": left_s * 0.3, "speed_mm_s": log_uniform(rng, *_SPEED_MM_S)}]


def _loads(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    """Loads on a held object, in steps to less than its friction; some go beyond it in the end."""
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 1.0)}
    n = int(rng.integers(1, 4))
    load = load_phase(rng, scene, 1.0, 1.0)
    for part in np.sort(rng.uniform(0.1, 0.97, n)):
        length_s = min(log_uniform(rng, 0.03, 2.0), left_s / n / 2)
        load = load | {"duration_s": length_s, "tangential_n": float(part) * friction_n(scene)}
        scene["phases"] += [load, _hold(left_s / n * 0.8 - length_s)]
    if rng.random() < 0.3:
        beyond = {"duration_s": log_uniform(rng, 0.1, 2.0), "tangential_n": 1.2 * friction_n(scene)}
        scene["phases"] += [load | beyond]


def _oblique(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    """Press, change and take off load and shear together, within the friction cone."""
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 0.5)}
    press, hold = scene["phases"]
    left_s += press["duration_s"] + hold["duration_s"]
    load, limit_n, n = load_phase(rng, scene, 1.0, 1.0), friction_n(scene), int(rng.integers(2, 6))
    scene["phases"] = []
    for _ in range(n):
        length_s = min(log_uniform(rng, 0.05, 2.0), left_s / n / 2)
        part = log_uniform(rng, 0.3, 1.5)
        load = load | {
            "duration_s": length_s,
            "force_n": part * press["force_n"],
            "tangential_n": part * rng.uniform(0.1, 0.9) * limit_n,
        }
        scene["phases"] += [load, _hold(left_s / n - length_s)]


def _swings(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 1.0)}
    of_weight = rng.uniform(0.05, 0.5)
    weight = load_phase(rng, scene, 0.5, of_weight)
    start_s = sum(phase["duration_s"] for phase in scene["phases"]) + 0.5
    scene["phases"] += [weight, _hold(left_s - 0.5)]
    strength = rng.uniform(0.1, 0.95 - of_weight) * friction_n(scene)
    rate_hz = log_uniform(rng, 0.3, 5.0)
    along = {"frequency_hz": rate_hz, "direction_deg": any_direction_deg(rng)}
    disturb(scene, "pull_n", "sine", strength, start_s, left_s - 1.5, **along)


def _dragged(rng: np.random.Generator, scene: Document, left_s: float) -> None:
    """Drag an object by a spring: it sticks and slips."""
    scene["surface"] |= {"static_ratio": rng.uniform(1.1, 1.8), "stribeck_mm_s": rng.uniform(1.0, 4.0)}
    spring_n_mm = log_uniform(rng, 1.0, 5.0)
    scene["held_object"] = {"mass_kg": log_uniform(rng, 0.2, 1.0), "spring_n_mm": spring_n_mm}
    speed = scene["surface"]["static_ratio"] * friction_n(scene) / spring_n_mm / rng.uniform(2.0, 4.0)
    scene["phases"] += [slide_phase(rng, duration_s=left_s, speed_mm_s=speed)]


COURSES: Mapping[str, Callable[[np.random.Generator, Document, float], None]] = {
    "slide": _slides,
    "grooves": _grooves,
    "to-and-fro": _to_and_fro,
    "gripped": _gripped,
    "short": _short,
    "load": _loads,
    "oblique": _oblique,
    "swing": _swings,
    "dragged": _dragged,
}
"""Phases after press and hold, by name of the hand; each takes about so much time as is left, in s."""
HANDS = (
    *("slide",) * 4, *("grooves",) * 2, *("to-and-fro",) * 2, *("gripped",) * 2, *("short",) * 5,
    *("load",) * 4, *("oblique",) * 3, *("swing",) * 3, *("dragged",),
)  # fmt: skip

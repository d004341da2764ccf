"""Scenes held out: no constant and no setting of a detector was set on them.

A finding on them changed the scoring (`bench/slip/truth.py`: swelling pulls grow before truth reports
growth), which was set on other scenes.
"""

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import (
    any_direction_deg,
    begin,
    begin_quiet,
    disturb,
    friction_n,
    hold_phase,
    log_uniform,
    made,
    slide_phase,
    turned,
)

# Travel from rest to gross slip over friction, under the lightest press of a family (`mechanics.lumped`).
_SLIP_TRAVEL_MM = 0.23


def braking_drag(seed: int) -> Scene:
    """A slide that begins at full speed, slows down and continues slowly."""
    rng, scene = begin("braking-drag", seed)
    top = log_uniform(rng, 1.0, 15.0)
    slow, braked_s = top * rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0)
    profile = [[0.0, top], [braked_s, slow], [3.0, slow]]
    scene["phases"] += [slide_phase(rng, duration_s=3.0, profile=profile)]
    return made(scene)


def swelling_pull(seed: int) -> Scene:
    """A pull on a held object grows, at first as the square of time, beyond the friction limit."""
    rng, scene = begin_quiet("swelling-pull", seed, hold_s=5.0)
    strength, start_s = friction_n(scene) * rng.uniform(1.5, 2.5), rng.uniform(3.5, 4.5)
    weight = scene["phases"][-2]
    # A pull against the weight would first reduce shear.
    along_deg = turned(weight["direction_deg"], rng.uniform(-60.0, 60.0))
    disturb(scene, "pull_n", "pulse", strength, start_s, rng.uniform(1.0, 6.0), direction_deg=along_deg)
    return made(scene)


def slide_under_changing_grip(seed: int) -> Scene:
    """The grip changes by up to a half while the slide begins."""
    rng, scene = begin("changing-grip", seed)
    press, hold = scene["phases"]
    scene["phases"] += [slide_phase(rng, duration_s=3.0, speed_mm_s=log_uniform(rng, 0.25, 10.0))]
    change_n = press["force_n"] * rng.uniform(0.1, 0.5) * rng.choice([-1, 1])
    start_s = press["duration_s"] + hold["duration_s"] - rng.uniform(0.0, 0.3)
    disturb(scene, "load_n", "ramp", float(change_n), start_s, rng.uniform(0.3, 2.0))
    return made(scene)


def slip_on_shear(seed: int) -> Scene:
    """The skin is sheared within presliding, rests, and then slides at an angle to the shear."""
    rng, scene = begin("slip-on-shear", seed)
    speed_mm_s = log_uniform(rng, 0.25, 10.0)
    sheared_mm = rng.uniform(0.2, 0.6) * scene["surface"]["friction"] * _SLIP_TRAVEL_MM
    first = slide_phase(rng, duration_s=0.2, speed_mm_s=sheared_mm / 0.2)
    on_deg = turned(first["direction_deg"], rng.uniform(-60.0, 60.0))
    on = first | {"duration_s": 3.0, "speed_mm_s": speed_mm_s, "direction_deg": on_deg}
    scene["phases"] += [first, hold_phase(rng.uniform(0.5, 2.0)), on]
    return made(scene)


def walking(seed: int) -> Scene:
    """The hand belongs to a walker: every step pulls at the object, well below the friction limit."""
    rng, scene = begin_quiet("walking", seed, hold_s=9.0)
    step_hz, along_deg = rng.uniform(1.4, 2.4), any_direction_deg(rng)
    strength = friction_n(scene) * rng.uniform(0.05, 0.25)
    for times, aside_deg in ((1, 0.0), (2, rng.uniform(-40.0, 40.0))):
        more = {"frequency_hz": times * step_hz, "direction_deg": turned(along_deg, aside_deg)}
        disturb(scene, "pull_n", "sine", strength / times, 3.5, 8.0, **more)
    return made(scene)


def hand_over(seed: int) -> Scene:
    """A person pulls at the object below the friction limit, and lets go."""
    rng, scene = begin_quiet("hand-over", seed, hold_s=8.0)
    strength, direction_deg = friction_n(scene) * rng.uniform(0.2, 0.6), any_direction_deg(rng)
    start_s, length_s = rng.uniform(3.5, 5.0), rng.uniform(0.2, 1.5)
    for sign, later_s in ((1, 0.0), (-1, length_s + rng.uniform(0.5, 3.0))):
        when_s = start_s + later_s
        disturb(scene, "pull_n", "ramp", sign * strength, when_s, length_s, direction_deg=direction_deg)
    return made(scene)


def off_centre_squeeze(seed: int) -> Scene:
    """The grip on a tilted surface grows and falls: the load changes more on one side."""
    rng, scene = begin("off-centre-squeeze", seed)
    scene["load_gradient_per_mm"] = rng.uniform(-0.1, 0.1, 2).tolist()
    least_n = scene["phases"][0]["force_n"]
    for part in rng.uniform(1.0, 2.0, 5):
        scene["phases"] += [
            {"kind": "press", "duration_s": log_uniform(rng, 0.05, 1.0), "force_n": least_n * float(part)},
            hold_phase(rng.uniform(0.3, 2.0)),
        ]
    return made(scene)

"""Slides and rests of a minute: a slide is told until it ends, and a rest near its limit is none.

The emulator's skin over a plate at one speed, and under a load of 80 to 97 % of its friction limit. Where
friction is the same at every place, a slide and such a rest have the same loads and shears once shear has
grown, but for noise: only how it grew tells them apart.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bench.report import NONE, grouped, ratio
from bench.worlds.emulated import play, world_of
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.parts import begin, load_phase, log_uniform, made, slide_phase
from tactiled.events.types import GripEvent

MINUTES_FROM = 7_000  # seeds
_LENGTH_S, _TOLD_AFTER_S, _MOST_OF = 60.0, 0.5, 0.95
_NOISE_V = (0.3e-3, 3e-3)
_HOLD_EXTRA_S = 3.0  # so that the press is over and forgotten when something happens
_EVEN = 0.5  # share of plates with the same friction at every place


class Minute(NamedTuple):
    """Verdict on a slide or a rest of a minute, from 0.5 s after the slide began or the load was there."""

    slides: bool
    is_even: bool
    told: float  # part of the grip messages that say gross slip
    p_sliding: float  # median of the messages


def read_minute(seed: int, slides: bool) -> Minute | None:
    """Play and read a slide or a rest; None where it is not what it was drawn to be."""
    rng = np.random.default_rng([31, seed])
    unevenness = 0.0 if rng.random() < _EVEN else log_uniform(rng, 0.01, 0.15)
    noise_v = log_uniform(rng, *_NOISE_V)
    scene = _scene(slides, unevenness, noise_v, seed)
    world = world_of("plates", "minute", scene, play(scene))
    if world.slips != slides:  # friction at the place of a rest is that of a smoother one
        return None
    events = GripDetector(world.array).process(world.block)
    begin_s = world.gross_s[0] if slides else scene.duration_s - _LENGTH_S
    some = [
        event for event in events if isinstance(event, GripEvent) and event.time_s > begin_s + _TOLD_AFTER_S
    ]
    told = float(np.mean([event.state == "gross" for event in some]))
    return Minute(slides, unevenness == 0.0, told, float(np.median([event.p_sliding for event in some])))


def _scene(slides: bool, unevenness: float, noise_v: float, seed: int) -> Scene:
    rng, scene = begin("minute", seed)
    scene["surface"]["unevenness"] = unevenness
    scene["electronics"] = {"noise_v": noise_v}
    scene["phases"][1]["duration_s"] += _HOLD_EXTRA_S
    if slides:
        speed_mm_s = log_uniform(rng, 0.25, 20.0)
        scene["phases"] += [slide_phase(rng, duration_s=_LENGTH_S, speed_mm_s=speed_mm_s)]
    else:
        scene["held_object"] = {"mass_kg": log_uniform(rng, 0.1, 1.0)}
        pull = load_phase(rng, scene, log_uniform(rng, 0.05, 2.0), rng.uniform(0.8, 0.97))
        scene["phases"] += [pull, {"kind": "hold", "duration_s": _LENGTH_S}]
    return made(scene)


def minute_rows(found: Sequence[Minute]) -> Iterator[dict[str, str]]:
    """Yield the rows of the table, by the plate."""
    by_plate = grouped(found, lambda one: "even" if one.is_even else "uneven by 1 to 15 %")
    for name, some in {**by_plate, "all": found}.items():
        slides, rests = ([one for one in some if one.slides is slid] for slid in (True, False))
        yield {
            "plate": name,
            f"slides reported in {_MOST_OF:.0%} of their time": ratio(
                [one.told >= _MOST_OF for one in slides]
            ),
            "never reported": ratio([one.told == 0 for one in slides]),
            "p of sliding in slides that are not": _median([o for o in slides if o.told < _MOST_OF]),
            "rests called gross": ratio([one.told > 0 for one in rests]),
            "p of sliding in rests": _median(rests),
        }


def _median(some: Sequence[Minute]) -> str:
    return f"{np.median([one.p_sliding for one in some]):.2f}" if some else NONE

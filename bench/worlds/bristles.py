"""Worlds of bristles: independent elasto-plastic elements under one rigid object with mass.

Each taxel has 4 x 4 bristles. One that moves by d adds k d to its force, a part of it in a Maxwell branch
that relaxes; beyond its limit its tip slips. The limit of a bristle is ``mu p^(1-m)`` of its load p, falls
with the speed of the slide (Stribeck), grows with the logarithm of its rest, and differs over a rough
surface.
The object has mass and turns; the hand pulls it by a spring, or it hangs between this finger and a second
one, a spring with a friction of its own. A hand that carries and feels the object slide grips harder.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bench.worlds.arrays import places_mm
from bench.worlds.hands import GRAVITY, KEEP, STEP_S, HandPlan, log_uniform, plan, side_by_side
from bench.worlds.sensors import Drawn, Forces, measure_together
from bench.worlds.shapes import SHAPES, MovingLoads, PressureTable, draw_table
from bench.worlds.world import World
from tactiled.array import FloatArray

HANDS = (
    "carry", "carry", "carry", "carry", "carry", "carry", "carry", "slide", "creep", "slow-pull", "slow-pull",
    "fast-pull", "fast-pull", "twist", "ease", "ease", "falling-friction", "fill", "tap", "sway", "sway",
    "reverse", "near-limit", "near-limit", "rest", "low", "low", "slide", "creep", "slanted", "slanted",
)  # fmt: skip
TOUCHING = 0.03  # of the usual load
AT_LIMIT, ALMOST = 0.99, 0.93  # of its limit: a place slips; or has slipped just now
MOST_OF = 0.98  # of the limits of all places: so many slip where the contact slips
MOVES_MM_S = 0.1
_SIDE = 4  # bristles along each side of a taxel
_EACH = _SIDE**2
_SURFACE = 256  # places of a surface, after which it repeats
_LOST_MM = 40.0  # a carried object that has slid as far falls
_SPEED_S = 0.008  # over which the speed of a tip is averaged: a few steps


@dataclass(frozen=True, eq=False)
class PressedScene:
    """Drawn contact under an object with a table of pressures, and the plan of the hand that moves it."""

    drawn: Drawn
    plan: HandPlan
    table: PressureTable
    arrays: dict[str, FloatArray]  # of one shape in all scenes of a batch
    scalars: dict[str, float]  # among these "usual", the usual load, and "bears", the shear that it bears

    def forces(
        self, load: FloatArray, shear: FloatArray, truth: FloatArray, pressed: FloatArray, creep: float = 0.0
    ) -> Forces:
        """Courses of what the log sees, at its kept steps; pressed is the load of all places.

        Truth (3, steps) is utilisation, whether the contact slides, and the shear that it bears.
        """
        usual_n = self.scalars["usual"]
        return Forces(
            step_s=STEP_S * KEEP,
            load=load,
            shear=shear,
            utilisation=truth[0],
            slides=truth[1] > 0,
            limit=truth[2],
            touching=pressed > TOUCHING * usual_n,
            acceleration_m_s2=self.plan.course.acceleration_m_s2[KEEP - 1 :: KEEP][self.plan.logged],
            usual_n=usual_n,
            static_friction=self.scalars["bears"] / usual_n,
            creep=creep,
        )


def side_by_side_scenes(
    scenes: Sequence[PressedScene],
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Stack the scalars (scenes,) and the arrays (scenes, ...) of a batch, by name."""
    first = scenes[0]
    scalars = {name: np.array([s.scalars[name] for s in scenes]) for name in first.scalars}
    return scalars, {name: np.stack([s.arrays[name] for s in scenes]) for name in first.arrays}


def draw_worlds(seeds: range, minutes: float, hands: tuple[str, ...] = HANDS) -> list[World]:
    """Simulate worlds of so many minutes; all else is drawn from each seed."""
    return measure_together([_draw(seed, minutes, hands or HANDS) for seed in seeds], _simulate)


def _draw(seed: int, minutes: float, hands: tuple[str, ...]) -> PressedScene:
    rng = np.random.default_rng([41, seed])
    hand, shape = str(rng.choice(hands)), str(rng.choice(SHAPES))
    side, pitch = int(rng.choice([3, 3, 4])), rng.uniform(3.0, 4.5)
    x, y = places(side, pitch)
    angle = rng.uniform(0, 2 * np.pi)
    table = draw_table(rng, shape, x, y, None if hand == "twist" else angle)
    held = plan(rng, hand, 60 * minutes)
    mu = log_uniform(rng, 0.2, 1.3) * rng.lognormal(0, rng.uniform(0, 0.08), len(x))
    power = rng.uniform(0.0, 0.33)
    each = table.usual_n / len(x)
    ages = rng.uniform(0.0, 0.1)
    limit = mu * each * (table.at(table.usual_n) / each) ** (1 - power) * _aged(ages, 1.0)
    bears = float(limit.sum())
    loaded = int((limit > 0.05 * limit.mean()).sum())
    stiffness = bears / log_uniform(rng, 0.1, 1.0)  # N/mm: elastic travel 0.1 to 1 mm
    radius = table.radius_mm
    second = bears * rng.uniform(0.8, 1.3) if held.course.carries else 0.0
    second_stiffness = stiffness * rng.uniform(0.3, 1.5) if held.course.carries else 0.0
    whole = stiffness * (1 + held.course.spring) + second_stiffness
    mass: float = whole / (2 * np.pi * rng.uniform(12.0, 45.0)) ** 2
    if held.course.carries:
        # Weight and pull belong together; the stiffest contacts are as heavy as integration needs.
        mass = max((bears + second) * 0.45 / GRAVITY / 1e3, whole / 400.0**2)
    arm = rng.normal(0, 0.6, 2)
    scalars = {
        "usual": table.usual_n, "power": power, "bears": bears, "second": second, "mass": mass,
        "second_stiffness": second_stiffness, "stiffness": stiffness,
        "spring": held.course.spring * stiffness,
        "radius": radius, "angle": angle, "maxwell": rng.uniform(0.1, 0.4),
        "tau_s": log_uniform(rng, 0.1, 3.0), "falls": rng.uniform(0.1, 0.3),
        "falls_mm_s": log_uniform(rng, 1.0, 15.0), "ages": ages,
        "bristle": stiffness / loaded,
        "ages_mm": log_uniform(rng, 0.003, 0.05),
        "rough": max(rng.uniform(-0.03, 0.06), 0.0),
        "rough_mm": log_uniform(rng, 0.1, 2.0),
        "ridges": rng.uniform(0.02, 0.2) * (rng.random() < 0.2), "ridge_mm": rng.uniform(0.6, 5.0),
        "ridge_angle": angle + rng.normal(0, 0.6), "lever_mm": rng.uniform(0.0, 1.5),
        "moves": float(hand != "twist"), "turns": float(hand == "twist"),
        "rocks": max(rng.uniform(-0.1, 0.1), 0.0),
        "rocks_hz": log_uniform(rng, 0.1, 3.0), "rocks_phase": rng.uniform(0, 2 * np.pi),
        "rocks_angle": rng.uniform(0, 2 * np.pi),
        "damping": rng.uniform(0.4, 0.9), "reflex_s": rng.uniform(0.02, 0.12),
        "reflex_per_s": rng.uniform(2.0, 12.0) * (rng.random() < 0.85), "carries": float(held.course.carries),
    }  # fmt: skip
    if hand == "near-limit":
        # What takes friction, loads or moments beyond the plan would make it slide.
        arm = np.zeros(2)
        scalars |= {"lever_mm": 0.0, "rough": 0.0, "ridges": 0.0, "moves": 0.0, "rocks": 0.0}
    centre = (float((limit * x).sum()) / bears, float((limit * y).sum()) / bears)
    arrays = {
        "x": x, "y": y, "mu": mu, "surface": rng.normal(size=(side**2, _SURFACE)),
        "arm_mm": np.array([centre[0] + arm[0], centre[1] + arm[1]]),
    }  # fmt: skip
    drawn = Drawn("bristles", hand, seed, side, pitch, rng)
    return PressedScene(drawn, held, table, arrays, scalars)


def places(side: int, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Places (nodes,) of the bristles in mm, taxel by taxel."""
    taxel_x, taxel_y = places_mm(side, pitch)
    own = pitch * ((np.arange(_SIDE) + 0.5) / _SIDE - 0.5)
    own_x, own_y = (a.ravel() for a in np.meshgrid(own, own))
    return (taxel_x[:, None] + own_x).ravel(), (taxel_y[:, None] + own_y).ravel()


def _aged(ages: Any, rest_s: Any) -> Any:
    """Factor of friction after a rest: grows by `ages` in 10 s."""
    return 1 + ages / 1.5 * np.log10(1 + rest_s / 0.3)


def _simulate(scenes: list[PressedScene]) -> list[Forces]:
    """Integrate a batch of worlds with arrays of one size."""
    v, arrays = side_by_side_scenes(scenes)
    x, y, mu, surface = (arrays[name] for name in ("x", "y", "mu", "surface"))
    loads_of = MovingLoads([s.table for s in scenes])
    longest = max(len(s.plan.course) for s in scenes)
    course = partial(side_by_side, [s.plan for s in scenes])
    load_course, friction = course("load"), course("friction")
    push = v["bears"] + v["second"]
    pull = course("pull") * push * (1 + v["spring"] / v["stiffness"]) + course("travel_mm") * v["spring"]
    turn = course("turn") * v["bears"] * v["radius"]
    n, nodes = x.shape
    taxels, worlds = nodes // _EACH, np.arange(n)
    along = np.stack([np.cos(v["angle"]), np.sin(v["angle"])])
    arm = arrays["arm_mm"].T
    lever = arm[0] * along[1] - arm[1] * along[0]
    k_node = v["bristle"][:, None]
    branch, relax = v["maxwell"][:, None], np.exp(-STEP_S / v["tau_s"])[:, None]
    each = (v["usual"] / nodes)[:, None]
    mu_each, exponent = mu * each ** v["power"][:, None], 1 - v["power"][:, None]
    inertia, radius2 = v["mass"] * v["radius"] ** 2, v["radius"] ** 2
    whole = v["stiffness"] + v["second_stiffness"] + v["spring"]
    skin_damping = 2 * v["damping"] * np.sqrt(whole * v["mass"])
    hand_damping = 2 * v["damping"] * np.sqrt(v["spring"] * v["mass"])
    ridge = np.stack([np.cos(v["ridge_angle"]), np.sin(v["ridge_angle"])]) * 2 * np.pi / v["ridge_mm"]
    ridge_phase = ridge[0][:, None] * x + ridge[1][:, None] * y
    ridged, rough = v["ridges"][:, None], v["rough"][:, None]
    force = np.zeros((2, n, nodes))
    relaxing = np.zeros((2, n, nodes))
    age, tip, shear_x, shear_y = np.ones((n, nodes)), np.zeros((n, nodes)), np.zeros(n), np.zeros(n)
    speed = np.zeros(n)
    place, velocity, travel = np.zeros((3, n)), np.zeros((3, n)), np.zeros(n)
    other, grip, felt, lost = np.zeros((3, n)), np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.bool_)
    kept = longest // KEEP
    out_load = np.zeros((kept, n, taxels), dtype=np.float32)
    out_shear = np.zeros((kept, n, 2, taxels), dtype=np.float32)
    out = np.zeros((3, kept, n), dtype=np.float64)
    moves = v["moves"] * np.stack([*along, np.zeros(n)]) + v["turns"] * np.stack(
        [*np.zeros((2, n)), v["radius"]]
    )
    rocks = v["rocks"] / v["radius"] * np.stack([np.cos(v["rocks_angle"]), np.sin(v["rocks_angle"])])
    for k in range(kept * KEEP):
        # Load: the hand's, what a grip adds, and none once the object is lost.
        free = load_course[k] < 1e-3
        lost = (lost | ((v["carries"] > 0) & (np.abs(place[:2]).max(axis=0) > _LOST_MM))) & ~free
        relative = load_course[k] * (1 + grip) * ~lost
        load = loads_of.at(relative, (moves * place).sum(axis=0))
        total = np.maximum(load.sum(axis=1), 1e-9)
        # Shear acts at the surface, and its moment loads one side; so does a hand that rocks.
        lean = v["lever_mm"] / (total * radius2)
        rocked = rocks * np.sin(2 * np.pi * v["rocks_hz"] * STEP_S * k + v["rocks_phase"])
        lean_x, lean_y = lean * shear_x + rocked[0], lean * shear_y + rocked[1]
        load *= np.clip(1 + lean_x[:, None] * x + lean_y[:, None] * y, 0.2, 2.0)
        if ridged.any():
            phase = ridge[0] * place[0] + ridge[1] * place[1]
            load *= 1 + ridged * np.sin(ridge_phase + phase[:, None])
        load *= (relative * v["usual"] / np.maximum(load.sum(axis=1), 1e-9))[:, None]
        # Limits.
        cell = travel.astype(int)
        here, there = surface[worlds, :, cell % _SURFACE], surface[worlds, :, (cell + 1) % _SURFACE]
        uneven = np.maximum(1 + rough * (here + (there - here) * (travel - cell)[:, None]), 0.3)
        limit = mu_each * load**exponent * friction[k][:, None]
        limit *= 1 - v["falls"][:, None] * (1 - np.exp(-speed / v["falls_mm_s"]))[:, None]
        limit *= _aged(v["ages"][:, None], age)
        limit = (limit.reshape(n, taxels, _EACH) * uneven[:, :, None]).reshape(n, nodes)
        # Bristles: both branches move, one relaxes, tips slip.
        step = velocity * STEP_S
        fade = relaxing * (1 - relax)
        relaxing -= fade
        force -= fade
        for axis, moved in enumerate(
            (step[0][:, None] - step[2][:, None] * y, step[1][:, None] + step[2][:, None] * x)
        ):
            moved *= k_node
            force[axis] += moved
            relaxing[axis] += branch * moved
        size = np.sqrt(force[0] ** 2 + force[1] ** 2)
        over = np.maximum(1 - limit / np.maximum(size, 1e-12), 0.0)
        cut = force * over
        force -= cut
        relaxing -= branch * cut
        slid = size * over / k_node
        tip += (slid / STEP_S - tip) * (STEP_S / _SPEED_S)
        age = (age + STEP_S) * np.exp(-slid / v["ages_mm"][:, None])
        # The object.
        shear_x, shear_y = force[0].sum(axis=1), force[1].sum(axis=1)
        moment = (x * force[1] - y * force[0]).sum(axis=1)
        _second_finger(other, step, v, relative, friction[k])
        applied = pull[k] * ~lost
        pushed = applied * along - v["spring"] * place[:2]
        velocity[0] += STEP_S * (pushed[0] - shear_x - other[0]) / v["mass"]
        velocity[1] += STEP_S * (pushed[1] - shear_y - other[1]) / v["mass"]
        turned = turn[k] + applied * lever - v["spring"] * radius2 * place[2]
        velocity[2] += STEP_S * (turned - moment - other[2] * v["radius"]) / inertia
        borne = np.maximum(limit.sum(axis=1), 1e-9)
        # A rough surface lets bristles rest for a moment in a steady slide: those that just moved count too.
        near = np.where(tip > MOVES_MM_S / 2, ALMOST, AT_LIMIT)
        slips = size - size * over >= near * limit
        sticks = 1 - (limit * slips).sum(axis=1) / borne
        velocity /= 1 + STEP_S * np.maximum((skin_damping * sticks + hand_damping) / v["mass"], 0.2)
        place += STEP_S * velocity
        speed = (limit * tip).sum(axis=1) / borne
        travel += speed * STEP_S / v["rough_mm"]
        # A hand that feels the slide for a while grips harder, until it ends.
        felt = np.where(speed > 2.0, felt + STEP_S, 0.0) * v["carries"]
        grip = (
            np.where(felt > v["reflex_s"], np.minimum(grip + v["reflex_per_s"] * STEP_S, 1.2), grip) * ~free
        )
        place *= ~free
        velocity *= ~(free | lost)
        if k % KEEP == KEEP - 1:
            j = k // KEEP
            out_load[j] = load.reshape(n, taxels, _EACH).sum(axis=2)
            out_shear[j] = force.reshape(2, n, taxels, _EACH).sum(axis=3).transpose(1, 0, 2)
            touches = relative > TOUCHING
            out[0, j] = np.where(touches, np.sqrt((force**2).sum(axis=0)).sum(axis=1) / borne, 0.0)
            out[1, j] = touches & (sticks < 1 - MOST_OF) & (speed > MOVES_MM_S)
            out[2, j] = borne
    found = []
    for b, scene in enumerate(scenes):
        logged = scene.plan.logged
        felt = out_load[logged, b]
        found.append(scene.forces(felt, out_shear[logged, b], out[:, logged, b], felt.sum(axis=1)))
    return found


def _second_finger(
    other: FloatArray, step: FloatArray, v: dict[str, FloatArray], relative: FloatArray, friction: FloatArray
) -> None:
    """Force (x, y, moment over radius) of the second finger: a spring that slips as one at its limit."""
    k = v["second_stiffness"]
    other[0] += k * step[0]
    other[1] += k * step[1]
    other[2] += k * step[2] * v["radius"]
    size = np.sqrt((other**2).sum(axis=0))
    other *= np.minimum(1.0, v["second"] * relative * friction / np.maximum(size, 1e-12))

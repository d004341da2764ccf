"""Worlds of a sheet: a coupled elastic lattice under a probing hand that moves by position.

The skin is a square lattice of nodes half a taxel apart, each tied to the ground and to its neighbours, with
no mass: forces balance after every step. The object has no mass either and follows the hand through a spring
and a dashpot. What a place bears is adhesion of the area that touches plus friction in proportion to its
load, and grows with the logarithm of the speed of slip, so that a slide begins smoothly. The load of a
hand that holds its position relaxes, and the readings creep with a power of time.
"""

from functools import partial

import numpy as np

from bench.worlds.arrays import places_mm
from bench.worlds.bristles import (
    ALMOST,
    AT_LIMIT,
    MOST_OF,
    MOVES_MM_S,
    TOUCHING,
    PressedScene,
    side_by_side_scenes,
)
from bench.worlds.hands import KEEP, STEP_S, log_uniform, plan, side_by_side
from bench.worlds.sensors import Drawn, Forces, measure_together, mixed
from bench.worlds.shapes import SHAPES, MovingLoads, draw_table
from bench.worlds.world import World
from tactiled.array import FloatArray

HANDS = (
    "slow-pull", "slow-pull", "slow-pull", "slow-pull", "fast-pull", "fast-pull", "fast-pull", "twist",
    "twist", "ease", "ease", "tap", "sway", "sway", "sway", "reverse", "reverse", "near-limit", "near-limit",
    "rest", "low", "low", "low", "slide", "creep", "slanted", "slanted",
)  # fmt: skip
# A probing hand pushes further than the elastic travel, which friction that grows with speed lengthens.
_REACH = {
    "slow-pull": 2.0,
    "fast-pull": 2.0,
    "twist": 2.0,
    "reverse": 1.5,
    "ease": 1.3,
    "tap": 1.3,
    "sway": 1.3,
}
_SWEEPS = 2  # of relaxation a step: what is left balances in the next ones
_SPEED_S = 0.02  # over which the speed of slip is averaged
_FOLLOWS_S = 0.006  # the object behind the hand
_SPEED_MM_S = 0.1  # of slip, from which friction grows with its logarithm


def draw_worlds(seeds: range, minutes: float, hands: tuple[str, ...] = HANDS) -> list[World]:
    """Simulate worlds of so many minutes; all else is drawn from each seed."""
    return measure_together([_draw(seed, minutes, hands or HANDS) for seed in seeds], _simulate)


def _draw(seed: int, minutes: float, hands: tuple[str, ...]) -> PressedScene:
    rng = np.random.default_rng([43, seed])
    hand, shape = str(rng.choice(hands)), str(rng.choice(SHAPES))
    side, pitch = int(rng.choice([3, 3, 4])), rng.uniform(3.2, 4.5)
    line = pitch / 2 * (np.arange(2 * side + 1) - side)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    angle = rng.uniform(0, 2 * np.pi)
    table = draw_table(rng, shape, x, y, None if hand == "twist" else angle)
    held = plan(rng, hand, 60 * minutes)
    usual = table.at(table.usual_n)
    area = usual > 0
    mu, sticky = log_uniform(rng, 0.2, 1.2), rng.uniform(0.0, 0.4)
    bears = mu * table.usual_n
    adhesion = np.full(len(x), sticky * bears / max(int(area.sum()), 1))
    ground = bears / max(int(area.sum()), 1) / log_uniform(rng, 0.1, 1.0)
    taxel_x, taxel_y = places_mm(side, pitch)
    near = np.exp(-((taxel_x[:, None] - x) ** 2 + (taxel_y[:, None] - y) ** 2) / (2 * (0.35 * pitch) ** 2))
    scalars = {
        "usual": table.usual_n, "bears": bears, "ground": ground, "mu": mu * (1 - sticky),
        "coupling": ground * rng.uniform(0.1, 0.8), "stiffness": ground * float(area.sum()),
        "grows": rng.uniform(0.01, 0.06), "hand": log_uniform(rng, 0.7, 20.0),
        "angle": angle, "radius": float(np.hypot(x[area], y[area]).mean()),
        "moves": float(hand != "twist"), "turns": table.radius_mm * float(hand == "twist"),
        "relaxes": rng.uniform(0.0, 0.05), "creep": rng.uniform(0.01, 0.08),
    }  # fmt: skip
    scalars["reach"] = _REACH.get(hand, 1.0)
    if hand == "near-limit":
        # A load that falls, or moves, would take it beyond.
        scalars |= {"relaxes": 0.0, "moves": 0.0}
    arrays = {"x": x, "y": y, "adhesion": adhesion, "to_taxels": near / near.sum(axis=0)}
    return PressedScene(Drawn("sheet", hand, seed, side, pitch, rng), held, table, arrays, scalars)


def _simulate(scenes: list[PressedScene]) -> list[Forces]:
    """Relax a batch of lattices of one size, step by step."""
    v, arrays = side_by_side_scenes(scenes)
    adhesion, x, y = arrays["adhesion"], arrays["x"], arrays["y"]
    longest = max(len(s.plan.course) for s in scenes)
    course = partial(side_by_side, [s.plan for s in scenes])
    load_course, friction = course("load"), course("friction")
    hand, elastic = v["hand"] * v["stiffness"], v["bears"] / v["stiffness"]
    # Elastic travel of the skin and of the hand's own spring.
    way = course("pull") * v["reach"] * elastic * (1 + 1 / v["hand"]) + course("travel_mm")
    turn = course("turn") * v["reach"] * elastic * (1 + 1 / v["hand"]) / v["radius"]
    loads_of = MovingLoads([s.table for s in scenes])
    n, nodes = x.shape
    side = round(np.sqrt(nodes))
    along = np.stack([np.cos(v["angle"]), np.sin(v["angle"])])
    moves = np.stack([*(v["moves"] * along), v["turns"]])  # way of the loads for each place of the object
    ground, coupling = v["ground"][:, None], v["coupling"][:, None]
    neighbours = _neighbours(side)
    own = ground + coupling * neighbours
    drag = (v["stiffness"] + hand) * _FOLLOWS_S
    u, slip, touch_s = np.zeros((2, n, nodes)), np.zeros((n, nodes)), np.zeros(n)
    place, balance = np.zeros((3, n)), np.zeros((3, n))
    kept = longest // KEEP
    out_load, out_u = np.zeros((kept, n, nodes), np.float32), np.zeros((kept, 2, n, nodes), np.float32)
    out = np.zeros((3, kept, n))
    for k in range(kept * KEEP):
        free = load_course[k] < 1e-3
        touch_s = np.where(free, 0.0, touch_s + STEP_S)
        relative = load_course[k] * (1 - v["relaxes"] * np.log1p(touch_s / 0.3))
        load = loads_of.at(relative, (moves * place).sum(axis=0))
        limit = adhesion * (load > 0) * np.minimum(relative * 5, 1)[:, None] + v["mu"][:, None] * load
        limit *= (1 + v["grows"][:, None] * np.log1p(slip / _SPEED_MM_S)) * friction[k][:, None]
        # The object goes where hand and skin let it, and takes along the places that stick.
        wanted = np.stack([way[k] * along[0], way[k] * along[1], turn[k]])
        step = STEP_S * (hand * (wanted - place) - balance) / drag
        place += step
        touches = load > 0
        moved = np.stack([step[0][:, None] - step[2][:, None] * y, step[1][:, None] + step[2][:, None] * x])
        u += moved * touches
        back = np.zeros((n, nodes))
        for _ in range(_SWEEPS):
            force = own * u - coupling * _sums(u, side)
            size = np.sqrt(force[0] ** 2 + force[1] ** 2)
            over = np.maximum(1 - limit / np.maximum(size, 1e-12), 0.0)
            u -= force * over / own
            back += size * over / own * touches
        slip += (back / STEP_S - slip) * (STEP_S / _SPEED_S)
        force *= 1 - over
        size *= 1 - over
        balance[0], balance[1] = force[0].sum(axis=1), force[1].sum(axis=1)
        balance[2] = (x * force[1] - y * force[0]).sum(axis=1) / v["radius"] ** 2
        place *= ~free
        if k % KEEP == KEEP - 1:
            j = k // KEEP
            borne = np.maximum(limit.sum(axis=1), 1e-9)
            slips = size >= np.where(slip > MOVES_MM_S / 2, ALMOST, AT_LIMIT) * limit
            out_load[j], out_u[j] = load, u
            in_touch = relative > TOUCHING
            out[0, j] = np.where(in_touch, size.sum(axis=1) / borne, 0.0)
            sticks = 1 - (limit * slips).sum(axis=1) / borne
            out[1, j] = in_touch & (sticks < 1 - MOST_OF) & ((limit * slip).sum(axis=1) / borne > MOVES_MM_S)
            out[2, j] = borne
    found = []
    for b, scene in enumerate(scenes):
        logged, to_taxels = scene.plan.logged, scene.arrays["to_taxels"]
        # What springs bring to the ground is shared among the taxels.
        pressed, sheared = out_load[logged, b], scene.scalars["ground"] * out_u[logged, :, b]
        felt = mixed(pressed, to_taxels), mixed(sheared, to_taxels)
        found.append(scene.forces(*felt, out[:, logged, b], pressed.sum(axis=1), scene.scalars["creep"]))
    return found


def _sums(u: FloatArray, side: int) -> FloatArray:
    """Sum of the neighbours of each node."""
    grid = u.reshape(*u.shape[:2], side, side)
    found = np.zeros_like(grid)
    found[..., 1:, :] += grid[..., :-1, :]
    found[..., :-1, :] += grid[..., 1:, :]
    found[..., 1:] += grid[..., :-1]
    found[..., :-1] += grid[..., 1:]
    return np.asarray(found.reshape(u.shape))


def _neighbours(side: int) -> FloatArray:
    """Number of neighbours (nodes,)."""
    return np.asarray(_sums(np.ones((1, 1, side**2)), side)[0, 0])

"""Worlds of grasps: the emulator's held objects under grips that are drawn at random.

Objects, weights, events and electronics are those of the `hold-SEED` scenes, played by `bench.hold.batch`. No
controller reads the sensor: the grip follows a drawn course in parts of the grip that just bears the load.
Where the object slides, most grippers grip harder after a drawn time. A world is as long as its scene, 7 s,
and ends where the object falls: nothing holds it any more.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.hold.batch import ALL_SLIDES, RATE_HZ, HeldBatch
from bench.hold.play import MOST_N, least_n
from bench.worlds.emulated import TOUCHING_N, Played, world_of
from bench.worlds.hands import log_uniform
from bench.worlds.world import World
from tactiled.array import FloatArray
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families.holding import HOLD_S, LIFTED_S, START_N, hold

_SCANS = round(HOLD_S * RATE_HZ)
_CATCHES = 0.8  # share of grippers that grip harder when the object slides
_CATCH_S = (0.01, 0.15)  # an object that slides by a tenth of its weight falls within 0.2 s
_BATCH = 24


@dataclass(frozen=True)
class _Move:
    """Move of the grip to a factor of the one that just bears the load at its end."""

    at_s: float
    factor: float
    takes_s: float
    for_all: bool = False  # of the one that bears all loads from there on


@dataclass(frozen=True, eq=False)
class _Grasp:
    """Drawn grasp: the grip (scans,) to command in N, and how the gripper reacts when the object slides."""

    hand: str
    scene: Scene
    goal_n: FloatArray
    catch_scans: float
    tighter: float


def draw_worlds(seeds: range, _minutes: float, hands: tuple[str, ...] = ()) -> list[World]:
    """Play grasps of 7 s, whatever the minutes asked for."""
    grasps = [_draw(seed, hands or HANDS) for seed in seeds]
    found = []
    for first in range(0, len(grasps), _BATCH):
        some = grasps[first : first + _BATCH]
        for grasp, played in zip(some, _play(some), strict=True):
            found.append(world_of("grasps", grasp.hand, grasp.scene, played))
    return found


def _draw(seed: int, hands: tuple[str, ...]) -> _Grasp:
    rng = np.random.default_rng([53, seed])
    hand, scene = str(rng.choice(hands)), hold(seed)
    time_s = np.arange(1, _SCANS + 1) / np.float64(RATE_HZ)
    least = least_n(scene, time_s)
    touch = _Move(rng.uniform(0.0, 0.6), 0.0, rng.uniform(0.05, 0.4))
    goal = _ramp(time_s, touch) * START_N * rng.uniform(1.0, 1.6)
    for move in COURSES[hand](rng):
        # What is moved to before the lift is to bear the object after it.
        scan = min(round(max(move.at_s + move.takes_s, LIFTED_S) * RATE_HZ), _SCANS - 1)
        bears_n = float(least[scan:].max() if move.for_all else least[scan])
        goal += (move.factor * bears_n - goal) * _ramp(time_s, move)
    catch_s = log_uniform(rng, *_CATCH_S) if rng.random() < _CATCHES else np.inf
    return _Grasp(hand, scene, np.minimum(goal, MOST_N), catch_s * RATE_HZ, rng.uniform(1.1, 1.6))


def _ramp(time_s: FloatArray, move: _Move) -> FloatArray:
    return np.clip((time_s - move.at_s) / move.takes_s, 0.0, 1.0)


def _lift_grip(rng: np.random.Generator, low: float, high: float, *, for_all: bool = False) -> _Move:
    """Move before the object hangs freely."""
    return _Move(rng.uniform(0.9, 1.2), 1 / rng.uniform(1 / high, 1 / low), rng.uniform(0.05, 0.2), for_all)


def _steps(rng: np.random.Generator) -> list[_Move]:
    at_s = np.sort(rng.uniform(LIFTED_S, 6.5, rng.integers(2, 6)))
    return [_Move(at, rng.uniform(0.6, 3.0), _takes_s(rng)) for at in at_s.tolist()]


def _ease(rng: np.random.Generator) -> list[_Move]:
    at_s, takes_s = rng.uniform(LIFTED_S, 4.0), log_uniform(rng, 0.2, 3.0)
    eased = _Move(at_s, rng.uniform(0.75, 1.1), takes_s)
    again = _Move(at_s + takes_s + rng.uniform(0.0, 1.0), rng.uniform(1.1, 2.5), _takes_s(rng))
    return [_lift_grip(rng, 1.2, 2.5), eased, again]


def _dips(rng: np.random.Generator) -> list[_Move]:
    moves, at_s = [_lift_grip(rng, 1.15, 2.5)], rng.uniform(LIFTED_S, 3.5)
    while at_s < 6.0:
        moves.append(_Move(at_s, rng.uniform(0.6, 1.1), rng.uniform(0.05, 0.2)))
        at_s += rng.uniform(0.08, 0.5)
        moves.append(_Move(at_s, rng.uniform(1.15, 2.5), rng.uniform(0.05, 0.2)))
        at_s += rng.uniform(0.8, 2.5)
    return moves


def _takes_s(rng: np.random.Generator) -> float:
    return log_uniform(rng, 0.05, 2.0)


COURSES: Mapping[str, Callable[[np.random.Generator], list[_Move]]] = {
    "hold": lambda rng: [_lift_grip(rng, 1.1, 3.0)],
    "rest": lambda rng: [_lift_grip(rng, 1.04, 3.0, for_all=True)],
    "steps": _steps,
    "ease": _ease,
    "dips": _dips,
}
"""Moves of the grip after the touch, by name of the hand."""
HANDS = (*("hold",) * 3, *("rest",) * 3, *("steps",) * 2, *("ease",) * 2, *("dips",) * 2)


def _play(grasps: Sequence[_Grasp]) -> list[Played]:
    """Play a batch in simulated time, until each object falls."""
    batch = HeldBatch([grasp.scene for grasp in grasps])
    goal_n = np.stack([grasp.goal_n for grasp in grasps], axis=1)
    catch_scans, tighter = (
        np.array([getattr(g, name) for g in grasps]) for name in ("catch_scans", "tighter")
    )
    slid, times = np.zeros(len(grasps)), np.ones(len(grasps))
    volts, grip_n, shear_n, friction, slides, fallen = [], [], [], [], [], []
    for goal in goal_n:
        batch.command(np.minimum(goal * times, MOST_N))
        volts.append(batch.scan())
        grip_n.append(batch.grip_n)
        shear_n.append(batch.shear_n)
        friction.append(batch.friction)
        slides.append((batch.sliding > ALL_SLIDES) & (batch.grip_n > TOUCHING_N))
        fallen.append(batch.has_fallen.copy())
        slid = np.where(slides[-1], slid + 1, 0)
        caught = slid > catch_scans
        times, slid = np.where(caught, times * tighter, times), np.where(caught, 0, slid)
    lengths = np.sum(~np.array(fallen), axis=0)
    series = [np.array(one) for one in (volts, grip_n, shear_n, friction, slides)]
    return [Played(*(one[:n, e] for one in series)) for e, n in enumerate(lengths.tolist())]

"""Courses of hands in the worlds of strokes, made of pieces in which travel or shear is given.

A course is a row of touches; each begins and ends without load. Loads are in parts of the usual load, shear
in parts of what the contact bears at the usual load.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.worlds.hands import log_uniform, smooth
from tactiled.array import FloatArray

STEP_S = 0.004
_NEAREST = 0.97  # utilisation of rests; load changes leave it below 0.975, the tremor below 0.985
_SWAYED = 0.975
_ANOTHER_S = 4.0  # left, from which another touch follows
_SLIDES = 1.3  # times its limit: shear that a hand goes on to where it makes the contact slide


@dataclass(frozen=True, eq=False)
class Piece:
    """Part of a course in which one quantity is given."""

    # Travel of the surface in mm since the piece began; shear; or part of the
    # shear at the beginning of the piece that is left while the surface rests.
    given: Literal["travel", "shear", "kept"]
    # load, course (n,): load, and the given quantity
    load: FloatArray
    course: FloatArray
    # Direction of the surface's motion, in radians. Shear along it only grows within a piece.
    angle: float = 0.0
    slide_mm_s: float = 0.0  # speed of the surface once the given shear is beyond the limit

    def __len__(self) -> int:
        return len(self.load)


def draw_pieces(rng: np.random.Generator, hand: str, duration_s: float) -> list[Piece]:
    """Draw the pieces of a world; they last at least as long as it."""
    pieces: list[Piece] = []
    steps = round(duration_s / STEP_S)
    while (left := steps - sum(map(len, pieces))) > 0:
        left_s = left * STEP_S
        if pieces and left_s < _ANOTHER_S:
            pieces.append(_rest(left_s))
            break
        pieces += [_rest(rng.uniform(0.3, 1.2)), *HANDS[hand](rng, left_s - 1.2)]
    return pieces


def _time(length_s: float) -> FloatArray:
    """Return the instants of a piece, from one step after its beginning on."""
    return np.arange(1, max(round(length_s / STEP_S), 1) + 1) * np.float64(STEP_S)


def _ramp(rng: np.random.Generator, t: FloatArray, start: float, length: float) -> FloatArray:
    """Course from 0 to 1, straight or smooth."""
    return np.clip((t - start) / length, 0.0, 1.0) if rng.random() < 0.5 else smooth(t, start, length)


def _rest(length_s: float) -> Piece:
    t = _time(length_s)
    return Piece("kept", np.zeros_like(t), np.zeros_like(t))


def _hold(length_s: float) -> Piece:
    t = _time(length_s)
    return Piece("kept", np.ones_like(t), np.ones_like(t))


def _press(rng: np.random.Generator) -> Piece:
    length_s = log_uniform(rng, 0.05, 1.2)
    t = _time(length_s)
    return Piece("kept", _ramp(rng, t, 0.0, length_s), np.zeros_like(t))


def _lift(rng: np.random.Generator, load: float = 1.0) -> Piece:
    """Unload obliquely, so that utilisation stays or falls."""
    length_s = log_uniform(rng, 0.03, 0.5)
    t = _time(length_s)
    left = 1 - _ramp(rng, t, 0.0, length_s)
    return Piece("kept", load * left, left ** rng.uniform(1.0, 2.0))


def _slide(rng: np.random.Generator, length_s: float, angle: float) -> Piece:
    t = _time(length_s)
    ramp_s = min(log_uniform(rng, 0.01, 0.5), length_s / 3)
    speed = log_uniform(rng, 0.3, 30.0) * smooth(t, 0.0, ramp_s) * (1 - smooth(t, t[-1] - ramp_s, ramp_s))
    return Piece("travel", np.ones_like(t), np.cumsum(speed) * STEP_S, angle)


def _stop(rng: np.random.Generator, length_s: float) -> Piece:
    """Rest after a slide, in which the skin relaxes."""
    t, kept = _time(length_s), rng.uniform(0.4, 1.0)
    return Piece("kept", np.ones_like(t), kept + (1 - kept) * np.exp(-t / log_uniform(rng, 0.1, 1.0)))


def _follow(shear: FloatArray, load: FloatArray, angle: float, slide_mm_s: float = 0.0) -> Iterator[Piece]:
    """Divide a course of shear, which may change its sign, where it turns back."""
    change = np.sign(np.diff(shear, prepend=0.0))
    moves = np.flatnonzero(change)
    turns = moves[1:][change[moves[1:]] != change[moves[:-1]]]
    for first, last in zip([0, *turns], [*turns, len(shear)], strict=True):
        falls = (change[first:last] < 0).any()
        part, sign = slice(first, last), -1.0 if falls else 1.0
        yield Piece("shear", load[part], sign * shear[part], angle + np.pi * falls, slide_mm_s)


def _stroke(rng: np.random.Generator, left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 2.0))
    yield _slide(rng, min(rng.uniform(1.0, 10.0), max(left_s - 2.0, 1.0)), rng.uniform(0, 2 * np.pi))
    yield _stop(rng, rng.uniform(0.3, 2.0))
    yield _lift(rng)


def _strokes(rng: np.random.Generator, _left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 1.5))
    angle = rng.uniform(0, 2 * np.pi)
    for _ in range(round(log_uniform(rng, 2.0, 16.0))):
        yield _slide(rng, rng.uniform(0.5, 3.0), angle)
        yield _stop(rng, log_uniform(rng, 0.05, 1.5))
        angle += rng.choice([0.0, np.pi, rng.uniform(0, 2 * np.pi)])
    yield _lift(rng)


def _rest_near_limit(rng: np.random.Generator, left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 1.0))
    t, used = _time(left_s), rng.uniform(0.3, _NEAREST)
    rise_s = log_uniform(rng, 0.02, 4.0)
    load = np.ones_like(t)
    if rng.random() < 0.5:
        wave = np.sin(2 * np.pi * log_uniform(rng, 0.1, 3.0) * t) * smooth(t, rise_s, 1.0)
        steps = sum(rng.uniform(-1, 1) * smooth(t, at, 0.2) for at in rng.uniform(rise_s, left_s, 3))
        load += 0.1 * rng.uniform() * (wave if rng.random() < 0.5 else np.clip(steps, -1, 1))
    load = np.maximum(load, used / _SWAYED)
    yield Piece("shear", load, used * _ramp(rng, t, 0.0, rise_s), rng.uniform(0, 2 * np.pi))


def _steps(rng: np.random.Generator, _left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 1.0))
    parts = rng.uniform(0.3, 1.0, rng.integers(2, 6))
    end = _SLIDES if rng.random() < 0.25 else rng.uniform(0.2, _NEAREST)
    t = _time(sum(rests := rng.uniform(0.4, 2.0, len(parts))))
    starts = np.cumsum(rests) - rests
    shear = sum(
        part * _ramp(rng, t, start, min(log_uniform(rng, 0.02, 1.0), rest))
        for part, start, rest in zip(parts * end / parts.sum(), starts, rests, strict=True)
    )
    yield from _follow(
        np.asarray(shear), np.ones_like(t), rng.uniform(0, 2 * np.pi), log_uniform(rng, 0.3, 30.0)
    )
    yield _lift(rng)


def _ease(rng: np.random.Generator, _left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 1.0))
    used, rise_s, rest_s, falls_s = (
        rng.uniform(0.15, 0.7), rng.uniform(0.1, 1.0), rng.uniform(0.3, 1.5), log_uniform(rng, 0.2, 5.0)
    )  # fmt: skip
    t = _time(rise_s + rest_s + falls_s + rng.uniform(0.3, 2.0))
    end = _SLIDES if rng.random() < 0.35 else rng.uniform(used, _NEAREST)
    load = 1 - (1 - used / end) * _ramp(rng, t, rise_s + rest_s, falls_s)
    yield Piece(
        "shear",
        load,
        used * _ramp(rng, t, 0.0, rise_s),
        rng.uniform(0, 2 * np.pi),
        log_uniform(rng, 0.3, 30.0),
    )
    yield _lift(rng, float(load[-1]))


def _swing(rng: np.random.Generator, left_s: float) -> Iterator[Piece]:
    yield _press(rng)
    yield _hold(rng.uniform(0.2, 1.0))
    t, used, middle = _time(max(left_s - 2.0, 3.0)), rng.uniform(0.1, _NEAREST), rng.uniform(0.0, 0.7)
    wave = np.sin(2 * np.pi * log_uniform(rng, 0.3, 5.0) * t)
    shear = used * (middle + (1 - middle) * wave) * smooth(t, 0.0, rng.uniform(0.2, 1.5))
    yield from _follow(shear, np.ones_like(t), rng.uniform(0, 2 * np.pi))
    yield _lift(rng)


def _slanted(rng: np.random.Generator, _left_s: float) -> Iterator[Piece]:
    """Press and lift; shear is in proportion to the load from the touch on."""
    rise_s, fall_s, hold_s = (log_uniform(rng, 0.05, 2.0) for _ in range(3))
    t = _time(rise_s + hold_s + fall_s)
    load = _ramp(rng, t, 0.0, rise_s) * (1 - _ramp(rng, t, rise_s + hold_s, fall_s))
    slant = max(rng.uniform(-0.2, 0.9), 0.0)
    yield Piece("shear", load, slant * load, rng.uniform(0, 2 * np.pi))


HANDS: Mapping[str, Callable[[np.random.Generator, float], Iterator[Piece]]] = {
    "stroke": _stroke,
    "strokes": _strokes,
    "rest-near-limit": _rest_near_limit,
    "steps": _steps,
    "ease": _ease,
    "swing": _swing,
    "press": _slanted,
    "grooves": _stroke,
}
"""Touches by name of the hand; each takes about so much time as is left, in s."""

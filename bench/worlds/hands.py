"""Courses of load, pull, twist and acceleration that hands make, in units of the contact.

A course is a row of rounds: the hand comes, touches, does what it is named for, and lets go. Pull is in parts
of what the contact bears at its usual load, so that the same hand is near the limit on any surface.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tactiled.array import FloatArray

STEP_S = 0.002  # of integration, of all generators but "laws"
KEEP = 2  # steps of integration for each that is kept
GRAVITY = 9.81
_UNSEEN = 0.15  # share of worlds whose log begins in contact


@dataclass(frozen=True)
class Course:
    """Courses of a hand, by step of integration."""

    load: FloatArray  # (n,): in parts of the usual load
    # (n,): force in parts of what the contact bears at the usual load; a hand that moves by position makes it
    # travel, in parts of the elastic travel to the limit
    pull: FloatArray
    travel_mm: FloatArray  # (n,): way of a hand that holds the object by a spring
    turn: FloatArray  # (n,): moment in parts of pull times the radius of the contact
    friction: FloatArray  # (n,): part of friction that is left
    # (n,): as the hand announces it, along the pull and with the part of gravity; NaN where it is not
    # announced
    acceleration_m_s2: FloatArray
    spring: float = 0.0  # stiffness of the hand's hold in parts of that of the skin
    carries: bool = False  # the object hangs between two fingers; nothing else holds it

    def __len__(self) -> int:
        return len(self.load)


@dataclass(frozen=True)
class HandPlan:
    """Course of a world, and the time at its beginning that its log does not see."""

    course: Course
    unseen_s: float

    @property
    def logged(self) -> slice:
        """Kept steps that the log sees."""
        return slice(round(self.unseen_s / (STEP_S * KEEP)), len(self.course) // KEEP)


def side_by_side(plans: Sequence[HandPlan], name: str) -> FloatArray:
    """Series (steps, plans) of one name, each held at its end until the longest is over."""
    series = [getattr(plan.course, name) for plan in plans]
    longest = max(map(len, series))
    return np.stack([np.pad(one, (0, longest - len(one)), mode="edge") for one in series], axis=1)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> np.float64:
    """Draw a number whose logarithm is uniform; of 64 bits, also times arrays of 32."""
    return np.float64(np.exp(rng.uniform(np.log(low), np.log(high))))


def smooth(t: FloatArray, start: float, length: float) -> FloatArray:
    """Minimum-jerk course from 0 to 1."""
    s = np.clip((t - start) / length, 0.0, 1.0)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


def bump(t: FloatArray, at: float, width: float) -> FloatArray:
    """Gaussian of height 1."""
    return np.asarray(np.exp(-0.5 * ((t - at) / width) ** 2))


def plan(rng: np.random.Generator, hand: str, duration_s: float) -> HandPlan:
    """Draw the course of a hand over a world; some logs begin in the first hold."""
    rounds: list[Course] = []
    # What a hold gives way by is pull that it loses, so one that is to stay near the limit is soft.
    spring = 0.01 if hand == "near-limit" else log_uniform(rng, 0.01, 0.15)
    unseen_s = rng.uniform(1.6, 3.0) if rng.random() < _UNSEEN else 0.0
    left_s = duration_s + unseen_s
    announces = rng.random() < 0.5
    while left_s > STEP_S:
        course = ROUNDS[hand](rng, left_s)
        if not announces and not course.carries:
            course = replace(course, acceleration_m_s2=np.full(len(course), np.nan))
        rounds.append(course)
        left_s -= len(course) * STEP_S
    steps = round((duration_s + unseen_s) / STEP_S)
    series = {
        f.name: np.concatenate([getattr(one, f.name) for one in rounds])[:steps]
        for f in fields(Course)
        if f.name not in ("spring", "carries")
    }
    held = rounds[0]
    spring = held.spring or spring * (not held.carries)
    return HandPlan(Course(**series, spring=spring, carries=held.carries), unseen_s)


def _time(length_s: float) -> FloatArray:
    return np.arange(max(round(length_s / STEP_S), 1), dtype=np.float64) * STEP_S


def _course(t: FloatArray, load: FloatArray, **given: FloatArray) -> Course:
    """Course with nothing but a load, and what is given."""
    zero = np.zeros_like(t)
    return replace(Course(load, zero, zero, zero, zero + 1, zero), **given)  # type: ignore[arg-type]


def _tremor(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Slow random walk (n,) of a hand, 0 to 1.5 %, zero at both ends."""
    course: FloatArray = np.cumsum(rng.normal(size=len(t)))
    course = course - np.linspace(0, course[-1], len(t))
    return np.asarray(rng.uniform(0, 0.015) * course / max(float(np.abs(course).max()), 1.0))


def _touch(rng: np.random.Generator, t: FloatArray) -> tuple[FloatArray, float, float]:
    """Load (n,) of one round, the time from which it is whole, and the time at which it begins to go."""
    start, rise = rng.uniform(0.3, 1.5), log_uniform(rng, 0.06, 0.6)
    fall = log_uniform(rng, 0.05, 0.5)
    end = max(t[-1] - rng.uniform(0.2, 0.8) - fall, start + rise + 0.1)
    over = rng.uniform(0.0, 0.15) * (rng.random() < 0.4)  # a controller that overshoots
    load = smooth(t, start, rise) * (1 + over * np.exp(-np.maximum(t - start - rise, 0) / 0.15))
    load = load * (1 - smooth(t, end, fall)) * (1 + _tremor(rng, t))
    return load, start + rise, end


def _rest_before(rng: np.random.Generator, end: float, *series: FloatArray) -> list[FloatArray]:
    """Let series go back to zero before the load goes, as most hands do."""
    back = max(int((end - rng.uniform(0.05, 0.4)) / STEP_S), 1)
    length = rng.uniform(0.05, 0.4)
    out = []
    for one in series:
        t = _time(len(one) * STEP_S)
        left = 1 - smooth(t, back * STEP_S - length, length)
        out.append(np.asarray(one * left))
    return out


def _length(rng: np.random.Generator, left_s: float, low: float, high: float) -> float:
    """Length of a round; what would be left over as a stump is added to it."""
    length = rng.uniform(low, high)
    return length if left_s - length > low else max(left_s, 6.0)


def _pull(rng: np.random.Generator, left_s: float, slow: bool) -> Course:
    t = _time(_length(rng, left_s, 8.0, 20.0))
    load, whole, end = _touch(rng, t)
    rate = np.exp(rng.uniform(np.log(0.05), np.log(0.5)) if slow else rng.uniform(np.log(1.0), np.log(40.0)))
    begin, size = whole + rng.uniform(0.2, 2.0), rng.uniform(0.3, 1.6)
    pull = size * smooth(t, begin, size / rate)
    again = begin + size / rate + rng.uniform(0.5, 3.0)  # some more, or a part back
    pull = pull + rng.uniform(-size, 1.6 - size) * smooth(t, again, rng.uniform(0.1, 2.0))
    turn = rng.uniform(-0.3, 0.3) * pull
    pull, turn = _rest_before(rng, end, pull, turn)
    return _course(t, load, pull=pull + 0.3 * _tremor(rng, t), turn=turn)


def _twist(rng: np.random.Generator, left_s: float) -> Course:
    course = _pull(rng, left_s, rng.random() < 0.5)
    return replace(course, turn=course.pull * rng.uniform(0.5, 1.0), pull=course.pull * rng.uniform(0.0, 0.6))


def _held(
    rng: np.random.Generator, left_s: float, low: float, high: float
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    """Time, load and a pull that is held, with the times from which and until which it is."""
    t = _time(_length(rng, left_s, 10.0, 25.0))
    load, whole, end = _touch(rng, t)
    begin, rise = whole + rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.5)
    (pull,) = _rest_before(rng, end, smooth(t, begin, rise) * rng.uniform(low, high))
    return t, load, pull + 0.3 * _tremor(rng, t), (begin + rise, end - 1.0)


def _ease(rng: np.random.Generator, left_s: float) -> Course:
    t, load, pull, (since, until) = _held(rng, left_s, 0.2, 0.7)
    held, at = float(pull.max()), rng.uniform(since, max(until - 3.0, since + 0.1))
    left = min(held / rng.uniform(0.75, 1.5), 0.95)
    eased = smooth(t, at, rng.uniform(0.1, 3.0)) * (1 - smooth(t, at + rng.uniform(1.0, 4.0), 0.3))
    return _course(t, load * (1 - (1 - left) * eased), pull=pull)


def _falling_friction(rng: np.random.Generator, left_s: float) -> Course:
    t, load, pull, (since, until) = _held(rng, left_s, 0.2, 0.7)
    held, at = float(pull.max()), rng.uniform(since, max(until - 3.0, since + 0.1))
    left = min(held / rng.uniform(0.75, 1.5), 1.0)
    falls = smooth(t, at, rng.uniform(0.3, 4.0)) * (1 - smooth(t, at + rng.uniform(4.0, 6.0), 1.0))
    return _course(t, load, pull=pull, friction=1 - (1 - left) * falls)


def _fill(rng: np.random.Generator, left_s: float) -> Course:
    t, load, pull, (since, until) = _held(rng, left_s, 0.15, 0.5)
    more = rng.uniform(0.1, 1.2) * np.clip((t - since) / max(until - since, 1.0), 0, 1)
    pour = 1 + 0.05 * rng.uniform() * np.sin(2 * np.pi * rng.uniform(4, 15) * t)
    gone = t > until + 0.3
    whole = np.where(gone, pull, pull + more * pour)
    return _course(t, load, pull=whole * (1 - smooth(t, until, 0.3)))


def _tap(rng: np.random.Generator, left_s: float) -> Course:
    t, load, pull, (since, until) = _held(rng, left_s, 0.2, 0.7)
    for at in rng.uniform(since, max(until, since + 0.1), rng.integers(1, 6)):
        size, width = rng.uniform(-0.4, 0.4), rng.uniform(0.005, 0.03)
        pull = pull + size * bump(t, at, width)
        load = load * (1 + rng.uniform(-0.3, 0.3) * bump(t, at, width))
    return _course(t, load, pull=pull)


def _sway(rng: np.random.Generator, left_s: float) -> Course:
    t, load, pull, (since, until) = _held(rng, left_s, 0.25, 0.6)
    held = float(pull.max())
    swing = rng.uniform(0.1, 1.2) * np.sin(2 * np.pi * rng.uniform(0.4, 2.5) * (t - since))
    swing = swing * smooth(t, since, 1.0) * (1 - smooth(t, until - 1.0, 1.0))
    load = load * (1 + rng.uniform(0, 0.1) * np.sin(2 * np.pi * rng.uniform(0.4, 2.5) * t))
    return _course(t, load, pull=pull + held * swing, acceleration_m_s2=GRAVITY * (1 + swing))


def _reverse(rng: np.random.Generator, left_s: float) -> Course:
    t = _time(_length(rng, left_s, 8.0, 20.0))
    load, whole, end = _touch(rng, t)
    size, period = rng.uniform(0.3, 1.5), rng.uniform(1.0, 6.0)
    phase = np.maximum(t - whole - 0.3, 0.0) / period
    pull = size * np.clip(1.3 * np.sin(2 * np.pi * phase), -1, 1)
    (pull,) = _rest_before(rng, end, pull)
    return _course(t, load, pull=pull)


def _rest(rng: np.random.Generator, left_s: float, low: float, high: float) -> Course:
    t = _time(left_s)  # to the end: a shear that is left when the load goes would slide
    start, rise = rng.uniform(0.3, 1.5), rng.uniform(0.1, 0.6)
    begin = start + rise + rng.uniform(0.5, 2.0)
    pull = rng.uniform(low, high) * smooth(t, begin, rng.uniform(0.8, 4.0))
    return _course(t, smooth(t, start, rise), pull=pull)


def _low(rng: np.random.Generator, left_s: float) -> Course:
    course = [_sway, _tap, _fill, _reverse][rng.integers(4)](rng, left_s)
    used = float((np.abs(course.pull) / np.maximum(course.load, 0.3)).max())
    return replace(course, pull=course.pull * min(rng.uniform(0.15, 0.42) / used, 1.0))


def _slide(rng: np.random.Generator, left_s: float, low: float, high: float) -> Course:
    t = _time(_length(rng, left_s, 30.0, 70.0))
    load, whole, end = _touch(rng, t)
    speed = log_uniform(rng, low, high)
    begin = whole + rng.uniform(0.5, 6.0)
    stops = begin + rng.uniform(0.3, 1.0) * max(end - begin, 1.0)
    ramp = rng.uniform(0.05, 1.0)
    course = speed * smooth(t, begin, ramp) * (1 - smooth(t, stops, ramp))
    return replace(_course(t, load, travel_mm=np.cumsum(course) * STEP_S), spring=rng.uniform(0.7, 3.0))


def _slanted(rng: np.random.Generator, left_s: float) -> Course:
    """Press whose pull is in proportion to the load from the touch on."""
    t = _time(_length(rng, left_s, 3.0, 8.0))
    load, _, _ = _touch(rng, t)
    return _course(t, load, pull=max(rng.uniform(-0.2, 0.9), 0.0) * load)


def _carry(rng: np.random.Generator, left_s: float) -> Course:
    """Grasp, lift, transport with accelerations, set down, release; sometimes something goes wrong."""
    t = _time(_length(rng, left_s, 14.0, 40.0))
    load, whole, end = _touch(rng, t)
    lift = whole + rng.uniform(0.3, 1.2)
    down = max(end - rng.uniform(0.3, 1.2), lift + 3.0)
    lifted = smooth(t, lift, rng.uniform(0.1, 0.5)) * (1 - smooth(t, down - 0.4, rng.uniform(0.1, 0.4)))
    moves = np.zeros_like(t)
    for at in rng.uniform(lift + 0.3, down - 0.5, rng.integers(2, 8)):
        length, size = rng.uniform(0.2, 0.8), rng.normal(0, 1.5)  # m/s2: speeds up, then slows down
        moves += size * (bump(t, at, length / 4) - bump(t, at + rng.uniform(1, 2) * length, length / 4))
    sway = rng.uniform(0, 1.5) * (rng.random() < 0.5)
    moves += (
        sway
        * np.sin(2 * np.pi * rng.uniform(0.5, 2.0) * t)
        * smooth(t, lift, 2)
        * (1 - smooth(t, down - 2, 1))
    )
    gravity = np.ones_like(t)
    if rng.random() < 0.3:  # the hand turns the object, and back
        turns = smooth(t, lift + 1, rng.uniform(0.5, 1.5)) * (
            1 - smooth(t, down - 2.0, rng.uniform(0.5, 1.0))
        )
        gravity = 1 - rng.uniform(0.1, 1.1) * turns
    weight = rng.uniform(0.25, 0.65)
    load = load * _controller(rng, t, whole)
    friction = np.ones_like(t)
    if rng.random() < 0.55:
        at, much = rng.uniform(lift + 1.0, down - 1.0), rng.uniform(0.8, 1.5)
        back = at + rng.uniform(0.3, 2.5)
        wrong = smooth(t, at, rng.uniform(0.05, 1.5)) * (1 - smooth(t, max(back, at + 0.1), 0.2))
        part = max(1 - weight / much, 0.0)
        kind = rng.integers(3)
        if kind == 0:
            load = load * (1 - part * wrong)
        elif kind == 1:
            friction = 1 - part * smooth(t, at, rng.uniform(0.3, 3.0))
        else:
            moves += GRAVITY * (much / weight - 1) * bump(t, at, rng.uniform(0.02, 0.15))
    announced = GRAVITY * gravity + moves
    pull = weight * lifted * announced / GRAVITY
    turn = rng.uniform(-0.2, 0.2) * pull
    return replace(
        _course(t, load, pull=pull, turn=turn, friction=friction, acceleration_m_s2=announced), carries=True
    )


def _controller(rng: np.random.Generator, t: FloatArray, whole: float) -> FloatArray:
    """Factor (n,) of a load whose controller steps and creeps."""
    factor = 1 - rng.uniform(0, 0.03) * np.log1p(np.maximum(t - whole, 0))
    for at in rng.uniform(whole, t[-1], rng.poisson(len(t) * STEP_S / 8)):
        factor = factor + rng.normal(0, 0.06) * smooth(t, at, rng.uniform(0.01, 0.15))
    return np.maximum(factor, 0.7)


ROUNDS: Mapping[str, Callable[[np.random.Generator, float], Course]] = {
    "carry": _carry,
    "slow-pull": lambda rng, left_s: _pull(rng, left_s, slow=True),
    "fast-pull": lambda rng, left_s: _pull(rng, left_s, slow=False),
    "twist": _twist,
    "ease": _ease,
    "falling-friction": _falling_friction,
    "fill": _fill,
    "tap": _tap,
    "sway": _sway,
    "reverse": _reverse,
    "near-limit": lambda rng, left_s: _rest(rng, left_s, 0.8, 0.94),
    "rest": lambda rng, left_s: _rest(rng, left_s, 0.0, 0.6),
    "low": _low,
    "slanted": _slanted,
    "slide": lambda rng, left_s: _slide(rng, left_s, 2.0, 30.0),
    "creep": lambda rng, left_s: _slide(rng, left_s, 0.2, 2.0),
}
"""Rounds by name of the hand; each takes the time that is left, in s."""

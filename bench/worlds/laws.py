"""Random worlds: contact law, materials, sensor, electronics and hand are all drawn.

None of it is shared with `tactiled.emulator` or with the contact model under test. An object of some
mass is moved over nine taxels by a hand through a spring; each taxel answers with one of five friction laws:

mindlin
    Parallel elements with Mindlin's curve, in 24 pieces.
iwan
    The same with another exponent of the curve, 1.2 to 3 instead of 3/2.
dahl
    ``dF = k (d - |d| F / limit)``: never reaches its limit by a corner.
lugre
    Dahl with a limit that falls with speed (Stribeck) during the approach too.
dahl-2
    Dahl's general law ``dF = k (d - |d| (F / limit)^2)``, which stays stiff for longer. Nothing was set on
    worlds of this law.

Equations of motion are integrated at 2 ms with semi-implicit steps, for all worlds of a batch at once. A
gross slip begins where all taxels together bear 0.985 of their limits (`GROSS_AT`; laws without a corner only
approach 1), and ends when the object has stopped.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from bench.worlds.arrays import places_mm, square_array
from bench.worlds.hands import log_uniform, smooth
from bench.worlds.sensors import channels
from bench.worlds.world import World, onsets, tenths_s
from tactiled.array import FloatArray
from tactiled.samples.block import regular_block

LAWS = ("mindlin", "iwan", "dahl", "lugre")
HELD_OUT_LAW = "dahl-2"
HANDS = (
    "pull", "pull", "drag", "drag", "twist", "ease", "ease", "falling-friction", "fill",
    "lift", "sway", "tap", "hum", "drift", "rest",
)  # fmt: skip
RATES_HZ = (50.0, 100.0, 100.0, 100.0, 100.0, 250.0)
GROSS_AT = 0.985
_SIDE = 3  # taxels along each side of the array
_STEP_S = 0.002
_RINGS = 24
_STOPPED_MM_S = 0.5
_TOUCHING = 0.05  # of the full load
_TOUCH_S = 0.3
_SURFACE = 256  # places of a surface, after which it repeats
_WHOLE = 1e-6  # of a step of integration: between whole steps, readings are interpolated


@dataclass(frozen=True)
class Population:
    """Distribution that worlds are drawn from."""

    laws: tuple[str, ...] = LAWS
    hands: tuple[str, ...] = HANDS
    duration_s: float = 8.0
    # pulls that would use more of the limit are scaled to a part of it, drawn from 0.3 to 1
    most_used: float | None = None


USUAL = Population()


def draw_worlds(seeds: range, population: Population = USUAL) -> list[World]:
    """Simulate a batch of worlds; all that a population leaves open is drawn from the seed."""
    drawn = [_draw(seed, population) for seed in seeds]
    return [_measured(v, *parts) for v, parts in zip(drawn, _simulate(drawn), strict=True)]


def _draw(seed: int, population: Population) -> dict[str, Any]:
    """Everything about one world but its time series."""
    rng = np.random.default_rng([14, seed])
    law, hand = str(rng.choice(population.laws)), str(rng.choice(population.hands))
    duration_s = population.duration_s
    v: dict[str, Any] = {"seed": seed, "law": law, "hand": hand, "duration_s": duration_s, "rng": rng}
    pitch = rng.uniform(3.0, 4.5)
    x, y = places_mm(_SIDE, pitch)
    v["x"], v["y"] = x, y
    n = len(x)
    dome = np.maximum(1.0 - rng.uniform(0.0, 0.6) * (x**2 + y**2) / (2 * pitch**2), 0.1)
    tilt = 1.0 + rng.normal(0, 0.15) * x / pitch + rng.normal(0, 0.15) * y / pitch
    part = dome * np.maximum(tilt, 0.1) * rng.lognormal(0, 0.15, n)
    v["part"] = part / part.sum()
    load = rng.lognormal(np.log(3.0), 0.6)
    v["load_n"] = load
    mu = float(np.clip(rng.lognormal(np.log(0.6), 0.45), 0.15, 1.8))
    v["mu"] = mu
    v["mu_taxel"] = mu * rng.lognormal(0, rng.uniform(0.0, 0.1), n)
    v["kinetic"] = rng.uniform(0.7, 1.0)
    # Friction differs from place to place of the surface, by taxel and travel; a quarter of them are even.
    v["rough"] = max(rng.uniform(-0.02, 0.06), 0.0)
    v["rough_mm"] = log_uniform(rng, 0.1, 1.0)
    v["surface"] = rng.normal(size=(len(x), _SURFACE))
    v["stribeck_mm_s"] = rng.uniform(1.0, 8.0)
    v["power"] = 1.5 if law == "mindlin" else rng.uniform(1.2, 3.0)
    travel_mm = log_uniform(rng, 0.1, 1.0)
    stiffness = v["power"] * mu * load / travel_mm
    shares = v["part"] ** rng.uniform(0.0, 0.5) * rng.lognormal(0, rng.uniform(0.0, 0.15), n)
    v["stiffness"] = stiffness * shares / shares.sum()
    v["exponent"] = rng.uniform(0.0, 0.5)
    v["hand_n_mm"] = min(log_uniform(rng, 0.02, 3.0), stiffness)
    if hand == "drag":
        v["hand_n_mm"] = stiffness * rng.uniform(0.5, 2.0)
    frequency = rng.uniform(15.0, 40.0) * 2 * np.pi
    v["mass"] = (stiffness + v["hand_n_mm"]) / frequency**2
    damping_ratio = rng.uniform(0.4, 0.9)
    v["damping"] = 2 * damping_ratio * v["mass"] * frequency
    v["hand_damping"] = 2 * damping_ratio * np.sqrt(v["hand_n_mm"] * v["mass"])
    _plan_hand(v, hand, rng, duration_s, population.most_used)
    return v


def _ramp(t: FloatArray, start: float, length: float) -> FloatArray:
    return np.clip((t - start) / length, 0.0, 1.0)


def _plan_hand(
    v: dict[str, Any], hand: str, rng: np.random.Generator, duration_s: float, most_used: float | None
) -> None:
    """Courses of load, pull, moment and friction, at the steps of integration."""
    t = np.arange(round(duration_s / _STEP_S), dtype=np.float64) * np.float64(_STEP_S)
    capacity = v["mu"] * v["load_n"]
    touch = rng.uniform(0.25, 0.45)
    load = smooth(t, _TOUCH_S, touch)
    pull, turn, friction = np.zeros_like(t), np.zeros_like(t), np.ones_like(t)
    begin = rng.uniform(1.3, 2.5)
    rate = log_uniform(rng, 0.2, 50.0)  # N/s
    size = rng.uniform(0.2, 1.8)
    length = float(np.clip(size * capacity / rate, 0.02, duration_s))
    shape = smooth if rng.random() < 0.5 else _ramp
    if hand in ("pull", "drag", "twist"):
        pull = size * shape(t, begin, length)
        if rng.random() < 0.5:  # and back, at some time
            pull = pull * (1 - smooth(t, begin + length + rng.uniform(0.3, 2.0), rng.uniform(0.2, 1.0)))
        if hand == "drag":
            pull = 2 * pull  # in travel: the force follows a curve that flattens
        if hand == "twist":
            turn = pull * rng.uniform(0.8, 1.2)
            pull = pull * rng.uniform(0.0, 0.5)
    elif hand == "rest":
        pull = rng.uniform(0.2, 0.92) * shape(t, begin, length)
    else:
        held = rng.uniform(0.15, 0.7)
        pull = held * smooth(t, begin, rng.uniform(0.2, 0.8))
    late = rng.uniform(3.5, 5.0)
    if hand == "ease":
        left = held * rng.uniform(0.5, 1.5)
        load = load * (1 - (1 - min(left, 0.95)) * shape(t, late, rng.uniform(0.2, 3.0)))
    elif hand == "falling-friction":
        left = held * rng.uniform(0.6, 1.4)
        friction = 1 - (1 - min(left, 1.0)) * smooth(t, late, rng.uniform(0.5, 3.0))
    elif hand == "fill":
        pull = pull + rng.uniform(0.1, 1.0) * _ramp(t, late - 1.5, rng.uniform(2.0, 5.0))
    elif hand in ("sway", "lift"):
        swing = held * rng.uniform(0.05, 0.6)
        pull = pull + swing * np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * (t - begin)) * smooth(t, begin, 1.0)
        load = load * (1 + rng.uniform(0, 0.15) * np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * t))
    elif hand == "tap":
        # One to five in the 5 s of a usual world, as often in longer ones.
        for at in rng.uniform(2.5, duration_s - 0.5, round(rng.integers(1, 6) * (duration_s - 3.0) / 5.0)):
            width = rng.uniform(0.005, 0.03)
            pull = pull + held * rng.uniform(-1, 1) * np.exp(-0.5 * ((t - at) / width) ** 2)
    elif hand == "hum":
        pull = pull * (1 + rng.uniform(0.02, 0.3) * np.sin(2 * np.pi * rng.uniform(20, 120) * t))
    elif hand == "drift":
        pull = pull * (1 + rng.uniform(-0.5, 0.5) * t / duration_s)
        load = load * (1 + rng.uniform(-0.2, 0.2) * t / duration_s)
    course: FloatArray = np.cumsum(rng.normal(size=len(t)))  # tremor: a slow random walk, of 1 % of the load
    course = (course - np.linspace(0, course[-1], len(t))) / max(float(np.abs(course).max()), 1.0)
    pull = pull + rng.uniform(0, 0.02) * course
    if most_used is not None:
        used = float((np.abs(pull) / np.maximum(load, 0.05)).max())
        pull = pull * min(1.0, most_used * rng.uniform(0.3, 1.0) / used)
    v["load"] = v["load_n"] * load
    v["pull"] = (
        capacity * pull * (1 + v["hand_n_mm"] / float(v["stiffness"].sum()))
    )  # the spring takes its part
    v["turn"] = capacity * turn * float(np.hypot(v["x"], v["y"]).mean())
    v["mu_course"] = friction
    v["angle"] = rng.uniform(0, 2 * np.pi)


def _simulate(drawn: list[dict[str, Any]]) -> list[tuple[FloatArray, ...]]:
    """Integrate all worlds; loads (n, T), shears (n, 2, T), utilisation, speed and limit (n,) of each."""

    def stack(name: str) -> FloatArray:
        return np.array([v[name] for v in drawn])

    n_steps = round(drawn[0]["duration_s"] / _STEP_S)
    x, y, part = stack("x"), stack("y"), stack("part")
    load, pull, turn, course = stack("load"), stack("pull"), stack("turn"), stack("mu_course")
    angle, mass, damping, hand = stack("angle"), stack("mass"), stack("damping"), stack("hand_n_mm")
    mu_taxel, kinetic, stribeck = stack("mu_taxel"), stack("kinetic"), stack("stribeck_mm_s")
    stiffness, exponent, full = stack("stiffness"), stack("exponent"), stack("load_n")
    laws = stack("law")
    ringed = np.flatnonzero(np.isin(laws, ["mindlin", "iwan"]))
    smooth = np.flatnonzero(np.isin(laws, ["dahl", "lugre", HELD_OUT_LAW]))
    kappa, phi = _curve(stack("power")[ringed])
    n, taxels = x.shape
    rough, rough_mm, surface = stack("rough"), stack("rough_mm"), stack("surface")
    worlds, travel = np.arange(n), np.zeros(n)
    rings = np.zeros((2, len(ringed), taxels, _RINGS))
    force = np.zeros((2, n, taxels))
    inertia = mass * np.hypot(x, y).mean(axis=1) ** 2
    hand_damping, held = stack("hand_damping"), np.ones_like(x)
    place, velocity = np.zeros((3, n)), np.zeros((3, n))
    out_load, out_shear = np.zeros((n_steps, n, taxels)), np.zeros((n_steps, n, 2, taxels))
    out_u, out_speed, out_limit = (np.zeros((n_steps, n)) for _ in range(3))
    along = np.stack([np.cos(angle), np.sin(angle)])
    hand_turn = hand * np.hypot(x, y).mean(axis=1) ** 2
    for k in range(n_steps):
        loads = load[:, k, np.newaxis] * part
        speed = np.hypot(velocity[0], velocity[1]) + np.abs(velocity[2]) * np.hypot(x, y).mean(axis=1)
        falls = kinetic + (1 - kinetic) * np.exp(-speed / stribeck)
        borne = np.where(laws == "lugre", falls, np.where(out_u[k - 1] > GROSS_AT - 0.05, falls, 1.0))
        travel += speed * _STEP_S / rough_mm
        cell = travel.astype(int)
        here, there = (surface[worlds, :, c % _SURFACE] for c in (cell, cell + 1))
        uneven = 1 + rough[:, None] * (here + (there - here) * (travel - cell)[:, None])
        static = mu_taxel * loads * course[:, k, np.newaxis] * np.maximum(uneven, 0.1)
        limit = static * borne[:, np.newaxis]
        step = velocity * _STEP_S
        d = np.stack([step[0, :, None] - step[2, :, None] * y, step[1, :, None] + step[2, :, None] * x])
        stiff = stiffness * (np.maximum(load[:, k], 1e-6) / full)[:, None] ** exponent[:, None]
        rings += (stiff[ringed, :, None] * kappa[:, None, :]) * d[:, ringed, :, None]
        size = np.sqrt(rings[0] ** 2 + rings[1] ** 2)
        np.divide(limit[ringed, :, None] * phi[:, None, :], np.maximum(size, 1e-12), out=size)
        held[ringed] = (kappa[:, None, :] * (size > 1.0)).sum(axis=2)
        rings *= np.minimum(1.0, size)
        force[:, ringed] = rings.sum(axis=3)
        kd, limits = stiff[smooth] * d[:, smooth], np.maximum(limit[smooth], 1e-9)
        # The exponent of F / limit is 1, for the general law 2.
        used = np.where(laws[smooth] == HELD_OUT_LAW, 0.0, 1.0)[:, np.newaxis]
        used = used + (1 - used) * np.minimum(np.hypot(*force[:, smooth]) / limits, 1.0)
        dahl = (force[:, smooth] + kd) / (1.0 + used * np.hypot(kd[0], kd[1]) / limits)
        part_used = np.hypot(dahl[0], dahl[1]) / limits
        force[:, smooth] = dahl / np.maximum(1.0, part_used)
        held[smooth] = np.maximum(1.0 - used * part_used, 0.0)
        total = force.sum(axis=2)
        moment = (x * force[1] - y * force[0]).sum(axis=1)
        away = place[:2]
        applied = pull[:, k] * along - hand * away
        velocity[:2] += _STEP_S * (applied - total) / mass
        velocity[2] += _STEP_S * (turn[:, k] - hand_turn * place[2] - moment) / inertia
        # Rubber damps where it sticks; an object that slides is held back by friction and the hand alone.
        sticks = (stiff * held).sum(axis=1) / np.maximum(stiff.sum(axis=1), 1e-12)
        velocity /= 1.0 + _STEP_S * np.maximum((damping * sticks + hand_damping) / mass, 1.0)
        place += _STEP_S * velocity
        out_load[k], out_shear[k] = loads, force.transpose(1, 0, 2)
        out_u[k] = np.sqrt((force**2).sum(axis=0)).sum(axis=1) / np.maximum(limit.sum(axis=1), 1e-9)
        out_u[k] *= load[:, k] > _TOUCHING * full
        out_speed[k], out_limit[k] = speed, limit.sum(axis=1)
    found = (out_load, out_shear, out_u, out_speed, out_limit)
    return [tuple(series[:, b] for series in found) for b in range(n)]


def _curve(power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rings of the curve ``1 - (1 - x)^power``: shares of stiffness and of limit (worlds, rings)."""
    t = np.linspace(0, 1, _RINGS + 1)
    x = 1 - (1 - t) ** 1.5
    slope = np.diff(1 - (1 - x) ** power[:, None], axis=1) / np.diff(x)
    drop = slope - np.concatenate([slope[:, 1:], np.zeros((len(power), 1))], axis=1)
    return drop / power[:, None], drop * x[1:]


def _measured(
    v: dict[str, Any],
    load: FloatArray,
    shear: FloatArray,
    utilisation: FloatArray,
    speed: FloatArray,
    limit: FloatArray,
) -> World:
    """Readings of a drawn sensor, and the truth at its scans."""
    rng: np.random.Generator = v["rng"]
    gross = _gross(utilisation, speed)
    n_taxels, whole, pressed = len(v["x"]), shear.sum(axis=2).T, load.sum(axis=1)
    touching = pressed > _TOUCHING * v["load_n"]
    # Crosstalk: part of the neighbours, shear of a press, load of a shear.
    mix = np.exp(-((v["x"][:, None] - v["x"]) ** 2 + (v["y"][:, None] - v["y"]) ** 2) / 8.0)
    np.fill_diagonal(mix, 0.0)
    mix = np.eye(n_taxels) + rng.uniform(0, 0.5) * mix
    mix /= mix.sum(axis=1, keepdims=True)
    load, shear = load @ mix.T, shear @ mix.T
    own_load = load
    spread = rng.uniform(0.02, 0.12)
    load = load * rng.lognormal(0, spread, n_taxels) + rng.normal(0, 0.03) * shear[:, 0]
    stray = rng.normal(0, rng.uniform(0.01, 0.06), (2, n_taxels))
    relative = rng.lognormal(0, 0.2)
    shear = relative * shear * rng.lognormal(0, spread, (2, n_taxels)) + own_load[:, np.newaxis] * stray
    volts_per_n = rng.uniform(0.7, 1.8) / (v["load_n"] / n_taxels)
    kind = rng.choice(["xyz", "sides"])
    volts = channels(kind, load, shear) * volts_per_n
    bend = rng.uniform(0.0, 0.15)
    volts = volts / (1 + bend * np.abs(volts))
    creep = rng.uniform(0, 0.04)
    t = np.arange(len(volts)) * _STEP_S
    volts = volts * (1 + creep * np.log1p(np.maximum(t - _TOUCH_S, 0) / 0.3))[:, None]
    rate_hz = float(rng.choice(RATES_HZ))
    at = np.arange(0, v["duration_s"], 1 / rate_hz) / _STEP_S  # in steps of integration
    at = at[at < len(volts) - 1 + _WHOLE]
    picks = np.floor(at + _WHOLE).astype(int)
    part = np.where(at - picks > _WHOLE, at - picks, 0.0)[:, np.newaxis]
    noise_mv = log_uniform(rng, 0.1, 6.0)
    volts = volts[picks] + part * (volts[np.minimum(picks + 1, len(volts) - 1)] - volts[picks])
    white = rng.normal(size=volts.shape)
    colour = rng.uniform(0, 0.9)
    red = np.zeros_like(white)
    red[1:] = lfilter([0.2], [1.0, -0.98], rng.normal(size=(len(red) - 1, volts.shape[1])), axis=0)
    volts = volts + 1e-3 * noise_mv * (white + 0.5 * colour * red)
    lsb = float(rng.choice([0.0001, 0.0008, 0.0024]))
    volts = np.round(volts / lsb) * lsb
    gross_steps = onsets(gross)
    # Friction as the sensor reads it: shear over load at the limit.
    borne = relative * float(np.mean(v["mu_taxel"]))
    friction = np.where(touching, relative * limit / np.maximum(pressed, 1e-9), np.nan)
    return World(
        generator="laws",
        seed=v["seed"],
        hand=v["hand"],
        rate_hz=rate_hz,
        array=square_array(kind, _SIDE, 3.7),
        block=regular_block(volts, rate_hz),
        utilisation=utilisation[picks],
        gross=gross[picks],
        gross_s=[float(g) * _STEP_S for g in gross_steps],
        tenth_s=tenths_s(utilisation, gross_steps, _STEP_S),
        direction_deg=np.degrees(np.arctan2(-whole[1], -whole[0]))[picks],
        friction=friction[picks],
        static_friction=borne,
        load=pressed[picks],
        touching=touching[picks],
        acceleration_m_s2=np.full(len(picks), np.nan),
    )


def _gross(utilisation: FloatArray, speed: FloatArray) -> NDArray[np.bool_]:
    gross = np.zeros(len(utilisation), dtype=np.bool_)
    is_gross = False
    for k, (u, s) in enumerate(zip(utilisation.tolist(), speed.tolist(), strict=True)):
        is_gross = u >= GROSS_AT or (is_gross and s > _STOPPED_MM_S)
        gross[k] = is_gross
    return gross

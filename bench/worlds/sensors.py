"""Readings of a drawn sensor from the forces on its taxels, and the truth at its scans."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from bench.worlds.arrays import square_array
from bench.worlds.hands import log_uniform
from bench.worlds.world import World, onsets, tenths_s
from tactiled.array import FloatArray
from tactiled.samples.block import regular_block

RATES_HZ = (30.0, 60.0, 100.0, 100.0, 100.0, 200.0, 250.0)
KINDS = ("counts", "pillars", "sides")
_FILES: dict[str, dict[str, Any]] = {
    "counts": {"kind": "xyz", "unit": "count", "range": (-32768.0, 32767.0)},
    "pillars": {"kind": "xyz", "unit": "N", "range": (-10.0, 10.0)},
    "sides": {"kind": "sides", "unit": "V", "range": (-8.0, 8.0)},
}
_NOISE, _IDEAL_NOISE = (3e-4, 1e-2), (5e-5, 1e-3)  # of the usual reading
_BATCH = 24  # scenes that are simulated at once
_MOST = 0.8  # of the range, so that usual loads never saturate
_GROSS_S = 0.02  # a contact that slides for a shorter time did not slide
_STICK_S = 0.04  # and one that rests for a shorter time went on
_CREEP_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # a power law of time as a sum of exponentials
# Part of the worlds in which the noise grows at some time, as beside a motor that starts; by what at most.
_LOUDER, _MOST_LOUDER = 0.15, 30.0


@dataclass(frozen=True, eq=False)
class Forces:
    """Courses of the physics, at even steps."""

    step_s: float
    load: FloatArray  # (n, taxels): N
    shear: FloatArray  # (n, 2, taxels): force of the object on the skin, against its motion, N
    utilisation: FloatArray  # (n,)
    slides: NDArray[np.bool_]  # (n,): all loaded places are at their limit, and the object moves
    limit: FloatArray  # (n,): shear that the contact bears, N
    touching: NDArray[np.bool_]  # (n,)
    acceleration_m_s2: FloatArray  # (n,)
    # usual_n, static_friction: usual load of all taxels, N, and shear over load that it bears before it slips
    usual_n: float
    static_friction: float
    creep: float = 0.0  # part by which readings grow under a constant load, in 100 s


@dataclass(frozen=True)
class Drawn:
    """Names of a world, and the generator of its random numbers."""

    generator: str
    hand: str
    seed: int
    side: int
    pitch_mm: float
    rng: np.random.Generator
    # the sensor has no crosstalk, tilt, spread of gains, curvature or drift, and little noise
    is_ideal: bool = False

    @property
    def faults(self) -> float:
        """Part of the usual faults that the sensor has."""
        return 0.0 if self.is_ideal else 1.0


def measure_together(scenes: Sequence[Any], simulate: Callable[[Any], Sequence[Forces]]) -> list[World]:
    """Simulate scenes in batches of one size of the array, and measure each by its `Drawn`."""
    found: dict[int, World] = {}
    for side in {scene.drawn.side for scene in scenes}:
        some = [scene for scene in scenes if scene.drawn.side == side]
        for first in range(0, len(some), _BATCH):
            batch = some[first : first + _BATCH]
            for scene, forces in zip(batch, simulate(batch), strict=True):
                found[scene.drawn.seed] = measure(scene.drawn, forces)
    return [found[scene.drawn.seed] for scene in scenes]


def measure(drawn: Drawn, forces: Forces) -> World:
    """Draw a sensor and read the forces with it."""
    rng = drawn.rng
    kind = str(rng.choice(KINDS))
    ratio = rng.lognormal(0, 0.15)  # reading of shear over that of load, where the forces are equal
    array = square_array(side=drawn.side, pitch_mm=round(drawn.pitch_mm, 2), **_FILES[kind])
    taxel = forces.usual_n / array.n_taxels
    gain = {
        # a taxel with its part of the load reads an eighth of the range, and uneven ones up to all of it
        "counts": array.high * rng.uniform(0.04, 0.12) / taxel,
        "pillars": rng.lognormal(0, 0.1),
        "sides": array.high * rng.uniform(0.04, 0.12) / taxel,
    }[kind]
    felt = channels(kind, *_felt(rng, forces, drawn, ratio))
    largest = max(float(np.abs(felt).max()), 1e-12)
    gain = min(gain, _MOST * array.high / largest)
    readings = gain * felt
    readings = readings / (1 + drawn.faults * rng.uniform(0.0, 0.12) * np.abs(felt) / largest)
    readings = _crept(readings, forces.creep, forces.step_s)
    rate_hz = float(rng.choice(RATES_HZ))
    skewed = kind == "sides" or rng.random() < 0.3
    share = rng.uniform(0.2, 0.9) if skewed else 0.0  # of the scan's time
    offset_s = share / rate_hz * np.arange(array.n_channels) / array.n_channels
    time_s = np.arange(0.0, (len(readings) - 1) * forces.step_s - 1 / rate_hz, 1 / rate_hz)
    grid_s = np.arange(len(readings)) * forces.step_s
    sampled = np.stack(
        [np.interp(time_s + offset, grid_s, one) for offset, one in zip(offset_s, readings.T, strict=True)],
        axis=1,
    )
    noise = gain * taxel * log_uniform(rng, *_IDEAL_NOISE if drawn.is_ideal else _NOISE)
    noisy = sampled + _noise(rng, sampled.shape, noise, rate_hz)
    sampled = noisy + gain * taxel * drawn.faults * _drift(rng, time_s, sampled)
    lsb = {"counts": 1.0, "pillars": 0.001, "sides": 0.0008}[kind]
    sampled = np.round(sampled / lsb) * lsb
    at = np.minimum(np.round(time_s / forces.step_s).astype(int), len(grid_s) - 1)
    gross = runs(runs(forces.slides, _GROSS_S / forces.step_s), _STICK_S / forces.step_s, of=False)
    # By definition: within a slide, places that ridges unload for a moment keep it just below.
    used = np.where(gross & forces.slides, 1.0, forces.utilisation)
    begins = onsets(gross)
    whole = forces.shear.sum(axis=2)[at]
    with np.errstate(invalid="ignore", divide="ignore"):
        friction = np.where(forces.touching, ratio * forces.limit / forces.load.sum(axis=1), np.nan)
    return World(
        generator=drawn.generator,
        hand=drawn.hand,
        seed=drawn.seed,
        rate_hz=rate_hz,
        array=array,
        block=regular_block(sampled, rate_hz, channel_offset_s=offset_s),
        utilisation=used[at].astype(np.float64),
        gross=gross[at],
        gross_s=[float(g) * forces.step_s for g in begins],
        tenth_s=tenths_s(used, begins, forces.step_s),
        direction_deg=np.degrees(np.arctan2(-whole[:, 1], -whole[:, 0])),
        friction=friction[at],
        static_friction=ratio * forces.static_friction,
        load=forces.load.sum(axis=1)[at].astype(np.float64),
        touching=forces.touching[at],
        acceleration_m_s2=forces.acceleration_m_s2[at].astype(np.float64),
    )


def runs(flags: NDArray[np.bool_], shortest: float, *, of: bool = True) -> NDArray[np.bool_]:
    """Return flags (n,) without runs of a value that are shorter than so many steps; ends count as other."""
    edges = np.flatnonzero(np.diff(np.concatenate([[not of], flags, [not of]]).astype(int)))
    found = flags.copy()
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first < shortest and (of or (first > 0 and last < len(flags))):
            found[first:last] = not of
    return found


def _felt(
    rng: np.random.Generator, forces: Forces, drawn: Drawn, ratio: float
) -> tuple[FloatArray, FloatArray]:
    """Load (n, taxels) and shear (n, 2, taxels) as taxels feel them, in N."""
    load, shear = forces.load.astype(np.float64), forces.shear.astype(np.float64)
    n = load.shape[1]
    places = np.arange(drawn.side, dtype=np.float64)
    x, y = (a.ravel() for a in np.meshgrid(places, places))
    mix = np.exp(-((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2))
    np.fill_diagonal(mix, 0.0)
    mix = np.eye(n) + drawn.faults * rng.uniform(0, 0.4) * mix
    mix /= mix.sum(axis=1, keepdims=True)
    load, shear = mixed(load, mix), mixed(shear, mix)
    tilt = drawn.faults * np.tan(np.radians(rng.uniform(0.0, 3.0)))  # of the pad in its mount
    towards = rng.uniform(0.0, 2 * np.pi)
    lean = tilt * np.array([np.cos(towards), np.sin(towards)])
    stray = lean[:, np.newaxis] + drawn.faults * rng.normal(0, rng.uniform(0.0, 0.05), (2, n)) / 2
    felt = (
        load
        - lean[0] * shear[:, 0]
        - lean[1] * shear[:, 1]
        + drawn.faults * rng.normal(0, 0.02) * shear[:, 0]
    )
    shear = ratio * shear + load[:, np.newaxis] * stray
    spread = drawn.faults * rng.uniform(0.0, 0.08)
    return felt * rng.lognormal(0, spread, n), shear * rng.lognormal(0, spread, (2, n))


def mixed(forces: NDArray[np.floating[Any]], mix: FloatArray) -> FloatArray:
    """Share forces (..., places) among taxels by a matrix (taxels, places), summed in one order always."""
    return np.stack([(forces * row).sum(axis=-1) for row in mix], axis=-1)


def channels(kind: str, load: FloatArray, shear: FloatArray) -> FloatArray:
    """Channels (n, channels) before their gain."""
    if kind != "sides":
        return np.stack([-shear[:, 0], -shear[:, 1], load], axis=2).reshape(len(load), -1)
    half = shear / 2
    sides = [load - half[:, 0], load - half[:, 1], load + half[:, 0], load + half[:, 1]]
    return np.maximum(np.stack(sides, axis=2), 0.0).reshape(len(load), -1)


def _crept(readings: FloatArray, creep: float, step_s: float) -> FloatArray:
    if not creep:
        return readings
    weights = np.array(_CREEP_S) ** 0.2  # flatter than a logarithm of time by little
    crept = readings.copy()
    for weight, tau_s in zip(weights / weights.sum(), _CREEP_S, strict=True):
        decay = np.exp(-step_s / tau_s)
        crept += creep * weight * lfilter([1 - decay], [1, -decay], readings, axis=0)
    return crept


def _noise(rng: np.random.Generator, shape: tuple[int, ...], sd: float, rate_hz: float) -> FloatArray:
    """White noise, and some that changes within about half a second."""
    white, slow = rng.normal(size=shape), rng.normal(size=shape)
    keep = np.exp(-2.0 / rate_hz)
    red = lfilter([np.sqrt(1 - keep**2)], [1, -keep], slow, axis=0)
    noise = sd * (white + rng.uniform(0, 0.5) * red)
    if rng.random() < _LOUDER:
        noise[int(rng.uniform(0.2, 0.9) * shape[0]) :] *= np.exp(rng.uniform(0.0, np.log(_MOST_LOUDER)))
    return np.asarray(noise)


def _drift(rng: np.random.Generator, time_s: FloatArray, like: FloatArray) -> FloatArray:
    """Slow drift of each channel, in parts of the usual reading: up to 2 % in a few minutes."""
    size, phase = rng.normal(0, rng.uniform(0, 0.01), like.shape[1]), rng.uniform(0, 2 * np.pi, like.shape[1])
    turn = 2 * np.pi / rng.uniform(60.0, 400.0)
    return np.asarray(size * (np.sin(turn * time_s[:, np.newaxis] + phase) - np.sin(phase)))

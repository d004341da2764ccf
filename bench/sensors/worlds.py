"""Recordings of emulated worlds that look like those of sensors that are not ours.

The emulator plays the mechanics of a scene: load, shear, motion of the skin, and which part of the contact
slips. The sensor is drawn at random: places that the array file does not give, unequal gains, creep, drift,
noise, rounding, stamps that jitter. The surface is drawn at random too: it is rough (a sum of plane waves of
random direction, 0.4 to 4 mm long), and ridges are uneven. Shear moves the centre of load by its moment
about the pad.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactiled import tomlfile
from tactiled.array import Array, ArrayFile, build
from tactiled.emulator.scene import families
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact

FloatArray = NDArray[np.float64]
World = Literal[
    "ridges", "ridges from the first scan on", "rough", "smooth", "tug", "jerk", "hold", "taps",
    "grip changes", "motor hum", "cable tug", "load and back", "persistent contact",
]  # fmt: skip
_JITTER = 0.1  # of the scan period, standard deviation of a stamp
_PIECE_SCANS = 64  # played at once: well within what a contact model keeps
_WAVES = 60  # plane waves of a rough surface
_GROSS = 0.9  # share of the contact that slips
_LEAST_MM_S = 0.1  # slower is creep
_QUIET = {
    "taps": families.QUIET["taps"],
    "grip changes": families.QUIET["grip-changes"],
    "motor hum": families.QUIET["motor-hum"],
    "cable tug": families.QUIET["cable-tug"],
    "load and back": families.QUIET["load-and-back"],
    "persistent contact": families.QUIET["persistent-contact"],
}
_XYZ = ["shear_x", "shear_y", "normal"]


@dataclass(frozen=True)
class Skin:
    """Kind of sensor whose worlds are played.

    Attributes
    ----------
    array : mapping
        Array file, as a user writes it.
    pitch_mm : float
        Distance of the taxels of a pad, about.
    full_n : float
        Load on all taxels that takes a channel to half of its range.
    noise : float
        Standard deviation of the noise, in the unit of the array.
    """

    name: str
    rate_hz: float
    array: dict[str, Any]
    pads: int
    pitch_mm: float
    full_n: float
    noise: float


def _file(unit: str, low: float, high: float, taxels: int, kinds: list[str], **more: Any) -> dict[str, Any]:
    channels = [{"name": kind, "kind": kind} for kind in kinds]
    return {
        "name": "skin",
        "unit": unit,
        "range": [low, high],
        "zero": "first 0.3 s",
        "taxel_count": taxels,
        "taxel_channels": channels,
        **more,
    }


FINGERTIP = Skin(
    "16 normal taxels, counts, 35.6 Hz", 35.6, _file("count", 0, 4095, 16, ["normal"]), 1, 4.0, 15.0, 2.0
)
PADS = Skin(
    "2 pads of 4x4 x/y/z, counts, 59.7 Hz", 59.7, _file("count", 0, 65535, 32, _XYZ), 2, 5.0, 15.0, 12.0
)
MAGNETS = Skin("2 pads of 5 x/y/z, uT, 100 Hz", 100.0, _file("uT", -5000, 5000, 10, _XYZ), 2, 7.0, 40.0, 1.0)
SHEAR = Skin(
    "shear alone, 4 taxels x/y, N, 100 Hz", 100.0, _file("N", -10, 10, 4, _XYZ[:2]), 1, 6.0, 40.0, 0.004
)
CELL = Skin("one load cell, N, 300 Hz", 300.0, _file("N", 0, 50, 1, ["normal"]), 1, 1.0, 25.0, 0.004)
SKINS = (FINGERTIP, PADS, MAGNETS, SHEAR, CELL)


@dataclass(frozen=True, eq=False)
class Played:
    """Recording with its truth.

    Attributes
    ----------
    slides : tuple of (start_s, end_s)
        Times at which all of the contact slips and moves.
    loads_s : tuple of float
        Instants at which a tug begins.
    speed_mm_s : float
        Of a slide at constant speed; 0 for others.
    ripple_hz : float
        0 without ridges.
    """

    time_s: FloatArray
    readings: FloatArray
    slides: tuple[tuple[float, float], ...]
    loads_s: tuple[float, ...]
    speed_mm_s: float
    ripple_hz: float

    def spans(self) -> list[tuple[float, float]]:
        """Times of slides, and of tugs from the beginning of the load to the end of the recording."""
        end_s = float(self.time_s[-1])
        return [(start_s, end_s) for start_s in self.loads_s] or [s for s in self.slides if s[1] - s[0] > 0.3]


def play(skin: Skin, world: World, seed: int) -> Played:
    """Play a world on a skin."""
    rng = np.random.default_rng([seed, *world.encode(), skin.array.get("taxel_count", 1)])
    scene, start_s, speed_mm_s = _scene(rng, world, seed)
    array = build(tomlfile.parse(skin.array, ArrayFile, skin.name))
    x_mm, y_mm, pad = _places(rng, skin, array.n_taxels)
    placed = _placed(array, x_mm, y_mm)
    contact = make_contact(SceneMotion(scene), placed)
    assert isinstance(contact, PhysicalContact)
    time_s = np.arange(0.0, scene.duration_s - 0.05, 1 / skin.rate_hz)
    parts = [contact.state(time_s[n : n + _PIECE_SCANS]) for n in range(0, len(time_s), _PIECE_SCANS)]
    normal = np.concatenate([part.normal_n for part in parts])
    shear = np.concatenate([part.tangential_n for part in parts])
    travel = np.concatenate([part.travel_mm for part in parts])
    velocity = np.concatenate([part.velocity_mm_s for part in parts])
    share = np.concatenate([part.slipping_share for part in parts])
    moves = np.linalg.norm(velocity, axis=1) > _LEAST_MM_S
    is_sliding = (share > _GROSS) & moves
    relief, ripple_hz = _relief(rng, world, travel, x_mm, y_mm, speed_mm_s)
    whole = shear.sum(axis=1)
    # The shear acts at the surface, and its moment about the middle loads one side of the pad.
    lever = rng.uniform(0.0, 2.0) / max(1.0, skin.pitch_mm**2 * array.n_taxels)
    normal = np.maximum(normal + lever * (whole @ np.stack([x_mm, y_mm])), 0.0) * (1 + relief)
    shear = shear * (1 + 0.5 * relief[..., np.newaxis])
    load = {"normal": normal, "shear_x": -shear[..., 0], "shear_y": -shear[..., 1]}
    per_taxel = np.stack([load[str(c["kind"])] for c in skin.array["taxel_channels"]], axis=-1)
    if skin is MAGNETS:  # each axis of the field answers to each axis of the load; signs are of the print
        mixing = np.eye(3) * rng.choice([-1.0, 1.0], (1, 3, 1)) + 0.3 * rng.standard_normal(
            (array.n_taxels, 3, 3)
        )
        per_taxel = np.einsum("ntk,tjk->ntj", per_taxel, mixing)
    elif len(per_taxel[0, 0]) == 3 and skin.pads == 2:  # the second pad looks at the first
        per_taxel[:, pad == 1, 0] *= -1
    force = per_taxel.reshape(len(time_s), -1)
    readings = _readings(rng, skin, array, force)
    kept = time_s >= start_s
    stamps = 50.0 + time_s + _JITTER / skin.rate_hz * rng.standard_normal(len(time_s)).clip(-3, 3)
    return Played(
        stamps[kept],
        readings[kept],
        tuple((50.0 + max(a, start_s), 50.0 + b) for a, b in _spans(time_s, is_sliding) if b > start_s),
        tuple(50.0 + d.start_s for d in scene.disturbances) if world in ("tug", "jerk") else (),
        speed_mm_s,
        ripple_hz,
    )


def _placed(array: Array, x_mm: FloatArray, y_mm: FloatArray) -> Array:
    values = {**vars(array), "x_mm": x_mm, "y_mm": y_mm, "has_places": True}
    return Array(**values)


def _places(rng: np.random.Generator, skin: Skin, n: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    each = n // skin.pads
    side = int(np.ceil(np.sqrt(each)))
    index = np.arange(n) % each
    pad = np.arange(n) // each
    spread = 0.1 * skin.pitch_mm * rng.standard_normal((2, n))
    x = skin.pitch_mm * (index % side) + spread[0]
    y = skin.pitch_mm * (index // side) + spread[1]
    return x - x.mean(), y - y.mean(), pad


def _scene(rng: np.random.Generator, world: World, seed: int) -> tuple[Scene, float, float]:
    """Scene, beginning of the recording in it, and the speed of its slide."""
    if world in _QUIET:
        return _QUIET[world](seed), 0.0, 0.0
    press: dict[str, Any] = {
        "kind": "press",
        "duration_s": rng.uniform(0.3, 1.2),
        "force_n": rng.uniform(4.0, 20.0),
    }
    friction = rng.uniform(0.3, 0.9)
    document: dict[str, Any] = {
        "name": f"{world}-{seed}",
        "contact": "auto",
        "needs": ["gross-slip", "transients"],
        "tolerance": 0.15,
        "seed": seed,
        "surface": {"kind": "flat", "friction": friction},
        "phases": [press],
    }
    if world in ("tug", "jerk", "hold"):
        limit_n = friction * press["force_n"]
        document["held_object"] = {"mass_kg": float(np.exp(rng.uniform(np.log(0.1), np.log(0.5))))}
        document["phases"] += [
            {"kind": "load", "duration_s": 0.5, "tangential_n": 0.1 * limit_n, "direction_deg": 90.0},
            {"kind": "hold", "duration_s": 7.0},
        ]
        pull: dict[str, Any] = {"on": "pull_n", "direction_deg": float(rng.uniform(-180, 180))}
        begin_s = press["duration_s"] + rng.uniform(2.5, 4.0)
        if world == "tug":
            pull |= {"shape": "ramp", "amplitude": rng.uniform(0.8, 2.0) * limit_n}
            pull |= {"start_s": begin_s, "duration_s": rng.uniform(0.5, 2.0)}
        if world == "jerk":
            pull |= {"shape": "pulse", "amplitude": rng.uniform(1.3, 2.5) * limit_n}
            pull |= {"start_s": begin_s, "duration_s": rng.uniform(0.15, 0.4)}
        document["disturbances"] = [] if world == "hold" else [pull]
        return Scene.model_validate(document), press["duration_s"] * rng.choice([0.0, 1.0]), 0.0
    hold_s = rng.uniform(0.5, 2.5)
    speed_mm_s = float(np.exp(rng.uniform(np.log(4), np.log(30))))
    slide = {"kind": "slide", "duration_s": rng.uniform(4, 8), "speed_mm_s": speed_mm_s, "ramp_s": 0.1}
    slide["direction_deg"] = float(rng.uniform(-180, 180))
    rest = {"kind": "hold", "duration_s": 1.5}
    document["phases"] = [
        {"kind": "rest", "duration_s": 0.5},
        press,
        {"kind": "hold", "duration_s": hold_s},
        slide,
    ]
    document["phases"] += [rest]
    start_s = 0.0
    if world == "ridges from the first scan on":
        start_s = 0.5 + press["duration_s"] + hold_s + 0.5
    return Scene.model_validate(document), start_s, speed_mm_s


def _relief(
    rng: np.random.Generator,
    world: World,
    travel: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    speed_mm_s: float,
) -> tuple[FloatArray, float]:
    """Relative load (n, taxels) that the surface adds under each taxel, and the frequency of its ridges."""
    part = float(np.exp(rng.uniform(np.log(0.01), np.log(0.04))))  # of the load, rough
    if world == "smooth":
        part = 0.002
    px = travel[:, :1] + x_mm
    py = travel[:, 1:] + y_mm
    relief = np.zeros(px.shape)
    for _ in range(_WAVES):
        k = 2 * np.pi / np.exp(rng.uniform(np.log(0.4), np.log(4.0)))
        turn = rng.uniform(0, 2 * np.pi)
        relief += np.cos(k * (px * np.cos(turn) + py * np.sin(turn)) + rng.uniform(0, 2 * np.pi))
    relief *= part * np.sqrt(2 / _WAVES)
    if not world.startswith("ridges"):
        return relief, 0.0
    period_mm = float(np.exp(rng.uniform(np.log(1.5), np.log(6.0))))
    moving = np.gradient(travel, axis=0).sum(axis=0)
    heading = np.arctan2(moving[1], moving[0]) + np.radians(rng.uniform(-30, 30))
    way = (px * np.cos(heading) + py * np.sin(heading)) / period_mm
    heights = 1 + 0.25 * rng.standard_normal(2000)
    ridge = heights[np.floor(way).astype(np.int64) % 2000] * np.maximum(np.cos(2 * np.pi * way), -0.3)
    size = float(np.exp(rng.uniform(np.log(0.02), np.log(0.15))))
    speed_across = speed_mm_s * np.cos(heading - np.arctan2(moving[1], moving[0]))
    return relief + size * ridge, float(abs(speed_across) / period_mm)


def _readings(rng: np.random.Generator, skin: Skin, array: Array, force: FloatArray) -> FloatArray:
    """Readings of forces (n, channels): unequal gains, creep, drift, noise, rounding, limits."""
    n, channels = force.shape
    low, high = array.low, array.high
    each_n = skin.full_n / (array.n_taxels / skin.pads)
    gains = 0.5 * (high - low) / 2 / each_n * rng.uniform(0.6, 1.4, channels)
    lag_s = rng.uniform(1.0, 6.0)
    crept = np.zeros(channels)
    slow = np.empty_like(force)
    keep = np.exp(-1 / skin.rate_hz / lag_s)
    for row in range(n):
        crept = keep * crept + (1 - keep) * force[row]
        slow[row] = crept
    felt = force + rng.uniform(0.02, 0.1) * slow
    drift = rng.standard_normal((n, channels)).cumsum(axis=0) * skin.noise * 0.03
    # A grip of people or arms is never still: tremor, shared by all channels.
    tremor = _tremor(rng, n, skin.rate_hz) * rng.uniform(0.0, 0.004)
    offsets = low + (high - low) * rng.uniform(0.05, 0.15, channels)
    if low < 0:
        offsets = 0.1 * (high - low) * rng.uniform(-1, 1, channels)
    values = (
        offsets
        + gains * felt * (1 + tremor[:, np.newaxis])
        + drift
        + skin.noise * rng.standard_normal((n, channels))
    )
    step = {"count": 1.0, "uT": 0.15, "N": 0.001}[array.unit]
    return np.asarray(np.clip(np.rint(values / step) * step, low, high))


def _tremor(rng: np.random.Generator, n: int, rate_hz: float) -> FloatArray:
    """Noise around 1 Hz and around 9 Hz, standard deviation 1."""
    frequency = np.fft.rfftfreq(n, 1 / rate_hz)
    shape = 1 / (1 + frequency**2) + 0.3 * np.exp(-0.5 * ((frequency - 9) / 1.5) ** 2)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * shape, n)
    return np.asarray(noise / noise.std())


def _spans(time_s: FloatArray, is_on: NDArray[np.bool_]) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_on, [False]]).astype(np.int8)))
    spans = [(float(time_s[a]), float(time_s[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    merged: list[tuple[float, float]] = []
    for a, b in spans:
        if merged and a - merged[-1][1] < 0.2:
            merged[-1] = (merged[-1][0], b)
        else:
            merged.append((a, b))
    return merged

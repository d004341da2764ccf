"""Worlds of strokes: a rigid surface without mass on taxels that follow it by a curve; nothing is integrated.

The shear of a taxel is a part of its limit: a vector s in the unit disc. While the surface travels by w in
the direction d, ``s = d + (s0 - d) (1 - f(w / (|s0 - d| L)))`` from the s0 at which it set off. L is the
elastic travel. So f is the curve of a fresh contact, a reversal is twice as wide (Masing's rule), and s never
leaves the disc. Loads may be equal, friction may differ from taxel to taxel and along the surface, and a
quarter of the sensors have no faults but noise: idealised touches that the other generators never draw.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.worlds.arrays import places_mm
from bench.worlds.bristles import AT_LIMIT, MOVES_MM_S, TOUCHING
from bench.worlds.hands import log_uniform
from bench.worlds.sensors import Drawn, Forces, measure
from bench.worlds.stroke_hands import STEP_S, Piece, draw_pieces
from bench.worlds.world import World
from tactiled.array import FloatArray

HANDS = (
    *("stroke",) * 4, *("strokes",) * 3, *("grooves",) * 2, *("steps",) * 3, *("ease",) * 3,
    *("rest-near-limit",) * 6, *("swing",) * 4, *("press",) * 4,
)  # fmt: skip
LAWS = ("mindlin", "exponential", "ramp")
_TREMOR = 0.008  # of the load, at most
_IDEAL = 0.25  # share of sensors
_LEAST_WAVE_MM = 0.3  # a taxel averages what is shorter
_TAXEL_N = (0.45, 2.0)  # usual load; under less, pillars of 50 N show no contact
_GRID = np.linspace(0.0, 1.0, 400)
_NONE = 1e-9


@dataclass(frozen=True, eq=False)
class _Contact:
    """Contact of one world, by taxel."""

    x: FloatArray
    y: FloatArray
    usual_n: float
    # share, mu, elastic_mm (taxels,): share of the load, static friction, and travel of a fresh contact to
    # its limit
    share: FloatArray
    mu: FloatArray
    elastic_mm: FloatArray
    curve: Callable[[FloatArray], FloatArray]
    whole: float
    # wave_mm, phase (waves, taxels): wavelengths and phases of friction along the surface
    wave_mm: FloatArray
    phase: FloatArray
    rough: float  # standard deviation of friction along the surface, over its mean
    evened: bool  # friction of all taxels together is the same along the surface
    kinetic: float
    falls_mm: float
    heals_s: float
    ridges: float
    ridge_mm: float
    ridge_angle: float

    @property
    def grows_mm(self) -> float:
        """Travel over which unevenness grows to its full size."""
        return float(self.elastic_mm.mean())

    def roughness(self, path_mm: FloatArray) -> FloatArray:
        """Factor (n, taxels) of friction after some travel (n,)."""
        waves = np.sin(2 * np.pi * path_mm[:, None, None] / self.wave_mm + self.phase).sum(axis=1)
        waves *= np.sqrt(2 / len(self.wave_mm))
        if self.evened:
            waves -= waves.mean(axis=1, keepdims=True)
        grown = np.clip(path_mm / self.grows_mm, 0, 1)[:, None]
        return np.asarray(np.maximum(1 + self.rough * grown * waves, 0.2))

    def rippled(self, path_mm: FloatArray, place_mm: FloatArray) -> FloatArray:
        """Factor (n, taxels) of load over grooves, for places (n, 2) of the surface."""
        across = self.x[None] - place_mm[:, :1], self.y[None] - place_mm[:, 1:]
        phase = across[0] * np.cos(self.ridge_angle) + across[1] * np.sin(self.ridge_angle)
        grown = np.clip(path_mm / self.grows_mm, 0, 1)[:, None]
        return np.asarray(1 + self.ridges * grown * np.cos(2 * np.pi * phase / self.ridge_mm))


def draw_worlds(seeds: range, minutes: float, hands: tuple[str, ...] = HANDS) -> list[World]:
    """Compute worlds of so many minutes; all else is drawn from each seed."""
    return [_world(seed, minutes, hands or HANDS) for seed in seeds]


def _world(seed: int, minutes: float, hands: tuple[str, ...]) -> World:
    rng = np.random.default_rng([47, seed])
    hand, law = str(rng.choice(hands)), str(rng.choice(LAWS))
    side, pitch = int(rng.choice([2, 3, 3, 3, 3, 4, 4])), rng.uniform(3.0, 4.5)
    contact = _draw(rng, law, hand == "grooves", side, pitch)
    pieces = draw_pieces(rng, hand, 60 * minutes)
    drawn = Drawn("strokes", hand, seed, side, pitch, rng, is_ideal=rng.random() < _IDEAL)
    creep = 0.0 if drawn.is_ideal else max(rng.uniform(-0.04, 0.06), 0.0)
    tremor = np.cumsum(rng.normal(size=sum(map(len, pieces))))
    tremor *= max(rng.uniform(-_TREMOR, _TREMOR), 0.0) / np.abs(tremor).max()
    return measure(drawn, _play(contact, pieces, 1 + tremor, creep, round(60 * minutes / STEP_S)))


def _draw(rng: np.random.Generator, law: str, grooved: bool, side: int, pitch: float) -> _Contact:
    x, y = places_mm(side, pitch)
    n = len(x)
    unevenness = int(rng.integers(3))  # of the loads: hardly any, some, much
    spread = (rng.uniform(-0.01, 0.03), rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.7))[unevenness]
    share = rng.lognormal(0, max(spread, 0.0), n)
    if unevenness == 2 and rng.random() < 0.5:
        share[rng.permutation(n)[: rng.integers(1, n // 2 + 1)]] *= rng.choice([0.0, 0.02])
    share /= share.sum()
    usual = log_uniform(rng, 0.2, 1.3)
    mu = usual * np.clip(1 + max(rng.uniform(-0.05, 0.12), 0.0) * rng.normal(size=n), 0.5, 1.5)
    # Springs of equal stiffness reach a limit in proportion to their load; those that grow with it, at once.
    elastic = np.maximum(mu * share * n / usual, 0.05) ** rng.uniform(0.0, 1.0)
    elastic *= log_uniform(rng, 0.05, 1.0) * rng.lognormal(0, max(rng.uniform(-0.1, 0.2), 0), n)
    waves = int(rng.integers(1, 4))
    curve, whole = _curve(law, rng.uniform(1.2, 3.0))
    return _Contact(
        x=x,
        y=y,
        usual_n=n * float(np.clip(rng.lognormal(np.log(0.7), 0.5), *_TAXEL_N)),
        share=share,
        mu=mu,
        elastic_mm=elastic,
        curve=curve,
        whole=whole,
        wave_mm=np.maximum(elastic.mean() * np.exp(rng.uniform(0, np.log(40.0), (waves, n))), _LEAST_WAVE_MM),
        phase=rng.uniform(0, 2 * np.pi, (waves, n)),
        rough=0.0 if grooved else max(rng.uniform(-0.125, 0.25), 0.0),
        evened=bool(rng.random() < 0.4),
        kinetic=min(rng.uniform(0.6, 1.1), 1.0),
        falls_mm=log_uniform(rng, 0.02, 0.5),
        heals_s=log_uniform(rng, 0.05, 1.0),
        ridges=rng.uniform(0.02, 0.2) if grooved else 0.0,
        ridge_mm=rng.uniform(0.5, 5.0),
        ridge_angle=rng.uniform(0, np.pi),
    )


def _curve(law: str, power: float) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """Part of the limit after parts of the elastic travel, and the part after which it is all of it."""
    if law == "mindlin":
        return lambda x: 1 - np.maximum(1 - x, 0.0) ** power, 1.0
    if law == "exponential":
        return lambda x: 1 - np.exp(-x), 7.0
    return lambda x: np.minimum(x, 1.0), 1.0


def _play(contact: _Contact, pieces: list[Piece], tremor: FloatArray, creep: float, n_steps: int) -> Forces:
    """Compute piece after piece, each from the shear and the travel at the end of the last one."""
    n = len(contact.x)
    force, limit, fallen, path, place = np.zeros((2, n)), np.zeros((1, n)), 1.0, 0.0, np.zeros(2)
    found: list[tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]] = []
    at = 0
    for piece in pieces:
        relative = piece.load * tremor[at : at + len(piece)]
        at += len(piece)
        along = np.array([np.cos(piece.angle), np.sin(piece.angle)])
        t = STEP_S * np.arange(1, len(piece) + 1)
        used = force / np.maximum(limit[-1], _NONE)
        reach_mm = np.maximum(np.hypot(*(along[:, None] - used)), 1e-6) * contact.elastic_mm
        free_mm = contact.whole * float(reach_mm[contact.share > 0].max())
        way = np.zeros_like(t)
        falls = 1 - (1 - fallen) * np.exp(-t / contact.heals_s)
        if piece.given != "kept":
            way = _way(
                contact, piece, relative, _used(contact, _GRID * free_mm, along, used, reach_mm), free_mm
            )
            beyond = np.maximum(way - free_mm, 0.0)
            falls = contact.kinetic + (fallen - contact.kinetic) * np.exp(-beyond / contact.falls_mm)
        load = contact.usual_n * relative[:, None] * contact.share
        load *= contact.rippled(path + way, place + way[:, None] * along)
        limit = load * contact.mu * contact.roughness(path + way) * falls[:, None]
        if piece.given == "kept":
            most = limit / np.maximum(np.hypot(*force), _NONE)
            shear = np.minimum(piece.course[:, None], most)[:, None] * force
        else:
            shear = _used(contact, way, along, used, reach_mm) * limit[:, None]
        size = np.hypot(shear[:, 0], shear[:, 1])
        slips = (size >= AT_LIMIT * limit).all(axis=1) & (np.diff(way, prepend=0.0) > MOVES_MM_S * STEP_S)
        found.append((load, shear, limit, slips & (relative > TOUCHING)))
        force, fallen, path, place = shear[-1], float(falls[-1]), path + way[-1], place + way[-1] * along
    load, shear, limit, slides = (np.concatenate(parts)[:n_steps] for parts in zip(*found, strict=True))
    touching = load.sum(axis=1) > TOUCHING * contact.usual_n
    borne = limit.sum(axis=1)
    whole = np.hypot(shear[:, 0], shear[:, 1]).sum(axis=1)
    return Forces(
        step_s=STEP_S,
        load=load,
        shear=shear,
        utilisation=np.where(touching, whole / np.maximum(borne, _NONE), 0.0),
        slides=slides,
        limit=borne,
        touching=touching,
        acceleration_m_s2=np.full(n_steps, np.nan),
        usual_n=contact.usual_n,
        static_friction=float((contact.share * contact.mu).sum()),
        creep=creep,
    )


def _used(
    contact: _Contact, way_mm: FloatArray, along: FloatArray, used: FloatArray, reach_mm: FloatArray
) -> FloatArray:
    """Parts of the limits (n, 2, taxels) after travel (n,) from those at its beginning (2, taxels)."""
    left = 1 - contact.curve(way_mm[:, None] / reach_mm)
    return np.asarray(along[:, None] + (used - along[:, None]) * left[:, None])


def _way(
    contact: _Contact, piece: Piece, relative: FloatArray, on_grid: FloatArray, free_mm: float
) -> FloatArray:
    """Travel (n,) that is given, or at which shear is as given; `on_grid` is `_used` at `_GRID * free_mm`."""
    if piece.given == "travel":
        return piece.course
    along = np.cos(piece.angle) * on_grid[:, 0] + np.sin(piece.angle) * on_grid[:, 1]
    bears = contact.share * contact.mu
    borne = (along * bears).sum(axis=1) / bears.sum()
    wanted = piece.course / np.maximum(relative, _NONE)
    way = np.interp(wanted, borne, free_mm * _GRID)
    beyond = np.flatnonzero(wanted >= borne[-1])
    if len(beyond) and piece.slide_mm_s:
        first = int(beyond[0])
        way[first:] = free_mm + piece.slide_mm_s * STEP_S * np.arange(1, len(way) - first + 1)
    return way

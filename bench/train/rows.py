"""Worlds to learn from, and their looks: signs from the program's own front end, beside the truth."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.worlds.generators import GENERATORS, draw
from bench.worlds.world import World
from tactiled.array import FloatArray
from tactiled.detect.contact.fast import Trees
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.contact.learnt import Learnt
from tactiled.detect.contact.posterior import HORIZONS_S
from tactiled.detect.contact.signs import LOOK_S, NAMES
from tactiled.progress import ProgressBar

BATCH = 24  # worlds that are simulated at once


class Lot(NamedTuple):
    """Worlds of each generator, of one length."""

    first_seed: int
    n_worlds: int
    minutes: float

    @property
    def batches(self) -> list[range]:
        """Seeds of the worlds that are simulated at once."""
        seeds = range(self.first_seed, self.first_seed + self.n_worlds)
        return [seeds[at : at + BATCH] for at in range(0, len(seeds), BATCH)]


def lots_in_words(lots: Sequence[Lot]) -> str:
    """Say how many worlds of which length there are, and their seeds."""
    return " and ".join(
        f"{lot.n_worlds} worlds of {60 * lot.minutes:g} s (seeds from {lot.first_seed})" for lot in lots
    )


# Most contacts last seconds; in long ones, what the memory holds is of slides and swings of before.
FULL = (Lot(100_000, 312, 0.2), Lot(110_000, 104, 0.6))
QUICK = (Lot(100_000, 24, 0.2),)
_ACCELERATION = NAMES.index("acceleration")
_RATIO = NAMES.index("ratio")
# Parts of the worlds in which the hand announces its acceleration, or the log begins within a contact: each
# often enough to be learnt, and seldom enough not to be needed.
_ANNOUNCES, _CUT = 0.4, 0.12


@dataclass(frozen=True, eq=False)
class Looks:
    """Looks of one world."""

    generator: str
    look_s: float  # time between looks
    time_s: FloatArray  # (n,)
    signs: FloatArray  # (n, signs)
    begins: NDArray[np.bool_]  # (n,): first look of a contact
    slides: NDArray[np.bool_]  # (n,): truth, as the next three
    utilisation: FloatArray  # (n,)
    ahead_s: FloatArray  # (n,): time to the next beginning of gross slip; infinite without one

    @property
    def ratio(self) -> FloatArray:
        """Ratio of shear and load."""
        return self.signs[:, _RATIO]

    @property
    def soon(self) -> NDArray[np.int64]:
        """Class of the time to gross slip: 0 none, 1, 2 and 3 within the longest to the shortest horizon."""
        return np.asarray(np.sum([self.ahead_s <= horizon_s for horizon_s in HORIZONS_S], axis=0))


def silent() -> Learnt:
    """Return trees that say nothing: looks do not depend on them."""

    def one(n: int) -> Trees:
        empty: dict[str, list[float]] = {key: [] for key in ("root", "output", "links", "value")}
        return Trees({"first": [0.0] * n, **empty})

    return Learnt(one(1), one(9), one(4), 0.0)


def looks_of(world: World) -> Looks:
    """Run the front end over a world and keep each look; announce and cut at random."""
    rng = np.random.default_rng([25, world.seed])
    announces, cuts = rng.random(2) < (_ANNOUNCES, _CUT)
    block, first = world.block, 0
    if cuts and world.touching.any():
        touching = np.flatnonzero(world.touching)
        first = int(touching[int(rng.uniform(0.05, 0.6) * len(touching))])
        block = block[first:]
    detector = GripDetector(world.array, learnt=silent())
    signs, scans, begins = [], [], []
    for scan, _ in enumerate(detector.scans(block)):
        found = detector.contact
        if found is None or not found.is_look:
            continue
        begins.append(found.signs.n == 1)
        signs.append(np.array(found.signs.row))
        scans.append(first + scan)
    at = np.array(scans, dtype=np.int64)
    table = np.array(signs).reshape(len(at), len(NAMES))
    if announces:
        table[:, _ACCELERATION] = world.acceleration_m_s2[at]
    n_look = max(1, round(LOOK_S * world.rate_hz))
    return Looks(
        generator=world.generator,
        look_s=n_look / world.rate_hz,
        time_s=at / world.rate_hz,
        signs=table,
        begins=np.array(begins, dtype=np.bool_),
        slides=world.gross[at],
        utilisation=world.used(at),
        ahead_s=world.ahead_s(at),
    )


def n_batches(lots: Sequence[Lot]) -> int:
    """Return the batches of worlds of all generators."""
    return len(GENERATORS) * sum(len(lot.batches) for lot in lots)


def all_looks(pool: Executor, lots: Sequence[Lot], progress: ProgressBar) -> dict[str, list[Looks]]:
    """Return the looks of the worlds of each generator."""
    jobs = [(name, seeds, lot.minutes) for name in GENERATORS for lot in lots for seeds in lot.batches]
    looks: dict[str, list[Looks]] = {name: [] for name in GENERATORS}
    for (name, *_), found in zip(jobs, pool.map(_looks, jobs), strict=True):
        looks[name] += found
        progress.advance(f"worlds of {name}")
    return looks


def _looks(job: tuple[str, range, float]) -> list[Looks]:
    return [looks for looks in map(looks_of, draw(*job)) if len(looks.signs)]

"""Worlds to learn from, by generator."""

from concurrent.futures import Executor

from bench.train.rows import Looks, looks_of
from bench.worlds.generators import GENERATORS, draw
from tactiled.progress import ProgressBar

TRAINED_FROM = 100_000  # seeds
BATCH = 24  # worlds that are simulated at once
MINUTES = 0.2  # of a world
QUICK_WORLDS, FULL_WORLDS = 24, 312  # of each generator


def n_batches(n_worlds: int) -> int:
    """Return the batches of worlds of all generators."""
    return len(GENERATORS) * -(-n_worlds // BATCH)


def all_looks(pool: Executor, n_worlds: int, progress: ProgressBar) -> dict[str, list[Looks]]:
    """Return the looks of the worlds of each generator."""
    starts = range(TRAINED_FROM, TRAINED_FROM + n_worlds, BATCH)
    jobs = [(name, range(at, at + BATCH), MINUTES) for name in GENERATORS for at in starts]
    looks: dict[str, list[Looks]] = {name: [] for name in GENERATORS}
    for (name, *_), found in zip(jobs, pool.map(_looks, jobs), strict=True):
        looks[name] += found
        progress.advance(f"worlds of {name}")
    return looks


def _looks(job: tuple[str, range, float]) -> list[Looks]:
    return [looks for looks in map(looks_of, draw(*job)) if len(looks.signs)]

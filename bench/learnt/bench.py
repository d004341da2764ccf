"""``./run bench learnt``: what trees read off the taxels, on the generator that they were not trained on.

An upper reference for the contact model: trees are trained on looks of all generators of worlds but one and
scored on that one, beside the model on the same worlds. Where they are better, the signals hold more than the
model finds.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.learnt.filter import learnt_from
from bench.learnt.judge import RECALLS, Course, Score, courses, score
from bench.learnt.rows import Looks, looks_of
from bench.report import BENCH_WORKERS, NONE, BenchOptions, BenchReport, table
from bench.worlds.generators import GENERATORS, draw
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

_TRAINED_FROM, _REPORTED_FROM = 100_000, 200_000  # seeds
_BATCH = 24  # worlds that are simulated at once
_MINUTES = 0.2  # of a world
_TRAINED, _REPORTED = 480, 144  # worlds of each generator
_TRAINED_QUICK, _REPORTED_QUICK = 24, 24


def bench_learnt(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Scores of the contact model and of trees, each generator left out once.

    Quick: 24 worlds of each, from which the trees learn little.
    """
    from bench.learnt.fit import fit  # scikit-learn takes seconds to load

    trained, reported = (_TRAINED_QUICK, _REPORTED_QUICK) if options.quick else (_TRAINED, _REPORTED)
    names = tuple(GENERATORS)
    progress.begin(len(names) * ((trained + reported) // _BATCH + 1))
    looks: dict[str, list[Looks]] = {name: [] for name in names}
    scores: dict[str, tuple[Score, Score]] = {}
    with executor(BENCH_WORKERS, options.dask) as pool:
        jobs = [(name, start) for name in names for start in range(0, trained, _BATCH)]
        for (name, _), found in zip(jobs, pool.map(_looks, jobs), strict=True):
            looks[name] += found
            progress.advance(f"worlds of {name}")
        for name in names:
            learnt = fit([look for other in names if other != name for look in looks[other]])
            progress.advance(f"trees without {name}")
            starts = range(0, reported, _BATCH)
            told = []
            for some in pool.map(_courses, [(name, start, learnt) for start in starts]):
                told += some
                progress.advance(f"scores on {name}")
            scores[name] = score([model for model, _ in told]), score([trees for _, trees in told])
    return BenchReport(
        [
            f"{trained} worlds of {60 * _MINUTES:g} s of each generator to learn from (seeds from "
            f"{_TRAINED_FROM}), {reported} to score on (from {_REPORTED_FROM}). Each row is of a generator "
            "that the trees were not trained on. False gross slips are by hour of contact, at the part of "
            "true ones that is found from 0.1 s before to 0.3 s after they begin.",
            table(
                _row(name, kind, one)
                for name, both in scores.items()
                for kind, one in zip(("model", "trees"), both, strict=True)
            ),
        ],
        numbers=scores,
    )


def _looks(job: tuple[str, int]) -> list[Looks]:
    name, start = job
    seeds = range(_TRAINED_FROM + start, _TRAINED_FROM + start + _BATCH)
    return [looks for looks in map(looks_of, draw(name, seeds, _MINUTES)) if len(looks.signs)]


def _courses(job: tuple[str, int, Mapping[str, Any]]) -> list[tuple[Course, Course]]:
    name, start, table_of_trees = job
    learnt = learnt_from(table_of_trees)
    seeds = range(_REPORTED_FROM + start, _REPORTED_FROM + start + _BATCH)
    found = [courses(world, learnt) for world in draw(name, seeds, _MINUTES)]
    return [both for both in found if len(both[0].at)]


def _row(name: str, kind: str, one: Score) -> dict[str, str]:
    return {
        "left out": name,
        "by": kind,
        "AUC of sliding": f"{one.auc:.3f}",
        "skill of sliding": f"{one.skill_sliding:.2f}",
        "skill at 300 ms": f"{one.skill_300ms:.2f}",
        "u rms": f"{one.used_rms:.3f}",
        "u bias": f"{one.used_bias:+.3f}",
        "u coverage": f"{one.coverage:.2f}",
        "gross while it slides": f"{one.told_gross:.2f}",
        **{f"false at {r:.0%}": _number(one.false_per_h[r]) for r in RECALLS},
        "false below half": f"{one.resting_false_per_h:.0f}",
    }


def _number(value: float) -> str:
    return f"{value:.0f}" if np.isfinite(value) else NONE

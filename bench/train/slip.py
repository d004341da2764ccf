"""``./run train slip``: learn the trees of the contact filter from worlds of all generators."""

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import sklearn

from bench.report import BENCH_WORKERS, commit
from bench.train import rows
from bench.train.fit import QUICK, SHIPPED, Shapes, first_forests, learnt_table, pair_forests
from bench.train.rows import Looks, Lot, all_looks, lots_in_words, n_batches
from bench.worlds.generators import GENERATORS, pairs_of_physics
from tactiled.detect.contact.filter import STATE_SIGNS
from tactiled.detect.contact.learnt import FILE
from tactiled.detect.contact.posterior import EDGES
from tactiled.detect.contact.signs import NAMES
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

ROOT = Path(__file__).resolve().parents[2]


def train_slip(progress: ProgressBar, *, is_quick: bool, to: Path | None) -> Mapping[str, Any]:
    """Train on all generators; write the trees, and beside them the text on what they learnt from.

    Trees of few worlds are quick. Without a path, the shipped file is written. Returns what the text says.
    """
    lots, shapes = (rows.QUICK, QUICK) if is_quick else (rows.FULL, SHIPPED)
    progress.begin(n_batches(lots) + len(pairs_of_physics(GENERATORS)) + 1)
    with executor(BENCH_WORKERS) as pool:
        looks = all_looks(pool, lots, progress)
        worlds = [look for some in looks.values() for look in some]
        first = first_forests(pool, worlds, progress, shapes)
    table = learnt_table(first, pair_forests(worlds, first, shapes=shapes))
    progress.advance("trees of the state")
    command = "./run train slip" + " --quick" * is_quick
    # Before a file that git knows is written over.
    about = {"command": command} | _about(lots, shapes, looks, table)
    path = to or ROOT.joinpath(*FILE)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **table)
    path.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    return about


def _about(
    lots: Sequence[Lot], shapes: Shapes, looks: Mapping[str, Sequence[Looks]], table: Mapping[str, Any]
) -> dict[str, Any]:
    return {
        "commit": commit(),
        "python": platform.python_version(),
        "scikit-learn": sklearn.__version__,
        "worlds_of_each_generator": lots_in_words(lots),
        "learnt_from": {
            name: {
                "contacts": sum(int(w.begins.sum()) for w in some),
                "looks": sum(len(w.signs) for w in some),
                "sliding": round(float(np.mean(np.concatenate([w.slides for w in some]))), 3),
            }
            for name, some in looks.items()
        },
        "tuned": {
            "trees": {name: shape._asdict() for name, shape in shapes._asdict().items()},
            "cells_of_utilisation": EDGES,
        },
        "signs": NAMES,
        "state_signs": STATE_SIGNS,
        "nodes": {name: len(table[f"{name}.value"]) for name in ("signs", "state", "soon")},
    }

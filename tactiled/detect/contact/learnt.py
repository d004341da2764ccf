"""The trees of the contact filter and their data file."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tactiled.detect.contact.fast import Trees
from tactiled.detect.contact.filter import ROW_NAMES
from tactiled.detect.contact.posterior import HORIZONS_S, N_STATES
from tactiled.resources import shipped

FILE = "config", "learnt", "slip.npz"


class Learnt(NamedTuple):
    """Trees, and the base rate of what they were trained on."""

    signs: Trees  # score of sliding, from the signs of a look
    state: Trees  # score of each state, from some signs and the memory
    soon: Trees  # score of each time to gross slip, from the same
    base_odds: float  # log odds of sliding in the looks that `signs` was trained on


def learnt_from(table: Mapping[str, Any]) -> Learnt:
    """Make the trees from arrays by name, ``forest.array``, as `bench.train.fit` makes them.

    Raises
    ------
    ValueError
        The trees were learnt from signs of other names or places, or for other states.
    """

    def forest(name: str) -> Trees:
        prefix = f"{name}."
        return Trees({key.removeprefix(prefix): table[key] for key in table if key.startswith(prefix)})

    names = table["names"].tolist()
    if names != list(ROW_NAMES):
        other = sorted(set(names) ^ set(ROW_NAMES)) or ["the same in another order"]
        raise ValueError(
            f"{'/'.join(FILE)}: the trees were learnt from other signs ({', '.join(other[:5])}); "
            "learn them anew (./run train slip)"
        )
    n_scores = [len(table[f"{name}.first"]) for name in Learnt._fields[:3]]
    if n_scores != [1, N_STATES, len(HORIZONS_S) + 1]:
        raise ValueError(
            f"{'/'.join(FILE)}: the trees have {n_scores} scores; learn them anew (./run train slip)"
        )
    return Learnt(forest("signs"), forest("state"), forest("soon"), float(table["base_odds"]))


@functools.cache
def shipped_trees() -> Mapping[str, Any]:
    """Return the arrays that are shipped."""
    with np.load(shipped(*FILE), allow_pickle=False) as found:
        return {key: found[key] for key in found.files if key != "about"}


@functools.cache
def shipped_learnt() -> Learnt:
    """Return the trees that are shipped, made once: each detector reads the scores right after `evaluate`."""
    return learnt_from(shipped_trees())

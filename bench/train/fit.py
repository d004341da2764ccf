"""Fit of the three forests of the contact filter, and their form as flat arrays."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier

from bench.report import counted
from bench.train.rows import Looks
from bench.worlds.generators import Names, pairs_of_physics, same_physics
from tactiled.array import FloatArray
from tactiled.detect.contact.fast import Memory
from tactiled.detect.contact.filter import LOAD_CHANGE, ROW_NAMES, STATE_SIGNS
from tactiled.detect.contact.memory import MEMORY_NAMES, kept_load
from tactiled.detect.contact.posterior import EDGES, N_STATES
from tactiled.detect.contact.signs import NAMES
from tactiled.progress import ProgressBar

_COLUMNS = [NAMES.index(name) for name in STATE_SIGNS]


class Shape(NamedTuple):
    """Size of a forest."""

    trees: int
    leaves: int
    rate: float
    least_rows: int
    bins: int = 120  # levels of each column: many more than a tree has leaves


class Shapes(NamedTuple):
    """Sizes of the three forests: of the signs, of the state, and of what comes soon."""

    signs: Shape
    state: Shape
    soon: Shape


SHIPPED = Shapes(  # of each pair of physics
    signs=Shape(trees=40, leaves=16, rate=0.4, least_rows=4000),
    state=Shape(trees=8, leaves=12, rate=0.4, least_rows=4000),
    soon=Shape(trees=8, leaves=12, rate=0.4, least_rows=2000),
)
QUICK = Shapes(*(shape._replace(trees=8, bins=8, least_rows=100) for shape in SHIPPED))
# Parts of the time of contact of everyday hands in which all of it slides; and of the rest, in which a slide
# begins within the longest horizon: priors. Generators have other ones, each its own.
_SLIDES, _SOON = 0.1, 0.02
BASE_ODDS = float(np.log(_SLIDES / (1 - _SLIDES)))
_SHRINK = 10.0  # rows of doubt in each leaf: what few rows say seldom holds for another physics
_THIN = 5  # neighbouring looks say the same: one in so many is learnt from


# Signs of which more never speaks against sliding: taxels that move on their own, and ripples that travel.
# What few worlds have seen of large ones says otherwise.
_SPEAKS_FOR_SLIDING = ("wander_", "detail_1", "detail_2", "detail_3", "detail_noises_", "ripple_travels")
_MONOTONE = [int(name.startswith(_SPEAKS_FOR_SLIDING)) for name in NAMES]


class PairForests(NamedTuple):
    """Forests of the state and of what comes soon, grown on two kinds of physics."""

    state: HistGradientBoostingClassifier
    soon: HistGradientBoostingClassifier


FirstForests = Mapping[Names, HistGradientBoostingClassifier]
"""Forests of the signs by the pair of physics that they were grown on."""


def first_forests(
    pool: Executor, worlds: Sequence[Looks], progress: ProgressBar, shapes: Shapes = SHIPPED
) -> FirstForests:
    """Grow a forest that scores sliding by the signs of a look on each pair of physics.

    Their mean log odds rank the looks of other physics better than one forest that is grown on all
    (docs/blind-alleys.md).
    """
    pairs = pairs_of_physics(dict.fromkeys(w.generator for w in worlds))
    grow = pool.map(partial(_first_forest, worlds, shapes=shapes), pairs)
    return dict(zip(pairs, counted(grow, progress, "trees of the signs"), strict=True))


def _first_forest(worlds: Sequence[Looks], pair: Names, shapes: Shapes) -> HistGradientBoostingClassifier:
    some = [w for w in worlds if w.generator in pair]
    slides = np.concatenate([w.slides for w in some])
    weight = weights(some, slides, _SLIDES, np.ones_like(slides))
    signs, thin = np.concatenate([w.signs for w in some]), _thin(some)
    return grown(shapes.signs, signs[thin], slides[thin], weight[thin], _MONOTONE)


def pair_forests(
    worlds: Sequence[Looks],
    first: FirstForests,
    without: Names = frozenset(),
    shapes: Shapes = SHIPPED,
) -> dict[Names, PairForests]:
    """Grow the other forests on each pair of physics, as if some generators did not exist.

    The trees of the state must know how far to trust the odds of the first ones on physics that those have
    not seen. So they learn from the odds of forests that were not grown on the physics of the look.
    """
    names = [name for name in dict.fromkeys(w.generator for w in worlds) if name not in without]
    looks = {name: [w for w in worlds if w.generator == name] for name in names}
    rows = {name: _state_rows_of(name, own, first, without) for name, own in looks.items()}
    found = {}
    for pair in (pair for pair in first if not pair & without):
        both = [name for name in names if name in pair]
        own = [w for name in both for w in looks[name]]
        found[pair] = _pair_forests(own, np.concatenate([rows[name] for name in both]), shapes)
    return found


def _state_rows_of(name: str, worlds: Sequence[Looks], first: FirstForests, without: Names) -> FloatArray:
    unseen = without | same_physics(name)
    signs = np.concatenate([w.signs for w in worlds])
    log_odds = np.mean([one.decision_function(signs) for pair, one in first.items() if not pair & unseen], 0)
    return state_rows(worlds, 1 / (1 + np.exp(-log_odds)), BASE_ODDS)


def _pair_forests(worlds: Sequence[Looks], rows: FloatArray, shapes: Shapes) -> PairForests:
    slides, thin = np.concatenate([w.slides for w in worlds]), _thin(worlds)
    weight = weights(worlds, slides, _SLIDES, np.ones_like(slides))
    state = grown(shapes.state, rows[thin], states(worlds)[thin], weight[thin])
    sticks = thin & ~slides
    soon = np.concatenate([w.soon for w in worlds])
    weight = weights(worlds, soon > 0, _SOON, ~slides)
    return PairForests(state, grown(shapes.soon, rows[sticks], soon[sticks], weight[sticks]))


def learnt_table(first: FirstForests, forests: Mapping[Names, PairForests]) -> dict[str, Any]:
    """Return the arrays that `learnt_from` reads: the mean scores of the forests of some pairs."""
    kinds = {
        "signs": [first[pair] for pair in forests],
        "state": [one.state for one in forests.values()],
        "soon": [one.soon for one in forests.values()],
    }
    arrays = {f"{kind}.{name}": array for kind, some in kinds.items() for name, array in flat(some).items()}
    return arrays | {"base_odds": np.array(BASE_ODDS), "names": np.array(ROW_NAMES)}


def _thin(worlds: Sequence[Looks]) -> NDArray[np.bool_]:
    return np.concatenate([np.arange(len(w.signs)) % _THIN == k % _THIN for k, w in enumerate(worlds)])


def states(worlds: Sequence[Looks]) -> NDArray[np.int64]:
    """Return the cell of each look."""
    used = np.concatenate([w.utilisation for w in worlds])
    slides = np.concatenate([w.slides for w in worlds])
    cell = np.clip(np.searchsorted(EDGES, used, side="right") - 1, 0, N_STATES - 2)
    return np.where(slides, N_STATES - 1, cell)


def state_rows(worlds: Sequence[Looks], p: FloatArray, base_odds: float) -> FloatArray:
    """Return what the second trees see: signs, and the memory of the odds of the first ones."""
    found, at = [], 0
    for world in worlds:
        found.append(_memory_rows(world, p[at : at + len(world.signs)], base_odds))
        at += len(world.signs)
    signs = np.concatenate([w.signs[:, _COLUMNS] for w in worlds])
    return np.concatenate([signs, np.concatenate(found)], axis=1)


def _memory_rows(world: Looks, p: FloatArray, base_odds: float) -> FloatArray:
    one = Memory(base_odds)
    rows = np.empty((len(p), len(MEMORY_NAMES)))
    ratio, load_change = world.ratio.tolist(), world.signs[:, LOAD_CHANGE].tolist()
    for k, (begins, odds) in enumerate(zip(world.begins.tolist(), p.tolist(), strict=True)):
        if begins:
            one.begin_contact()
        one.take(odds, ratio[k], world.look_s, kept_load(load_change[k]))
        rows[k] = one.row
    return rows


def weights(
    worlds: Sequence[Looks], is_so: NDArray[np.bool_], part: float, among: NDArray[np.bool_]
) -> FloatArray:
    """Return the weight of each look among some, so that generators weigh the same.

    The looks of a world count by the root of their time, those that are so and the others apart: a long slide
    or rest says much the same at each look. Those that are so have a part of each generator's weight.
    """
    n_looks = [len(w.signs) for w in worlds]
    seconds = np.repeat([w.look_s for w in worlds], n_looks)
    world = np.repeat(np.arange(len(worlds)), n_looks)
    generator = np.repeat([w.generator for w in worlds], n_looks)
    weight = np.zeros(len(seconds))
    names = np.unique(generator)
    for name in names:
        for chosen, share in ((is_so, part), (~is_so, 1.0 - part)):
            of = among & chosen & (generator == name)
            time_s = np.bincount(world[of], seconds[of], minlength=len(worlds))
            weight[of] = seconds[of] / np.sqrt(time_s[world[of]])
            weight[of] *= share / max(float(weight[of].sum()), 1e-9)
    return weight * int(among.sum()) / len(names)


def grown(
    shape: Shape,
    rows: FloatArray,
    classes: NDArray[Any],
    weight: FloatArray,
    monotone: list[int] | None = None,
) -> HistGradientBoostingClassifier:
    """Fit a forest; `monotone` has 1 for each column of which more never speaks against class 1."""
    # A column without any value cannot be divided into bins; one of zeros is never split.
    rows = _rounded(np.where(np.isnan(rows).all(axis=0), 0.0, rows), shape.bins)
    return HistGradientBoostingClassifier(
        max_iter=shape.trees,
        max_leaf_nodes=shape.leaves,
        learning_rate=shape.rate,
        min_samples_leaf=shape.least_rows,
        max_bins=shape.bins,
        l2_regularization=_SHRINK,
        monotonic_cst=monotone,
        early_stopping=False,
        random_state=0,
    ).fit(rows, classes, sample_weight=weight)


def _rounded(rows: FloatArray, n_levels: int) -> FloatArray:
    """Round each column to the nearest of its quantiles.

    Of many weighted values, scikit-learn finds bins in eight times the time of the trees (24 worlds of each
    generator). Of few, it takes the means of neighbours, which is where rounding has its borders.
    """
    rounded = np.full_like(rows, np.nan)
    for column, values in enumerate(rows.T):
        known = ~np.isnan(values)
        if known.any():
            levels = np.unique(np.quantile(values[known], np.linspace(0.0, 1.0, n_levels)))
            borders = (levels[1:] + levels[:-1]) / 2
            rounded[known, column] = levels[np.searchsorted(borders, values[known])]
    return rounded


def flat(forests: Sequence[HistGradientBoostingClassifier]) -> Mapping[str, NDArray[Any]]:
    """Return the mean of forests as arrays, in the form of `tactiled.detect.contact.trees.Trees`."""
    roots, outputs = [], []
    links: list[tuple[int, int]] = []
    values: list[float] = []
    part = 1.0 / len(forests)
    if len({len(forest.classes_) for forest in forests}) > 1:
        raise ValueError("some pair of generators has no look of some state: draw more worlds of each")
    for forest in forests:
        for trees in forest._predictors:  # noqa: SLF001  # scikit-learn has no other way to its nodes
            for output, tree in enumerate(trees):
                roots.append(len(values))
                outputs.append(output)
                _lay_out(tree.nodes, 0, part, links, values)
    firsts = [np.ravel(forest._baseline_prediction) for forest in forests]  # noqa: SLF001
    return {
        "first": np.mean(firsts, axis=0).astype(np.float64),
        "root": np.array(roots, dtype=np.int32),
        "output": np.array(outputs, dtype=np.int16),
        "links": np.array(links, dtype=np.int32),
        "value": np.array(values, dtype=np.float64),
    }


def _lay_out(
    nodes: NDArray[Any], at: int, part: float, links: list[tuple[int, int]], values: list[float]
) -> None:
    """Append a node and all below it, the left ones first; scores of leaves count for a part."""
    node, place = nodes[at], len(values)
    if node["is_leaf"]:
        links.append((-1, 0))
        values.append(part * node["value"])
        return
    links.append((0, 0))  # until the place of its right child is known
    values.append(node["num_threshold"])
    _lay_out(nodes, node["left"], part, links, values)
    links[place] = 2 * int(node["feature_idx"]) + int(node["missing_go_to_left"]), len(values)
    _lay_out(nodes, node["right"], part, links, values)

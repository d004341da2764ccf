"""Compiled modules of the learnt filter have the bits of the plain ones."""

import math
import os
from array import array
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.compiled import compiled_module
from tactiled.detect.contact import memory, posterior, signs, trees

COMPILED = {
    name: compiled_module(f"tactiled.detect.contact.{name}")
    for name in ("memory", "posterior", "signs", "trees")
}
needs_modules = pytest.mark.skipif(
    not all(COMPILED.values()) and "TACTILED_CI" not in os.environ, reason="needs cc, Cython and Python.h"
)


def of(name: str) -> ModuleType:
    module = COMPILED[name]
    assert module is not None
    return module


def bits(values: object) -> bytes:
    return np.array(values, dtype=np.float64).tobytes()


@needs_modules
@given(
    n_taxels=st.sampled_from([1, 2, 9, 64]),
    per_friction=st.sampled_from([1e-6, 1.0, 1.3, 1e6]),
    size=st.sampled_from([0.0, 1e-9, 1.0, 1e6]),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=25, deadline=None)
def test_signs_and_memory(n_taxels: int, per_friction: float, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((2, n_taxels)).tolist()
    seen = [one.Signs(x, y, 0.02, per_friction) for one in (signs, of("signs"))]
    kept = [one.Memory(-2.0) for one in (memory, of("memory"))]
    zero = 0.1 * rng.standard_normal(2 * n_taxels)
    reading = size * np.abs(rng.standard_normal(3 * n_taxels))
    for k in range(120):
        reading = reading + 0.05 * size * rng.standard_normal(3 * n_taxels)
        acceleration, p = rng.choice([math.nan, 9.0]), float(rng.uniform())
        for one in seen:
            if k == 70:
                one.restart()
            one.take(reading, zero)
            if k % 3:
                one.look(1e-3 * size, acceleration)
        assert bits(seen[0].row) == bits(seen[1].row)
        for one in kept:
            if k == 90:
                one.begin_contact()
            one.take(p, seen[0].ratio, 0.02, 1.0 if k % 7 else 0.5)
        assert bits(kept[0].row) == bits(kept[1].row)


@needs_modules
@given(st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_trees(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_trees = 20  # of two splits and three leaves each
    root = 5 * np.arange(n_trees)
    forest = {
        "first": rng.standard_normal(3),
        "root": root,
        "output": rng.integers(0, 3, n_trees),
        "links": np.column_stack(
            [
                np.where(np.arange(5 * n_trees) % 5 < 2, rng.integers(0, 16, 5 * n_trees), -1),
                np.repeat(root, 5) + np.tile([4, 3, 0, 0, 0], n_trees),
            ]
        ),
        "value": rng.standard_normal(5 * n_trees),
    }
    row = rng.standard_normal(8)
    row[rng.random(8) < 0.2] = math.nan
    found = []
    for one in (trees, of("trees")):
        scores = one.Trees(forest)
        scores.evaluate(array("d", row))
        found.append(bits(scores.scores))
    assert found[0] == found[1]


@needs_modules
@given(st.integers(0, 2**32), st.sampled_from([0.0, 1e-6, 0.3, 50.0]))
@settings(max_examples=30, deadline=None)
def test_posterior(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    signs_row, memory_row = array("d", rng.standard_normal(7)), array("d", rng.standard_normal(3))
    scores, soon = (array("d", 5 * rng.standard_normal(n)) for n in (posterior.N_STATES, 4))
    odds, flags = rng.normal(0, 5), rng.integers(0, 2, 2).tolist()
    found = []
    for one in (posterior, of("posterior")):
        state = one.Posterior([5, 0, 2], 3)
        state.gather(signs_row, memory_row)
        state.take(scores, soon, odds, ratio, -0.7, 0.05, flags[1], flags[0])
        state.publish(flags[1], 0.2, ratio, -0.6, 0.04)
        parts = state.row, state.cells, state.soon, state.utilisation, state.friction
        found.append([*map(bits, parts), state.p_sliding, state.slipping_share])
    assert found[0] == found[1]

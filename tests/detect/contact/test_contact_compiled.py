"""Compiled modules of the contact filter have the bits of the plain ones."""

import math
import os
from array import array
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.compiled import compiled_module
from tactiled.detect.contact import filter as plain_filter
from tactiled.detect.contact import signs
from tactiled.detect.contact.learnt import learnt_from, shipped_trees

COMPILED = {name: compiled_module(f"tactiled.detect.contact.{name}") for name in ("filter", "signs")}
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
def test_signs(n_taxels: int, per_friction: float, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((2, n_taxels)).tolist()
    seen = [one.Signs(x, y, 0.02, per_friction) for one in (signs, of("signs"))]
    zero = 0.1 * rng.standard_normal(2 * n_taxels)
    reading = size * np.abs(rng.standard_normal(3 * n_taxels))
    for k in range(120):
        reading = reading + 0.05 * size * rng.standard_normal(3 * n_taxels)
        acceleration = rng.choice([math.nan, 9.0])
        for one in seen:
            if k == 70:
                one.restart()
            if k == 90:
                one.begin(is_seen=False)
            one.take(reading, zero)
            if k % 3:
                one.look(1e-3 * size, acceleration)
        assert bits(seen[0].row) == bits(seen[1].row)


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
    for one in (plain_filter, of("filter")):
        scores = one.Trees(forest)
        scores.evaluate(array("d", row))
        found.append(bits(scores.scores))
    assert found[0] == found[1]


@needs_modules
@given(
    seed=st.integers(0, 2**32), pull=st.sampled_from([0.0, 0.01, 0.03]), gross_p=st.sampled_from([0.1, 0.5])
)
@settings(max_examples=15, deadline=None)
def test_the_whole_filter(seed: int, pull: float, gross_p: float) -> None:
    """A touch that is pulled until it may slip, with a gap, light scans, and a lift."""
    found = []
    for one, of_signs in ((plain_filter, signs), (of("filter"), of("signs"))):
        rng = np.random.default_rng(seed)
        x, y = rng.standard_normal((2, 9)).tolist()
        learnt = learnt_from(shipped_trees())
        forests = [one.Trees(tables()[name]) for name in ("signs", "state", "soon")]
        learnt = learnt._replace(signs=forests[0], state=forests[1], soon=forests[2])
        contact = one.ContactFilter(of_signs.Signs(x, y, 0.02), learnt, 100.0, 0.6, 0.6, 0.6, gross_p)
        contact.begin(is_seen=bool(rng.integers(2)))
        shear, events = np.zeros((2, 9)), []
        for k in range(150):
            shear += pull * np.array([[1.0], [0.3]]) + 0.01 * rng.standard_normal((2, 9))
            load = np.full(9, 1.0 if k < 140 else 0.3)
            if k == 90:
                contact.restart()
            if k == 100:
                contact.hysteresis.settle()
                contact.friction_memory.widen(0.1)
            reading = np.concatenate([load, *shear])
            contact.take(
                k / 100, reading, np.zeros(18), 1e-3, math.nan, k > 20, float(k % 70 > 60), k % 50 > 2
            )
            events.append(contact.event(k / 100, True, False))
        found.append((events, bits(contact.kept_scans()), bits(contact.row), contact.friction_now))
    assert found[0] == found[1]


def tables() -> dict[str, dict[str, object]]:
    """Tables of the shipped forests."""
    table = shipped_trees()
    return {
        name: {key.removeprefix(f"{name}."): table[key] for key in table if key.startswith(f"{name}.")}
        for name in ("signs", "state", "soon")
    }

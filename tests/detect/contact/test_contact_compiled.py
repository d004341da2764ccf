"""Compiled modules of the contact filter have the bits of the plain ones."""

import math
import os
from array import array
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.compiled import compiled_module
from tactiled.detect.contact.filter import ContactFilter
from tactiled.detect.contact.friction import FrictionMemory
from tactiled.detect.contact.hysteresis import SlipHysteresis
from tactiled.detect.contact.learnt import learnt_from, shipped_trees
from tactiled.detect.contact.memory import Memory
from tactiled.detect.contact.posterior import Posterior
from tactiled.detect.contact.signs import Signs
from tactiled.detect.contact.trees import Trees

PARTS: tuple[type, ...] = (ContactFilter, Signs, Trees, Memory, FrictionMemory, Posterior, SlipHysteresis)
COMPILED: dict[type, Any] = {
    one: getattr(compiled_module(one.__module__), one.__name__, None) for one in PARTS
}
needs_modules = pytest.mark.skipif(
    not all(COMPILED.values()) and "TACTILED_CI" not in os.environ, reason="needs cc, Cython and Python.h"
)


def both(plain: type) -> tuple[Any, Any]:
    """Return a class in its plain and in its compiled form."""
    return plain, COMPILED[plain]


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
    seen = [one(x, y, 0.02, per_friction) for one in both(Signs)]
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
    for one in both(Trees):
        scores = one(forest)
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
    for contact_of, signs_of, trees_of, memory_of, friction_of, posterior_of, hysteresis_of in (
        PARTS,
        [COMPILED[part] for part in PARTS],
    ):
        rng = np.random.default_rng(seed)
        x, y = rng.standard_normal((2, 9)).tolist()
        forests = {name: trees_of(table) for name, table in tables().items()}
        contact = contact_of(
            signs_of(x, y, 0.02),
            learnt_from(shipped_trees())._replace(**forests),
            memory_of(-2.0),
            friction_of(0.6, 0.6),
            posterior_of(0.02),
            hysteresis_of(0.6, gross_p, 0.02),
            100.0,
        )
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

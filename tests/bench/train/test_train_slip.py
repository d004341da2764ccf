"""Learning the contact filter: looks with their truth, weights, and and trees as flat arrays."""

import dataclasses
import json
import math
from array import array
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from threadpoolctl import threadpool_limits

from bench.train import fit, rows, slip
from bench.train.__main__ import train
from bench.train.rows import Looks, looks_of
from bench.worlds.generators import GENERATORS, draw, pairs_of_physics, same_physics
from tactiled.detect.contact.fast import Trees
from tactiled.detect.contact.filter import ROW_NAMES
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.contact.learnt import FILE, learnt_from, shipped_trees
from tactiled.detect.contact.posterior import EDGES, N_STATES
from tactiled.detect.contact.signs import NAMES
from tactiled.progress import ProgressBar
from tactiled.resources import shipped

LOOKS = ("time_s", "signs", "begins", "slides", "utilisation", "ahead_s")


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Grow trees on one thread: on few rows several cost more time than they save."""
    with threadpool_limits(1, user_api="openmp"):
        yield


@pytest.fixture(scope="module")
def worlds() -> list[Looks]:
    few = [*draw("strokes", range(7000, 7008), 0.1), *draw("laws", range(7000, 7006), 0.1)]
    return [looks for looks in map(looks_of, few) if len(looks.signs)]


def test_looks_are_those_of_the_detector_with_the_truth_of_their_scans() -> None:
    (world,) = draw("strokes", range(7000, 7001), 0.1)  # a seed without announcement and cut
    looks = looks_of(world)
    assert looks.signs.shape == (len(looks.time_s), len(NAMES))
    scans = np.round(looks.time_s * world.rate_hz).astype(int)
    np.testing.assert_array_equal(looks.slides, world.gross[scans])
    assert looks.begins[0]
    assert ((looks.soon > 0) == (looks.ahead_s <= 0.3)).all()
    detector = GripDetector(world.array)
    seen = [
        np.array(scan.signs.row)
        for _ in detector.scans(world.block)
        if (scan := detector.contact) is not None and scan.is_look
    ]
    np.testing.assert_array_equal(np.array(seen), looks.signs)


def test_generators_and_classes_have_the_weight_that_was_stated(worlds: list[Looks]) -> None:
    slides = np.concatenate([w.slides for w in worlds])
    generator = np.repeat([w.generator for w in worlds], [len(w.signs) for w in worlds])
    weight = fit.weights(worlds, slides, 0.1, np.ones_like(slides))
    for name in ("strokes", "laws"):
        own = generator == name
        assert weight[own].sum() == pytest.approx(weight.sum() / 2)
        assert weight[own & slides].sum() == pytest.approx(0.1 * weight[own].sum())


def test_a_slide_that_is_four_times_as_long_has_twice_the_weight(worlds: list[Looks]) -> None:
    one = next(w for w in worlds if len(w.signs) >= 80)
    few = [dataclasses.replace(one, **{f: getattr(one, f)[:n] for f in LOOKS}) for n in (20, 80)]
    all_slide = np.ones(100, dtype=np.bool_)
    weight = fit.weights(few, all_slide, 0.1, all_slide)
    assert weight[20:].sum() == pytest.approx(2 * weight[:20].sum())


def test_the_flat_trees_score_as_the_library_does(worlds: list[Looks]) -> None:
    rows = np.concatenate([w.signs for w in worlds])
    classes = np.searchsorted(EDGES, np.concatenate([w.utilisation for w in worlds]))
    shape = fit.Shape(trees=5, leaves=6, rate=0.2, least_rows=20, bins=16)
    forest = fit.grown(shape, rows, classes, np.ones(len(rows)))
    ours = Trees(fit.flat([forest]))
    chosen = rows[::97]
    for row, wanted in zip(chosen, forest.predict_proba(chosen), strict=True):
        ours.evaluate(array("d", row))
        scores = np.exp(np.array(ours.scores) - max(ours.scores))
        np.testing.assert_allclose(scores / scores.sum(), wanted, rtol=1e-9, atol=1e-12)


def test_forests_of_pairs_score_their_mean(worlds: list[Looks]) -> None:
    rows = np.concatenate([w.signs for w in worlds])
    slides = np.concatenate([w.slides for w in worlds])
    shape = fit.Shape(trees=4, leaves=6, rate=0.2, least_rows=20, bins=16)
    forests = [fit.grown(shape, rows[k::2], slides[k::2], np.ones(len(rows[k::2]))) for k in (0, 1)]
    ours = Trees(fit.flat(forests))
    chosen = rows[::97]
    wanted = np.mean([forest.decision_function(chosen) for forest in forests], axis=0)
    for row, score in zip(chosen, wanted, strict=True):
        ours.evaluate(array("d", row))
        assert ours.scores[0] == pytest.approx(score, rel=1e-9, abs=1e-12)


def test_what_shares_a_skin_is_one_physics() -> None:
    assert same_physics("grasps") == same_physics("plates") == {"grasps", "plates"}
    assert pairs_of_physics(["laws", "grasps", "sheet", "plates"]) == [
        {"laws", "grasps", "plates"},
        {"laws", "sheet"},
        {"grasps", "plates", "sheet"},
    ]


def test_the_shipped_trees_fit_the_signs_and_say_what_they_were_learnt_from() -> None:
    table = shipped_trees()
    about = json.loads(shipped(*FILE).with_suffix(".json").read_text())
    assert about["signs"] == list(NAMES)
    assert about["nodes"] == {name: len(table[f"{name}.value"]) for name in ("signs", "state", "soon")}
    assert "dirty" not in about["commit"]
    assert set(about["learnt_from"]) == {"laws", "bristles", "sheet", "strokes", "grasps", "plates"}
    learnt = learnt_from(table)
    assert (len(learnt.signs.first), len(learnt.state.first), len(learnt.soon.first)) == (1, N_STATES, 4)
    learnt.signs.evaluate(array("d", [math.nan] * len(NAMES)))
    assert math.isfinite(learnt.signs.scores[0])


def test_trees_of_other_signs_are_refused() -> None:
    moved = dict(shipped_trees()) | {"names": np.array([*ROW_NAMES[1:], "wander_of_old"])}
    with pytest.raises(ValueError, match=r"slip.npz.*wander_of_old.*train slip"):
        learnt_from(moved)


def test_the_command_writes_trees_that_the_detector_runs_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows, "GENERATORS", {"strokes": None, "laws": None, "sheet": None})
    monkeypatch.setattr(rows, "QUICK", (rows.Lot(100_000, 6, 0.1), rows.Lot(110_000, 3, 0.15)))
    monkeypatch.setattr(slip, "executor", lambda *_: nullcontext(SimpleNamespace(map=map)))
    few = (shape._replace(trees=2, leaves=4) for shape in fit.QUICK)
    monkeypatch.setattr(slip, "QUICK", fit.Shapes(*few))
    path = tmp_path / "slip.npz"
    done = CliRunner().invoke(train, ["slip", "--quick", "--to", str(path)])
    assert done.exit_code == 0, done.output
    assert set(json.loads(done.stdout)) == {"strokes", "laws", "sheet"}
    about = json.loads(path.with_suffix(".json").read_text())
    assert about["command"] == "./run train slip --quick"
    with np.load(path) as table:
        assert len(np.unique(table["signs.value"])) > 2  # the trees have branches
        assert len(np.unique(table["state.value"])) > 2
        (world,) = draw("laws", range(7001, 7002), 0.1)
        events = GripDetector(world.array, learnt=learnt_from(table)).process(world.block)
    assert events


def test_a_left_out_filter_does_not_see_what_it_is_left_out_of() -> None:
    """Noise in place of all worlds of one kind of physics changes nothing of the filter without it."""
    shapes = fit.Shapes(*(shape._replace(trees=2, leaves=4, least_rows=20) for shape in fit.QUICK))
    worlds = [
        looks
        for name in GENERATORS
        for looks in map(looks_of, draw(name, range(7_000, 7_012), 0.1))
        if len(looks.signs)
    ]
    rng = np.random.default_rng(0)

    def spoilt(looks: Looks) -> Looks:
        n = len(looks.signs)
        return dataclasses.replace(
            looks,
            signs=rng.normal(size=looks.signs.shape),
            slides=rng.random(n) < 0.5,
            utilisation=rng.random(n),
            ahead_s=rng.random(n),
        )

    def filter_of(some: list[Looks], without: frozenset[str]) -> Mapping[str, Any]:
        pool: Any = SimpleNamespace(map=map)
        first = fit.first_forests(pool, some, ProgressBar("trees", None), shapes)
        return fit.learnt_table(first, fit.pair_forests(some, first, without, shapes))

    own = same_physics("plates")
    other = [spoilt(looks) if looks.generator in own else looks for looks in worlds]
    for without, is_same in ((own, True), (frozenset[str](), False)):
        found = [filter_of(some, without) for some in (worlds, other)]
        assert all(np.array_equal(found[0][key], found[1][key]) for key in found[0]) == is_same

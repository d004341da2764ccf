"""Tables of contact model periodic: the shipped ones are up to date, and no scene waits for long."""

from typing import Any

import numpy as np
import pytest

from tactiled.array import FloatArray, load_array
from tactiled.emulator.mechanics import periodic
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.prepare import missing_tables
from tactiled.emulator.scene.description import Scene, load_scene, paper_scenes
from tactiled.emulator.scene.truth import Truth
from tactiled.errors import ConfigError

DEMO_PLATES = {"flat": Surface(0.6), "grooves": Surface(0.6, 1.2, 30.0, 0.1)}
SLIDE = {"kind": "slide", "duration_s": 0.5, "speed_mm_s": 1.0}


@pytest.mark.parametrize("plate", DEMO_PLATES)
def test_shipped_tables_equal_those_solved_now(plate: str) -> None:
    case = periodic.TableCase(DEMO_PLATES[plate], (0.0, 90.0, 180.0, 270.0), "edge")
    shipped = periodic.tables()[case.key(0, 0)]
    np.testing.assert_allclose(periodic.solve_sliding(case, 0, 0), shipped, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["demo", "experiment-d0.90-a0", "simulation-d1.20-a60"])
def test_a_shipped_scene_has_nothing_to_solve(name: str) -> None:
    scene = load_scene("demo") if name == "demo" else paper_scenes()[name].with_changes(contact="periodic")
    assert missing_tables(scene, load_array(scene.array)) == []


def grooved(*phases: dict[str, Any], **rest: Any) -> Scene:
    plate = {"kind": "grooves", "period_mm": 1.13, "angle_deg": 0.0}
    press = {"kind": "press", "duration_s": 0.5, "force_n": 0.2}
    return Scene.model_validate(
        {"name": "t", "contact": "periodic", "surface": plate, "phases": [press, *phases], **rest}
    )


def test_all_tables_that_a_scene_looks_up_are_known_beforehand(monkeypatch: pytest.MonkeyPatch) -> None:
    def solve_sliding(*_: Any) -> FloatArray:
        return np.zeros((1, 9))

    def solve_resting(*_: Any) -> FloatArray:
        return np.zeros((1, 21, 9))

    monkeypatch.setattr(periodic, "solve_sliding", solve_sliding)
    monkeypatch.setattr(periodic, "_solve_resting", solve_resting)
    scene, before = grooved(SLIDE), set(periodic.tables())
    missing = missing_tables(scene, load_array(scene.array))
    for solve in missing:
        solve()
    prepared = set(periodic.tables())
    assert len(prepared - before) == len(missing) > 2
    Truth(scene).state(np.arange(0.0, 1.0, 0.01))
    assert set(periodic.tables()) == prepared
    periodic.table.cache_clear()  # nothing of this test's is looked into by others
    for key in prepared - before:
        del periodic.tables()[key]


@pytest.mark.parametrize(
    ("scene", "finding"),
    [
        (grooved({"kind": "rotate", "duration_s": 3.0, "angle_deg": 360.0}), "tables to solve"),
        (grooved({"kind": "load", "duration_s": 1.0, "tangential_n": 1.0}, held_object={}), "controller"),
    ],
)
def test_scenes_that_cannot_be_prepared_are_refused(scene: Scene, finding: str) -> None:
    with pytest.raises(ConfigError, match=f"scene t: contact: periodic is not for real time.*{finding}"):
        missing_tables(scene, load_array(scene.array))

"""Tables of contact model periodic: the shipped ones are up to date, and no scene waits for long."""

from typing import Any

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.emulator.mechanics import period
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.period import shipped_tables, solved_tables, table_rows
from tactiled.emulator.prepare import prepare
from tactiled.emulator.scene.description import Scene, load_scene, paper_scenes
from tactiled.emulator.scene.truth import Truth
from tactiled.errors import ConfigError

DEMO_PLATES = {"flat": Surface(0.6), "grooves": Surface(0.6, 1.2, 30.0, 0.1)}
SIDES_DEG = (0.0, 90.0, 180.0, 270.0)


@pytest.mark.parametrize("plate", DEMO_PLATES)
def test_shipped_tables_equal_those_solved_now(plate: str) -> None:
    case = period.PeriodConditions(DEMO_PLATES[plate], SIDES_DEG, "force", "edge", "coarse")
    shipped = shipped_tables()[period.table_key(case, 0, 0)]
    np.testing.assert_allclose(period.solve_sliding(case, 0, 0), shipped, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["demo", "experiment-d0.90-a0", "simulation-d1.20-a60"])
def test_a_shipped_scene_has_nothing_to_solve(name: str) -> None:
    scene = load_scene("demo") if name == "demo" else paper_scenes()[name].with_changes(contact="periodic")
    before = set(solved_tables())
    prepare(scene, load_array(scene.array))
    assert set(solved_tables()) == before


SLIDE = {"kind": "slide", "duration_s": 0.5, "speed_mm_s": 1.0}


def grooved(*phases: dict[str, Any], **rest: Any) -> Scene:
    plate = {"kind": "grooves", "period_mm": 1.13, "angle_deg": 0.0}
    press = {"kind": "press", "duration_s": 0.5, "force_n": 0.2}
    return Scene.model_validate(
        {"name": "t", "contact": "periodic", "surface": plate, "phases": [press, *phases], **rest}
    )


def test_prepare_solves_all_tables_that_are_needed_and_reports_progress(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def solve(key: str, _: Any) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        solved.append(key)
        return np.zeros((1, 21, 9) if "resting" in key else (1, 9))

    solved: list[str] = []
    told: list[tuple[int, int]] = []
    monkeypatch.setattr(period, "table_rows", solve)
    scene = grooved(SLIDE)
    prepare(scene, load_array(scene.array), lambda done, tables: told.append((done, tables)))
    prepared = set(solved)
    assert len(prepared) > 2
    assert [done for done, _ in told] == list(range(told[0][1]))
    period.sliding.cache_clear()
    period.resting.cache_clear()
    Truth(scene).state(np.arange(0.0, 1.0, 0.01))
    assert set(solved) == prepared
    period.sliding.cache_clear()  # nothing of this test's is looked into by others
    period.resting.cache_clear()


@pytest.mark.parametrize(
    ("scene", "finding"),
    [
        (grooved({"kind": "rotate", "duration_s": 3.0, "angle_deg": 360.0}), "tables to solve"),
        (grooved({"kind": "load", "duration_s": 1.0, "tangential_n": 1.0}, held_object={}), "controller"),
    ],
)
def test_scenes_that_cannot_be_prepared_are_refused(scene: Scene, finding: str) -> None:
    with pytest.raises(ConfigError, match=f"scene t: contact: periodic is not for real time.*{finding}"):
        prepare(scene, load_array(scene.array))


def test_a_table_is_solved_once() -> None:
    def solve() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        calls.append(1)
        return np.zeros((1, 9))

    calls: list[int] = []
    first = table_rows("a table of this test", solve)
    assert table_rows("a table of this test", solve) is first
    assert len(calls) == 1

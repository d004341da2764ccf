"""Tables of the periodic rung: the shipped ones are what the mechanics of today give, and no scene waits."""

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.emulator.mechanics import periodic
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.tables import shipped_tables, solved_tables, table_rows
from tactiled.emulator.prepare import prepare
from tactiled.emulator.scene import load_scene, paper_scenes

DEMO_PLATES = {"flat": Surface(0.6), "grooves": Surface(0.6, 1.2, 30.0, 0.1)}
SIDES_DEG = (0.0, 90.0, 180.0, 270.0)


@pytest.mark.parametrize("plate", DEMO_PLATES)
def test_shipped_tables_are_what_is_solved_today(plate: str) -> None:
    case = periodic.Case(DEMO_PLATES[plate], SIDES_DEG, "force", "edge", "coarse")
    shipped = shipped_tables()[f"{case} sliding 0 0"]
    np.testing.assert_allclose(periodic.solve_sliding(case, 0, 0), shipped, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["demo", "experiment-d0.90-a0", "simulation-d1.20-a60"])
def test_a_shipped_scene_has_nothing_to_solve(name: str) -> None:
    scene = load_scene("demo") if name == "demo" else paper_scenes()[name].with_changes(contact="periodic")
    before = set(solved_tables())
    prepare(scene, load_array(scene.array))
    assert set(solved_tables()) == before


def test_a_table_is_solved_once() -> None:
    def solve() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        calls.append(1)
        return np.zeros((1, 9))

    calls: list[int] = []
    first = table_rows("a table of this test", solve)
    assert table_rows("a table of this test", solve) is first
    assert len(calls) == 1

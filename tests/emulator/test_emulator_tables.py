"""Tables of contact model periodic: the shipped ones are up to date and complete."""

import numpy as np
import pytest

from tactiled.emulator.mechanics import periodic
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.scene.description import load_scene, paper_scenes
from tactiled.emulator.scene.truth import Truth

DEMO_PLATES = {"flat": Surface(0.6), "grooves": Surface(0.6, 1.2, 30.0, 0.1)}


@pytest.mark.parametrize("plate", DEMO_PLATES)
def test_shipped_tables_equal_those_solved_now(plate: str) -> None:
    case = periodic.TableCase(DEMO_PLATES[plate], (0.0, 90.0, 180.0, 270.0), "edge")
    shipped = periodic.tables()[case.key(0, 0)]
    np.testing.assert_allclose(periodic.solve_sliding(case, 0, 0), shipped, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["demo", "experiment-d0.90-a0", "simulation-d1.20-a60"])
def test_a_shipped_scene_has_nothing_to_solve(name: str) -> None:
    scene = load_scene("demo") if name == "demo" else paper_scenes()[name].with_changes(contact="mechanics")
    before = set(periodic.tables())
    assert Truth(scene).slips
    assert set(periodic.tables()) == before

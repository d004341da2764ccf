"""Tables of contact model periodic: the shipped ones are up to date and complete."""

import numpy as np
import pytest

from tactiled.emulator.mechanics import periodic
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.truth import Truth

DEMO_PLATES = {"flat": Surface(0.6), "grooves": Surface(0.6, 1.2, 30.0, 0.1)}


@pytest.mark.parametrize("plate", DEMO_PLATES)
def test_shipped_tables_equal_those_solved_now(plate: str) -> None:
    case = periodic.TableCase(DEMO_PLATES[plate], (0.0, 90.0, 180.0, 270.0), "edge")
    shipped = periodic.tables()[case.key(0, 0)]
    np.testing.assert_allclose(periodic.solve_sliding(case, 0, 0), shipped, rtol=1e-6, atol=1e-9)


def test_the_demo_has_nothing_to_solve() -> None:
    before = set(periodic.tables())
    assert Truth(load_scene("demo")).slips
    assert set(periodic.tables()) == before

"""Large displacements to first order: moments balance, loads are kept, nothing runs away."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.emulator.mechanics.base import NOT_CONVERGED, Surface
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.displaced import Displaced, on_linear_skin_n, stiffening
from tactiled.emulator.mechanics.skin import shipped_skin

AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])


@given(st.floats(0.0, 1e6))
def test_what_is_taken_off_a_load_is_put_back(load_n: float) -> None:
    linear = on_linear_skin_n(np.array([load_n]))
    assert 0 <= linear[0] <= load_n
    np.testing.assert_allclose(stiffening(linear) * linear, load_n, rtol=1e-12)


def test_the_gradient_knows_planes_exactly() -> None:
    """So the dipoles of a couple have just its moment."""
    skin = shipped_skin()
    plane = 0.3 + 2.0 * skin.x_mm - 5.0 * skin.y_mm
    slopes = np.einsum("dnl,l->dn", skin.gradient, plane)
    np.testing.assert_allclose(slopes, np.array([[2.0], [-5.0]]) * np.ones(len(plane)), atol=1e-10)


def test_couples_turn_the_surface_as_the_force_that_makes_them() -> None:
    """Pressing that is dragged to -x sinks the skin at -x and lifts it at +x; at rest, nothing."""
    skin = shipped_skin()
    displaced = Displaced(skin, AZIMUTH)
    n = len(skin.x_mm)
    force, moved = np.zeros((3, n)), np.zeros((3, n))
    force[0] = skin.area_mm2 * (np.hypot(skin.x_mm, skin.y_mm) < 0.8)
    np.testing.assert_array_equal(displaced.turned_mm(force, moved), 0.0)
    moved[1] = -0.2
    turned = displaced.turned_mm(force, moved)
    assert turned[0, skin.x_mm < -0.3].min() > 0 > turned[0, skin.x_mm > 0.3].max()
    np.testing.assert_allclose(displaced.turned_mm(2 * force, moved), 2 * turned, rtol=1e-12)


def test_dragged_pressure_moves_its_load_to_the_side_it_is_dragged_to() -> None:
    skin = shipped_skin(readout="half")
    displaced = Displaced(skin, AZIMUTH)
    n = len(skin.x_mm)
    force, moved = np.zeros((1, 3, n)), np.zeros((1, 3, n))
    force[0, 0] = skin.area_mm2 * (np.hypot(skin.x_mm, skin.y_mm) < 0.8)
    rest = displaced.side_n(force, moved)[0]
    moved[0, 1] = -0.2
    dragged = displaced.side_n(force, moved)[0]
    assert dragged[0] > rest[0]
    assert dragged[2] < rest[2]
    np.testing.assert_allclose(dragged[[1, 3]], rest[[1, 3]], rtol=1e-3)
    assert dragged[0] + dragged[2] == pytest.approx(rest[0] + rest[2], rel=1e-3)


@pytest.mark.parametrize("depth_mm", [0.0, 0.1])
def test_a_hundred_newtons_do_not_run_away(depth_mm: float) -> None:
    rung = Compliance(Surface(0.6, 1.2, 10.0, depth_mm), AZIMUTH, 1)
    for k in range(20):
        felt = rung.step("force", np.array([100.0]), np.array([[0.05 * k, 0.0]]), 0.01)
        assert all(np.isfinite(values).all() for values in vars(felt).values())
        if not felt.warnings[0] & NOT_CONVERGED:
            assert felt.normal_n[0] == pytest.approx(100.0, rel=1e-5)
            assert felt.side_n.max() < 1000.0

"""Large displacements to first order: moments balance, loads are kept, nothing runs away."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.skin import (
    DisplacementEffects,
    on_linear_skin_n,
    shipped_skin,
    stiffening,
)

AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])


@given(st.floats(0.0, 1e6))
def test_stiffening_inverts_the_linear_load(load_n: float) -> None:
    linear = on_linear_skin_n(np.array([load_n]))
    assert 0 <= linear[0] <= load_n
    np.testing.assert_allclose(stiffening(linear) * linear, load_n, rtol=1e-12)


def test_the_gradient_is_exact_on_planes() -> None:
    """So the dipoles of a couple have just its moment."""
    skin = shipped_skin()
    plane = 0.3 + 2.0 * skin.x_mm - 5.0 * skin.y_mm
    slopes = np.einsum("dnl,l->dn", skin.gradient, plane)
    np.testing.assert_allclose(slopes, np.array([[2.0], [-5.0]]) * np.ones(len(plane)), atol=1e-10)


def test_couples_turn_the_surface_in_the_direction_of_their_force() -> None:
    """Pressing that is dragged to -x sinks the skin at -x and lifts it at +x; at rest, nothing."""
    skin = shipped_skin()
    displaced = DisplacementEffects(skin, AZIMUTH)
    n = len(skin.x_mm)
    force, moved = np.zeros((3, n)), np.zeros((3, n))
    force[0] = skin.area_mm2 * (np.hypot(skin.x_mm, skin.y_mm) < 0.8)
    np.testing.assert_array_equal(displaced.turned_mm(force, moved), 0.0)
    moved[1] = -0.2
    turned = displaced.turned_mm(force, moved)
    assert turned[0, skin.x_mm < -0.3].min() > 0 > turned[0, skin.x_mm > 0.3].max()
    np.testing.assert_allclose(displaced.turned_mm(2 * force, moved), 2 * turned, rtol=1e-12)


def test_displaced_pressure_loads_the_side_of_its_displacement() -> None:
    skin = shipped_skin(readout="half")
    displaced = DisplacementEffects(skin, AZIMUTH)
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
def test_forces_are_bounded_under_100_newtons(depth_mm: float) -> None:
    model = Compliance(Surface(0.6, 1.2, 10.0, depth_mm), AZIMUTH, 1)
    base_mm = np.zeros((9, 1, 2))
    base_mm[:, 0, 0] = 0.05 * np.arange(9)
    for place_mm in base_mm:
        unsolved = model.unsolved
        felt = model.step(np.array([100.0]), place_mm, 0.01)
        assert all(np.isfinite(values).all() for values in vars(felt).values())
        if model.unsolved == unsolved:
            assert felt.normal_n == pytest.approx(100.0, rel=1e-5)
            assert felt.side_n.max() < 1000.0

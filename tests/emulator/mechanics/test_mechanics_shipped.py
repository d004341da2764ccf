"""Finite elements of one taxel as they ship: the compliance of its surface, and the runs with friction."""

import numpy as np
import pytest
from scipy.optimize import nnls
from taxel_runs import load_reference, reference_names

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.skin import load_compliance
from tactiled.errors import DataError

LOAD_N = 15.0 / 9  # of a taxel: the paper has 15 N on nine
SHIPPED = [(name, run) for name in ("coarse", "medium") for run in reference_names(name)]
FLAT = [(name, run) for name, run in SHIPPED if run in ("flat-0.3", "flat-0.6", "flat-0.9")]


@pytest.fixture(scope="module")
def shipped() -> dict[str, FloatArray]:
    return load_compliance()


def test_shipped_compliance_is_symmetric_and_positive(shipped: dict[str, FloatArray]) -> None:
    n = len(shipped["x_mm"])
    assert np.array_equal(shipped["c_nn"], shipped["c_nn"].T)
    tangential = shipped["c_tt"].reshape(2 * n, 2 * n)
    assert np.array_equal(tangential, tangential.T)
    mixed = shipped["c_nt"].reshape(n, 2 * n)
    whole = np.block([[shipped["c_nn"], mixed], [mixed.T, tangential]])
    assert np.linalg.eigvalsh(whole)[0] > 0.1 * np.diag(whole).min()


def test_the_bottom_carries_the_forces_on_the_surface(shipped: dict[str, FloatArray]) -> None:
    np.testing.assert_allclose(shipped["bottom_from_normal"].sum(axis=0), 1.0, atol=1e-5)
    np.testing.assert_allclose(shipped["bottom_from_tangential"].sum(axis=0), 0.0, atol=1e-5)
    arm = shipped["bottom_x_mm"] @ shipped["bottom_from_normal"]
    height = 1.3 - shipped["gap_mm"]
    tilt = shipped["bottom_x_mm"] @ shipped["bottom_from_tangential"][:, :, 0]
    # Tangential forces at the bottom have no arm about y at z = 0: moments balance by normal ones alone.
    np.testing.assert_allclose(arm, shipped["x_mm"], atol=1e-5)
    np.testing.assert_allclose(tilt, height, atol=1e-5)


def test_sliding_along_x_loads_the_trailing_side(shipped: dict[str, FloatArray]) -> None:
    # Friction on a skin that moves along +x points along -x; R1 is on the -x side.
    friction = shipped["area_mm2"] * (np.hypot(shipped["x_mm"], shipped["y_mm"]) < 0.9)
    felt = -shipped["half_from_tangential"][:, :, 0] @ (friction / friction.sum())
    assert felt[0] == pytest.approx(-felt[2], rel=1e-4)
    assert felt[0] > 0.2
    np.testing.assert_allclose(felt[[1, 3]], 0.0, atol=1e-6)


@pytest.mark.parametrize(("approach_mm", "share"), [(0.05, 0.05), (0.10, 0.05), (0.17, 0.10)])
def test_linear_indentation_follows_the_load_curve(
    shipped: dict[str, FloatArray], approach_mm: float, share: float
) -> None:
    # Pressures p >= 0 with c_nn p >= approach - gap, complementary: least squares with signs.
    root = np.linalg.cholesky(shipped["c_nn"])
    pressed, _ = nnls(root.T, np.linalg.solve(root, approach_mm - shipped["gap_mm"]))
    curve = load_reference("coarse", "load").columns
    full = float(np.interp(approach_mm, curve["approach_mm"], curve["normal_n"]))
    assert pressed.sum() == pytest.approx(full, rel=share)


def test_an_unknown_run_is_refused_with_those_that_are_there() -> None:
    with pytest.raises(DataError, match=r"flat-0\.6"):
        load_reference("coarse", "flat")


@pytest.mark.parametrize(("mesh", "run"), FLAT)
def test_shipped_slides_end_on_the_friction_cone(mesh: str, run: str) -> None:
    reference = load_reference(mesh, run)
    columns, mu = reference.columns, reference.surface.friction
    pull = np.hypot(columns["tangential_x_n"], columns["tangential_y_n"])
    assert np.all(pull <= mu * columns["normal_n"] * (1 + 1e-3))
    assert pull[-1] == pytest.approx(mu * LOAD_N, rel=2e-3)
    sides = reference.sides()
    np.testing.assert_allclose(sides[:, 1], sides[:, 3], rtol=2e-3)
    assert columns["slipping"][-1] == 1.0


@pytest.mark.parametrize("area", ["half", "edge"])
def test_left_and_right_are_converged(area: str) -> None:
    """A read-out by bilinear traction was 9 % (half) and 21 % (edge) off here, lumped areas are 2 %."""
    ends = [load_reference(mesh, "flat-0.6").sides(area)[-1] for mesh in ("coarse", "medium")]
    coarse, medium = (end[0] - end[2] for end in ends)
    assert coarse == pytest.approx(medium, rel=0.03)


def test_ripple_along_the_grooves_is_converged() -> None:
    """Grooves at 60 degrees, where the ripple is smallest."""
    coarse, medium = (load_reference(mesh, "groove-1.2-60") for mesh in ("coarse", "medium"))
    sliding = coarse.columns["travel_x_mm"] > 0.42
    for side in (0, 2):
        one, other = coarse.sides()[sliding, side], medium.sides()[sliding, side]
        assert np.corrcoef(one, other)[0, 1] > 0.99
        assert np.ptp(one) == pytest.approx(np.ptp(other), rel=0.05)


def test_left_and_right_change_by_the_known_amounts() -> None:
    # On another mesh and read-out friction 0.3, 0.6, 0.9 gave +22/-23, +44/-46, +63/-69 % of half chips.
    for run, up, down in (("flat-0.3", 0.22, -0.23), ("flat-0.6", 0.44, -0.46), ("flat-0.9", 0.63, -0.69)):
        reference = load_reference("coarse", run)
        sides, pressed = reference.sides(), np.flatnonzero(reference.columns["travel_x_mm"] == 0)[-1]
        change = sides[-1] / sides[pressed] - 1
        assert change[0] == pytest.approx(up, rel=0.15)
        assert change[2] == pytest.approx(down, rel=0.15)

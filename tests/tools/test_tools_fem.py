"""Finite elements of one taxel: mesh, compliance, read-out, and the shipped runs."""

import numpy as np
import pytest
from scipy.optimize import nnls

from tactiled.array import FloatArray
from tactiled.emulator.mechanics import taxel_shape
from tactiled.emulator.mechanics.skin import load_compliance
from tactiled.errors import DataError
from tools.fem.compliance import compliance_arrays
from tools.fem.linear import stiffness
from tools.fem.mesh import CELL_MM, CHIP_RADIUS_MM, MATERIALS, MESHES, TaxelMesh, taxel_mesh
from tools.fem.readout import EDGE_MM, read_out, side_parts
from tools.fem.reference import load_reference, reference_names

LOAD_N = 15.0 / 9  # of a taxel: the paper has 15 N on nine
SHIPPED = [(name, run) for name in MESHES for run in reference_names(name)]
FLAT = [(name, run) for name, run in SHIPPED if run in ("flat-0.3", "flat-0.6", "flat-0.9")]


@pytest.fixture(scope="module")
def coarse() -> TaxelMesh:
    return taxel_mesh(MESHES["coarse"])


@pytest.fixture(scope="module")
def shipped() -> dict[str, FloatArray]:
    return load_compliance("coarse")


def corner_volumes(mesh: TaxelMesh) -> FloatArray:
    """Triple product of the edges at each corner of each cell (c, 8)."""
    neighbours = [(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)]
    corners = mesh.points_mm[mesh.cells]
    edges = np.stack([corners[:, list(n)] - corners[:, [k]] for k, n in enumerate(neighbours)], axis=1)
    return np.asarray(np.linalg.det(edges))


@pytest.mark.parametrize("name", MESHES)
def test_all_cells_have_positive_volume_and_the_chip_is_in_its_place(name: str) -> None:
    mesh = taxel_mesh(MESHES[name])
    assert corner_volumes(mesh).min() > 0
    middle = mesh.points_mm[mesh.cells].mean(axis=1)
    chip = (np.hypot(middle[:, 0], middle[:, 1]) < CHIP_RADIUS_MM) & (middle[:, 2] < taxel_shape.CHIP_MM)
    assert np.array_equal(chip, mesh.material == 0)
    assert np.array_equal(mesh.material == 2, middle[:, 2] > taxel_shape.CHIP_MM)
    assert len(np.unique(mesh.points_mm.round(9), axis=0)) == len(mesh.points_mm)


def uniform(mesh: TaxelMesh, gradient: FloatArray) -> FloatArray:
    return (mesh.points_mm @ gradient.T).ravel()


def test_volume_converges_to_that_of_the_taxel() -> None:
    cap = np.pi * taxel_shape.CAP_MM / 6 * (3 * taxel_shape.BUMP_RADIUS_MM**2 + taxel_shape.CAP_MM**2)
    rim = np.pi * taxel_shape.BUMP_RADIUS_MM**2 * taxel_shape.RIM_MM
    exact = CELL_MM**2 * (taxel_shape.CHIP_MM + taxel_shape.BASE_MM) + rim + cap
    errors = [abs(corner_volumes(taxel_mesh(MESHES[name])).mean(axis=1).sum() - exact) for name in MESHES]
    assert errors[2] < errors[1] < errors[0] < 0.004 * exact


def test_energy_of_uniform_strain_is_exact_and_of_rigid_motion_zero(coarse: TaxelMesh) -> None:
    matrix, rng = stiffness(coarse), np.random.default_rng(0)
    assert abs(matrix - matrix.T).max() < 1e-12
    turn = np.array([[0.0, 1.0, -2.0], [-1.0, 0.0, 3.0], [2.0, -3.0, 0.0]])
    shift = np.tile([1.0, -2.0, 0.5], len(coarse.points_mm))
    assert abs(matrix @ (uniform(coarse, turn) + shift)).max() < 1e-11
    gradient = rng.normal(size=(3, 3))
    strain = (gradient + gradient.T) / 2
    trace = np.trace(strain)
    deviator = strain - trace / 3 * np.eye(3)
    volume = np.bincount(coarse.material, gauss_volumes(coarse))
    density = [m.bulk_mpa * trace**2 + 2 * m.shear_mpa * np.sum(deviator**2) for m in MATERIALS]
    moved = uniform(coarse, gradient)
    assert moved @ (matrix @ moved) == pytest.approx(float(volume @ density), rel=1e-10)


def gauss_volumes(mesh: TaxelMesh) -> FloatArray:
    """Volume of each trilinear cell by the divergence theorem over its bilinear faces: exact."""
    faces = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    total = np.zeros(len(mesh.cells))
    for face in faces:
        a, b, c, d = (mesh.points_mm[mesh.cells[:, k]] for k in face)
        for u in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):
            for v in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):
                place = a * (1 - u) * (1 - v) + b * u * (1 - v) + c * u * v + d * (1 - u) * v
                along, across = (b - a) * (1 - v) + (c - d) * v, (d - a) * (1 - u) + (c - b) * u
                total += np.einsum("ci,ci->c", place, np.cross(along, across)) / 12
    return total


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


def test_the_shipped_compliance_is_that_of_the_mesh(
    coarse: TaxelMesh, shipped: dict[str, FloatArray]
) -> None:
    made = compliance_arrays(coarse)
    assert made.keys() == shipped.keys()
    for name, array in made.items():
        np.testing.assert_allclose(shipped[name], array, rtol=2e-6, atol=1e-6, err_msg=name)


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


@pytest.mark.parametrize("name", ["coarse", "medium"])
@pytest.mark.parametrize("beyond_mm", [0.0, 1.0])
def test_a_uniform_pressure_reads_out_as_area(name: str, beyond_mm: float) -> None:
    mesh = taxel_mesh(MESHES[name])
    points, faces = mesh.points_mm[mesh.bottom, :2], mesh.bottom_faces
    force = np.zeros(len(points))
    for u, v in np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(3):
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        shape = (1 + corners[:, 0] * u) * (1 + corners[:, 1] * v) / 4
        du, dv = corners[:, 0] * (1 + corners[:, 1] * v) / 4, corners[:, 1] * (1 + corners[:, 0] * u) / 4
        along = np.einsum("a,fai->fi", du, points[faces])
        across = np.einsum("a,fai->fi", dv, points[faces])
        area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
        np.add.at(force, faces, shape * area[:, None])
    radius = CHIP_RADIUS_MM
    angle = np.arccos(beyond_mm / radius)
    segment = radius**2 * (angle - np.sin(angle) * np.cos(angle))
    # Parts are cut out by samples, 16 along a cell of up to 0.3 mm: their outline is known to half of one.
    outline = 2 * radius * (np.sin(angle) + angle)
    np.testing.assert_allclose(
        read_out(mesh, side_parts(beyond_mm)) @ force, segment, atol=outline * 0.3 / 32
    )


@pytest.mark.parametrize("name", ["coarse", "medium"])
def test_weights_of_points_are_from_0_to_1(name: str) -> None:
    mesh = taxel_mesh(MESHES[name])
    left, _, right, _, whole = read_out(mesh, [*side_parts(0.0), lambda x, _: np.full(x.shape, True)])
    edges = read_out(mesh, side_parts(EDGE_MM))
    assert left.min() >= 0
    assert edges.min() >= 0
    np.testing.assert_allclose(left + right, whole, atol=1e-12)
    middle = np.hypot(*mesh.points_mm[mesh.bottom, :2].T) < taxel_shape.BUMP_RADIUS_MM
    np.testing.assert_allclose(whole[middle], 1.0)
    assert np.all(edges[0] <= left + 1e-12)


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

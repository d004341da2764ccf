"""Contact model compliance: equilibrium and Coulomb's law at every node, finite elements, extremes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from taxel_errors import LARGEST_ERRORS, replay
from taxel_runs import load_reference

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Surface, TaxelForces
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.skin import shipped_skin
from tactiled.emulator.mechanics.solver import ContactSolver
from tactiled.errors import ConfigError

AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])  # R1, R2, R3, R4
LOAD_N = 15.0 / 9


def at(x_mm: float, y_mm: float = 0.0) -> FloatArray:
    return np.array([[x_mm, y_mm]])


def press(model: Compliance, load_n: float, steps: int = 8) -> TaxelForces:
    for k in range(1, steps + 1):
        felt = model.step(np.array([load_n * k / steps]), at(0.0), 0.01)
    return felt


def test_indentation_agrees_with_finite_elements_up_to_27_n_on_the_array() -> None:
    """One constant for the stiffening of the skin, fitted to its drag while sliding under 2.5 N."""
    reference = load_reference("coarse", "load")
    seen = replay("compliance", reference)["indentation_mm"]
    loaded = reference.columns["normal_n"] < 3.0
    error = seen[loaded] / reference.columns["approach_mm"][loaded] - 1
    assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("run", ["flat-0.3", "flat-0.6", "flat-0.9"])
def test_a_flat_slide_agrees_with_finite_elements(run: str) -> None:
    reference = load_reference("coarse", run)
    seen = replay("compliance", reference)
    columns = reference.columns
    hold_n = reference.sides("half")[columns["travel_x_mm"] == 0][-1, 0]
    assert np.abs(seen["side_n"] - reference.sides("half")).max() < 0.05 * hold_n
    friction_n = reference.surface.friction * LOAD_N
    assert (
        np.abs(seen["tangential_n"][:, 0] - columns["tangential_x_n"]).max()
        < LARGEST_ERRORS["compliance"]["tangential-force"] * friction_n
    )
    # A ring of nodes slips at once, a fifth of the contact: at friction 0.3 the knee has five instants.
    knee = (columns["travel_x_mm"] > 0) & (columns["slipping"] < 1)
    share = np.abs(seen["slipping"] - columns["slipping"])[knee]
    assert share.max() < LARGEST_ERRORS["compliance"]["incipient-slip"]
    assert share.mean() < 0.1
    assert not seen["unsolved"]


friction = st.sampled_from([0.0, 1e-3, 0.3, 0.6, 1.0, 3.0, 1e6])
plate = st.builds(
    Surface,
    friction=friction,
    period_mm=st.sampled_from([0.2, 0.9, 1.5, 5.0]),
    angle_deg=st.floats(-90, 90),
    depth_mm=st.sampled_from([0.0, 0.05, 0.1, 0.6]),  # the last is deeper than the cap is high
)
moves = st.lists(
    st.tuples(
        st.sampled_from([0.0, 1e-6, 0.1, 1.667, 8.0]),
        st.sampled_from([0.0, 1e-5, 0.01, -0.01, -0.3]),
        st.sampled_from([0.0, 1e-3, 0.02]),
    ),
    min_size=1,
    max_size=5,
)


@given(plate, moves)
@settings(max_examples=15, deadline=None)
def test_any_plate_and_any_move_give_finite_forces_inside_coulombs_cone(
    surface: Surface, steps: list[tuple[float, float, float]]
) -> None:
    model = Compliance(surface, AZIMUTH, 1)
    place = at(0.0)
    for load_n, dx, dy in steps:
        place = place + np.array([[dx, dy]])
        unsolved = model.unsolved
        felt = model.step(np.array([load_n]), place, 0.01)
        assert all(np.isfinite(values).all() for values in vars(felt).values())
        if model.unsolved > unsolved:
            assert surface.friction > 1  # jammed between ridges
            continue
        assert felt.normal_n[0] == pytest.approx(load_n, rel=1e-5, abs=1e-9)
        assert (felt.side_n >= 0).all()
        assert 0 <= felt.slipping[0] <= 1
        if surface.depth_mm == 0:
            limit = surface.friction * load_n
            assert np.hypot(*felt.tangential_n[0]) <= limit * (1 + 1e-4) + 1e-7
        if load_n == 0:
            assert not felt.tangential_n.any()


def test_the_laws_hold_at_every_node() -> None:
    skin = shipped_skin()
    n = len(skin.x_mm)
    mu, frame = 0.6, np.zeros((3, 3, n))
    frame[0, 0] = frame[1, 1] = frame[2, 2] = 1.0
    free = np.stack([skin.gap_mm, np.full(n, 0.05), np.full(n, -0.02)])
    solution = ContactSolver(skin.compliance, mu).solve(frame, free, np.zeros((3, n)), 1.0)
    assert solution.converged
    moved = (skin.compliance.reshape(3 * n, 3 * n) @ solution.force_n.ravel()).reshape(3, n)
    gap = free[0] + moved[0] - solution.approach_mm
    slip, p, t = free[1:] + moved[1:], solution.force_n[0], solution.force_n[1:]
    tolerance = 1e-6
    assert gap.min() > -tolerance
    assert p.min() >= -tolerance
    assert np.abs(gap * p).max() < tolerance
    assert p.sum() == pytest.approx(1.0, abs=tolerance)
    size, speed = np.hypot(*t), np.hypot(*slip)
    assert (size <= mu * p + tolerance).all()
    sticks = size < mu * p - 1e-5
    assert sticks.any()
    assert solution.slips.any()
    assert speed[sticks].max() < tolerance
    power = (t * slip).sum(axis=0)  # friction opposes slip where there is any
    assert np.abs(power + size * speed).max() < tolerance


def test_a_mirrored_slide_gives_mirrored_forces() -> None:
    felt = []
    for sign in (1, -1):
        model = Compliance(Surface(0.6, 1.2, 0.0, 0.1), AZIMUTH, 1, "half")
        press(model, LOAD_N)
        felt.append([model.step(np.array([LOAD_N]), at(sign * 0.02 * k), 0.01) for k in range(1, 31)])
    for there, back in zip(*felt, strict=True):
        np.testing.assert_allclose(there.side_n[0, [0, 2]], back.side_n[0, [2, 0]], atol=3e-4)
        np.testing.assert_allclose(there.tangential_n[0, 0], -back.tangential_n[0, 0], atol=3e-4)


@pytest.mark.parametrize("depth_mm", [0.0, 0.1])
def test_finer_steps_converge(depth_mm: float) -> None:
    """Steps of 10 ms, 2 ms and 0.4 ms at 3 mm/s; the finest stands for the truth."""
    ends = []
    for count in (10, 50, 250):
        model = Compliance(Surface(0.6, 1.2, 20.0, depth_mm), AZIMUTH, 1)
        press(model, LOAD_N)
        for k in range(1, count + 1):
            felt = model.step(np.array([LOAD_N]), at(0.3 * k / count), 0.1 / count)
        ends.append(np.concatenate([felt.side_n[0], felt.tangential_n[0]]))
    coarse, fine = np.abs(ends[0] - ends[2]).max(), np.abs(ends[1] - ends[2]).max()
    assert coarse < 0.02  # newtons, of 1 N of friction
    assert fine <= coarse


def test_microsecond_steps_and_standstill_change_nothing() -> None:
    model = Compliance(Surface(0.6, 1.2, 0.0, 0.1), AZIMUTH, 2)
    load, place = np.full(2, LOAD_N), np.zeros((2, 2))
    before = model.step(load, place, 0.01)
    for k in range(1, 101):
        after = model.step(load, place + 1e-8 * k, 1e-5)
    np.testing.assert_allclose(after.side_n, before.side_n, atol=1e-4)
    still = model.step(load, place + 1e-6, 1e-5)
    np.testing.assert_array_equal(still.side_n, after.side_n)


def test_a_jump_over_many_periods_takes_bounded_work_and_ends_sliding() -> None:
    model = Compliance(Surface(0.6, 0.9, 0.0, 0.1), AZIMUTH, 1)
    press(model, LOAD_N)
    far = model.step(np.array([LOAD_N]), at(1000.0), 0.01)
    near = Compliance(Surface(0.6, 0.9, 0.0, 0.1), AZIMUTH, 1)
    press(near, LOAD_N)
    for k in range(1, 101):
        slow = near.step(np.array([LOAD_N]), at(1000.0 % 0.9 + 0.9 * (k / 100 - 1)), 0.01)
    np.testing.assert_allclose(far.side_n, slow.side_n, atol=5e-3)


def test_contact_after_a_loss_has_no_history() -> None:
    surface = Surface(0.6)
    model = Compliance(surface, AZIMUTH, 1)
    press(model, LOAD_N)
    for k in range(1, 21):
        model.step(np.array([LOAD_N]), at(0.02 * k), 0.01)
    lifted = model.step(np.array([0.0]), at(0.4), 0.01)
    assert not lifted.side_n.any()
    assert not lifted.tangential_n.any()
    again = model.step(np.array([LOAD_N]), at(0.4), 0.01)
    fresh = Compliance(surface, AZIMUTH, 1).step(np.array([LOAD_N]), at(0.0), 0.01)
    np.testing.assert_allclose(again.side_n, fresh.side_n, atol=1e-6)


def test_reset_is_new() -> None:
    model = Compliance(Surface(0.6), AZIMUTH, 1)
    first = press(model, LOAD_N)
    model.step(np.array([LOAD_N]), at(0.3), 0.01)
    model.reset()
    np.testing.assert_array_equal(press(model, LOAD_N).side_n, first.side_n)


def test_static_friction_is_refused() -> None:
    with pytest.raises(ConfigError, match="static_ratio"):
        Compliance(Surface(0.6, static_ratio=1.2), AZIMUTH, 1)

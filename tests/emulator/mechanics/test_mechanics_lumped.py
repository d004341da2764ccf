"""Contact model lumped: laws of dry friction, and finite elements as the reference."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Readout, Surface, TaxelForces
from tactiled.emulator.mechanics.lumped import Lumped, indentation_mm, load_n
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.truth import Truth
from tactiled.resources import shipped

SIDES = np.array([180.0, 270.0, 0.0, 90.0])  # R1 to R4 of the shipped array
HOLD_N = 1.667
DT_S = 2.5e-3
ComplexArray = NDArray[np.complexfloating]


def run(
    surface: Surface,
    travel_mm: ComplexArray,
    value: FloatArray | float = HOLD_N,
    dt_s: float = DT_S,
    readout: Readout = "edge",
) -> TaxelForces:
    """One taxel along a path of complex x + iy."""
    base = np.stack([travel_mm.real, travel_mm.imag], axis=-1)[:, None].astype(np.float64)
    values = np.broadcast_to(np.asarray(value, dtype=float), travel_mm.shape)[:, None]
    return Lumped(surface, SIDES, 1, readout).run(values, base, dt_s)


def line(end_mm: float, n: int = 200, direction_deg: float = 0.0) -> ComplexArray:
    return np.asarray(np.linspace(0, end_mm, n) * np.exp(1j * np.deg2rad(direction_deg)))


def finite_elements(name: str) -> dict[str, FloatArray]:
    document = json.loads(shipped("config", "contact", f"fem-coarse-{name}.json").read_text())
    return {key: np.array(column) for key, column in document["columns"].items()}


@pytest.mark.parametrize(
    ("run_name", "friction"),
    [
        ("flat-0.3", 0.3),
        ("flat-0.6", 0.6),
        ("flat-0.9", 0.9),
        ("flat-0.6-light", 0.6),
        ("flat-0.6-heavy", 0.6),
    ],
)
def test_sides_and_friction_follow_finite_elements(run_name: str, friction: float) -> None:
    # Only light and heavy were fitted. Half chips; the aim is 5 % of the hold force.
    fem = finite_elements(run_name)
    first = int(np.argmax(fem["travel_x_mm"] > 0)) - 1
    # Twenty steps from one increment of the finite elements to the next, compared where they are.
    instants = fem["travel_x_mm"][first:]
    travel = np.linspace(0, instants[-1], 20 * (len(instants) - 1) + 1)
    np.testing.assert_allclose(travel[::20], instants, atol=1e-6)
    load_n = float(fem["normal_n"][first])
    felt = run(Surface(friction), travel + 0j, load_n, readout="half")

    hold_n = fem["half_0_n"][first]
    for side in (0, 2):
        assert np.abs(felt.side_n[::20, 0, side] - fem[f"half_{side}_n"][first:]).max() < 0.05 * hold_n
    pull = felt.tangential_n[::20, 0, 0] - fem["tangential_x_n"][first:]
    assert np.abs(pull).max() < 0.02 * friction * load_n
    assert np.sqrt(np.mean((felt.slipping[::20, 0] - fem["slipping"][first:]) ** 2)) < 0.08


def test_load_curve_follows_finite_elements() -> None:
    fem = finite_elements("load")
    used = (fem["normal_n"] > 0.3) & (fem["normal_n"] < 2.3)  # up to 20 N on nine taxels
    np.testing.assert_allclose(load_n(fem["approach_mm"][used]), fem["normal_n"][used], rtol=0.075)
    np.testing.assert_allclose(indentation_mm(load_n(fem["approach_mm"])), fem["approach_mm"])


def test_edge_areas_change_by_their_whole_force() -> None:
    felt = run(Surface(0.6), line(1.0))
    r1, r2, r3, r4 = (felt.side_n[-1, 0] / felt.side_n[0, 0] - 1).tolist()
    assert r1 > 0.95
    assert r3 == -1.0
    assert abs(r2) < 0.01
    assert abs(r4) < 0.01


@given(st.floats(-180, 180), st.floats(0.05, 1.5))
@settings(max_examples=20, deadline=None)
def test_friction_opposes_a_slide_in_any_direction(direction_deg: float, friction: float) -> None:
    felt = run(Surface(friction), line(2.0, direction_deg=direction_deg), readout="half")
    toward = np.exp(1j * np.deg2rad(direction_deg))
    x, y = felt.tangential_n[-1, 0]
    assert complex(x, y) == pytest.approx(-friction * HOLD_N * toward, rel=1e-6, abs=1e-9)
    assert felt.slipping[-1, 0] == 1.0


@given(
    st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0, 4)), min_size=2, max_size=30)
)
@settings(max_examples=30, deadline=None)
def test_friction_stays_within_its_cone(path: list[tuple[float, float, float]]) -> None:
    steps = np.array(path)
    felt = run(Surface(0.7), np.cumsum(steps[:, 0] + 1j * steps[:, 1]), steps[:, 2])
    size = np.linalg.norm(felt.tangential_n[:, 0], axis=-1)
    assert np.all(size <= 0.7 * felt.normal_n[:, 0] * (1 + 1e-9) + 1e-9)
    for name, rows in vars(felt).items():
        assert np.isfinite(rows).all(), name
    assert np.all((felt.slipping >= 0) & (felt.slipping <= 1))
    assert np.all(felt.side_n >= 0)


@given(st.floats(0.0, 0.95), st.floats(0.1, 1.0), st.floats(0.05, 3.0))
@settings(max_examples=10, deadline=None)
def test_a_load_within_the_friction_cone_makes_nothing_slip(
    part: float, friction: float, end_n: float
) -> None:
    """Mindlin and Deresiewicz 1953: none slips while the friction force grows by less than mu dN."""
    surface, skin = Surface(friction), Lumped(Surface(friction), SIDES, 1)
    load = np.linspace(0.0, end_n, 60)
    place = 0.0
    for before, now in itertools.pairwise(load):
        # The stiffness that a small step back and forth shows.
        probe = run(surface, np.array([0.0, 1e-9]) + 0j, 0.5 * (before + now))
        stiffness = -probe.tangential_n[1, 0, 0] / 1e-9
        place += part * friction * (now - before) / stiffness
        felt = skin.step(np.array([now]), np.array([[place, 0.0]]), DT_S)
        assert felt.slipping[0] == 0.0
    assert -felt.tangential_n[0, 0] == pytest.approx(part * friction * end_n, rel=0.05, abs=1e-6)


def test_a_held_load_that_comes_obliquely_does_not_slip() -> None:
    """The whole way through a scene; friction 0.6 bears up to 31 degrees."""
    load = {"kind": "load", "duration_s": 2.0, "force_n": 15.0, "direction_deg": 45.0}
    load |= {"tangential_n": 15.0 * np.tan(np.deg2rad(28.0))}
    truth = Truth(load_scene("inclined-load").with_changes(contact="mechanics", phases=[load]))
    assert truth.state(np.arange(0.1, 2.0, 0.01)).slipping_share.max() < 0.1


def test_vibration_below_the_limit_gives_closed_loops() -> None:
    # Dahl's and LuGre's laws creep here. A shear of half the limit, then thousands of cycles of 5 um.
    cycles = 0.06 + 0.005 * np.sin(2 * np.pi * np.arange(30_000) / 10)
    felt = run(Surface(0.6), np.concatenate([line(0.06), cycles]))
    cycle = felt.tangential_n[200:, 0, 0].reshape(-1, 10)
    np.testing.assert_allclose(cycle[-1], cycle[1], atol=1e-12)


def test_hundreds_of_thousands_of_steps_do_not_drift() -> None:
    steps = 300_000
    skin = Lumped(Surface(0.6), SIDES, 1)
    value, base = np.full((10_000, 1), HOLD_N), np.zeros((10_000, 1, 2))
    base[:, 0, 0] = 0.1 * np.sin(2 * np.pi * np.arange(10_000) / 1000)
    first = skin.run(value, base, DT_S)
    for _ in range(steps // 10_000 - 1):
        last = skin.run(value, base, DT_S)
    np.testing.assert_allclose(last.tangential_n[-1000:], first.tangential_n[-1000:], atol=1e-9)


def test_results_converge_in_the_step() -> None:
    # 0.4 s of a slide that turns while the load falls; steps of 10 ms down to 10 us.
    def end(dt_s: float) -> FloatArray:
        time_s = np.arange(0, 0.4 + dt_s / 2, dt_s)
        path = 1.0 * time_s * np.exp(2j * time_s)
        felt = run(Surface(0.6), path, 2.0 - 2.0 * time_s, dt_s=dt_s)
        return np.concatenate([felt.tangential_n[-1, 0], felt.side_n[-1, 0], felt.normal_n[-1]])

    finest = end(1e-5)
    errors = [float(np.abs(end(dt_s) - finest).max()) for dt_s in (1e-2, 1e-3, 1e-4)]
    assert errors[0] < 0.01
    assert errors[2] < errors[1] < errors[0]


def test_contact_lost_and_regained_within_a_step_has_no_history() -> None:
    load = np.array([HOLD_N] * 50 + [0.0] + [HOLD_N] * 2)
    way = np.concatenate([line(0.5, 50), [0.5, 0.5, 0.5]])
    felt = run(Surface(0.6), way, load)
    assert abs(felt.tangential_n[49, 0, 0]) > 0.99
    np.testing.assert_array_equal(felt.tangential_n[50:], 0.0)
    assert felt.normal_n[51, 0] == HOLD_N
    assert felt.slipping[50, 0] == 0.0


def test_extremes_of_friction_and_load() -> None:
    np.testing.assert_array_equal(run(Surface(0.0), line(1.0)).tangential_n, 0.0)
    stuck = run(Surface(1e6), line(0.2))
    assert stuck.slipping.max() == 0.0
    assert np.isfinite(stuck.tangential_n).all()
    nothing = run(Surface(0.6), line(1.0), 0.0)
    assert not any(rows.any() for rows in vars(nothing).values())
    least = run(Surface(0.6), line(1.0), 1e-9)
    assert least.normal_n[-1, 0] == 1e-9
    assert -least.tangential_n[-1, 0, 0] == pytest.approx(6e-10)
    deep = run(Surface(0.6), line(1.0), 20.0)
    assert np.isfinite(deep.side_n).all()


def test_rest_sticks_and_a_reversal_passes_through_sticking() -> None:
    way = np.concatenate([line(0.6), np.full(5, 0.6), 0.6 - line(0.7)])
    felt = run(Surface(0.6), way)
    assert felt.slipping[199, 0] == 1.0
    np.testing.assert_array_equal(felt.slipping[200:206, 0], 0.0)
    np.testing.assert_allclose(felt.tangential_n[199:206, 0, 0], felt.tangential_n[199, 0, 0])
    assert felt.tangential_n[-1, 0, 0] == pytest.approx(0.6 * HOLD_N)


def test_masing_a_reversal_takes_twice_the_travel() -> None:
    slid = 1.0 - line(1.0, 2001)
    felt = run(Surface(0.6), np.concatenate([line(1.0, 2001), slid]))
    first = np.argmax(felt.tangential_n[:, 0, 0] < -0.5 * 0.6 * HOLD_N)  # half of the way to the limit
    back = np.argmax(felt.tangential_n[2001:, 0, 0] > 0)  # half of the way to the other
    assert back == pytest.approx(2 * first, abs=3)


def test_friction_falls_from_rest_to_motion() -> None:
    surface = Surface(0.5, static_ratio=1.4, stribeck_mm_s=2.0)

    def slid(speed_mm_s: float) -> float:
        felt = run(surface, line(1.0), dt_s=1.0 / 199 / speed_mm_s)
        return float(-felt.tangential_n[-1, 0, 0] / HOLD_N)

    assert slid(0.01) == pytest.approx(0.7, rel=1e-3)
    assert slid(2.0) == pytest.approx(0.5 * (1 + 0.4 / np.e), rel=1e-6)
    assert slid(100.0) == pytest.approx(0.5)


def test_single_steps_equal_steps_at_once() -> None:
    rng = np.random.default_rng(1)
    value, base = rng.uniform(0, 3, (40, 9)), rng.normal(0, 0.1, (40, 9, 2)).cumsum(axis=0)
    together = Lumped(Surface(0.6), SIDES, 9).run(value, base, DT_S)
    single = Lumped(Surface(0.6), SIDES, 9)
    for k in range(40):
        felt = single.step(value[k], base[k], DT_S)
        for name, rows in vars(felt).items():
            np.testing.assert_allclose(rows, vars(together)[name][k], rtol=1e-12, atol=1e-12, err_msg=name)


def test_reset_is_new() -> None:
    skin = Lumped(Surface(0.6), SIDES, 1)
    value, base = np.full((50, 1), HOLD_N), np.zeros((50, 1, 2))
    base[:, 0, 0] = np.linspace(1.0, 1.2, 50)
    first = skin.run(value, base, DT_S)
    skin.reset()
    again = skin.run(value, base, DT_S)
    for name, rows in vars(first).items():
        np.testing.assert_array_equal(rows, vars(again)[name])

"""Plausibility of the random worlds of every generator."""

import numpy as np
import pytest

from bench.worlds.generators import GENERATORS, draw
from bench.worlds.sensors import Drawn, Forces, measure, runs
from bench.worlds.shapes import MovingLoads, draw_table
from bench.worlds.world import World, onsets

NEW = [name for name in GENERATORS if name != "laws"]


@pytest.fixture(scope="module")
def grasps() -> list[World]:
    return draw("grasps", range(16))


# Number of worlds, minutes: most generators play them together, plates one by one.
_SIZES = {"bristles": (14, 0.14), "sheet": (14, 0.14), "plates": (3, 0.12)}


@pytest.fixture(scope="module", params=NEW)
def worlds(request: pytest.FixtureRequest) -> list[World]:
    if request.param == "grasps":
        return list(request.getfixturevalue("grasps"))
    n, minutes = _SIZES.get(request.param, (8, 0.1))
    return draw(request.param, range(n), minutes)


@pytest.fixture(scope="module", params=["bristles", "sheet"])
def held(request: pytest.FixtureRequest) -> list[World]:
    """Worlds of hands that hold, near the limit and far from it."""
    return draw(request.param, range(8), 0.1, ("near-limit", "low"))


@pytest.mark.parametrize("generator", GENERATORS)
def test_a_seed_draws_the_same_bits_alone_and_in_a_batch(generator: str, grasps: list[World]) -> None:
    batch = grasps[-2:] if generator == "grasps" else draw(generator, range(40, 42), 0.05)
    alone = draw(generator, range(batch[1].seed, batch[1].seed + 1), 0.05)[0]
    assert batch[1].seed == batch[0].seed + 1
    for name in (
        "utilisation",
        "gross",
        "friction",
        "load",
        "touching",
        "direction_deg",
        "acceleration_m_s2",
    ):
        np.testing.assert_array_equal(getattr(batch[1], name), getattr(alone, name))
    np.testing.assert_array_equal(batch[1].block.volts, alone.block.volts)
    assert not np.array_equal(batch[0].block.volts[:50], alone.block.volts[:50])


def test_readings_are_finite_and_never_saturate(worlds: list[World]) -> None:
    for world in worlds:
        assert world.array.in_range(world.block.volts).all()
        assert world.block.volts.shape == (len(world.gross), world.array.n_channels)
        for truth in (world.utilisation, world.friction, world.load, world.touching, world.direction_deg):
            assert len(truth) == len(world.gross)
        assert np.isfinite(world.friction[world.touching]).all()
        assert (world.load[world.touching] > 0).all()


def test_shear_stays_within_its_limit_and_slides_are_at_it(worlds: list[World]) -> None:
    for world in worlds:
        assert world.utilisation.min() >= 0
        assert world.utilisation.max() <= 1 + 1e-6
        assert not (world.gross & ~world.touching).any()
    sliding = np.concatenate([world.utilisation[world.gross] for world in worlds])
    # Rests of at most 40 ms within a slide count as sliding; ridges and bumps make them.
    assert np.quantile(sliding, 0.01) > 0.93
    assert np.median(sliding) > 0.97


def test_a_gross_slip_begins_where_it_is_said_to_and_after_a_tenth_slipped(worlds: list[World]) -> None:
    for world in worlds:
        said_s = np.array(world.gross_s)
        begins_s = onsets(world.gross) / world.rate_hz
        assert len(begins_s) <= len(said_s)  # short ones may fall between scans
        for begin_s in begins_s:
            assert np.abs(said_s - begin_s).min() <= 1.5 / world.rate_hz
        assert (np.array(world.tenth_s) <= said_s).all()


def test_readings_agree_with_the_truth_of_a_slide(worlds: list[World]) -> None:
    errors = []
    for world in worlds:
        # In the middle of pads under most of their load, so that neither noise nor drift of the zero matter.
        chosen = world.gross & (world.load > 0.5 * np.quantile(world.load, 0.9))
        shear = (world.array.shear_weights() @ world.block.volts[chosen].T).sum(axis=1)
        load = (world.array.normal_weights() @ world.block.volts[chosen].T).sum(axis=0)
        if world.hand not in ("twist", "reverse"):
            errors += list(np.hypot(*shear) / load / world.friction[chosen])
    assert 0.75 < np.median(errors) < 1.25


def test_there_are_slides_and_rests(worlds: list[World]) -> None:
    share = float(np.mean([world.gross.mean() for world in worlds]))
    assert 0.01 < share < 0.35
    assert 0.2 < np.mean([world.slips for world in worlds]) < 0.9


def test_a_rest_near_the_limit_never_slides_and_a_low_hand_stays_far_from_it(held: list[World]) -> None:
    near = [world for world in held if world.hand == "near-limit"]
    low = [world for world in held if world.hand == "low"]
    assert min(len(near), len(low)) >= 3
    for world in near:  # it may slip for a moment while the pull comes
        assert not world.gross[-round(world.rate_hz) :].any()
        assert world.gross.mean() < 0.1
        assert 0.6 < world.utilisation[-1] < 0.99
    for world in low:
        holds = world.touching & (world.load > 0.5 * np.quantile(world.load, 0.9))
        assert np.quantile(world.utilisation[holds], 0.99) < 0.6


def test_strokes_slide_by_hands_that_move_and_rest_by_the_others() -> None:
    moves = draw("strokes", range(8), 0.2, ("stroke", "strokes", "grooves"))
    assert np.mean([world.slips for world in moves]) > 0.7
    rests = draw("strokes", range(12), 0.2, ("rest-near-limit", "swing", "press"))
    assert not any(world.slips for world in rests)
    near = [world.utilisation[-1] for world in rests if world.hand == "rest-near-limit"]
    assert 0.25 < min(near) < max(near) < 0.99
    usual = draw("strokes", range(40), 0.2)
    assert 0.25 < np.mean([world.slips for world in usual]) < 0.6


def test_grasps_slip_about_half_and_rest_where_the_grip_bears_all(grasps: list[World]) -> None:
    assert 0.35 < np.mean([world.slips for world in grasps]) < 0.7
    assert all(len(world.gross) <= 700 for world in grasps)
    # An object that was let fall is no more in the log.
    assert all(world.gross[-1] for world in grasps if len(world.gross) < 700)
    rests = draw("grasps", range(16), hands=("rest",))
    assert np.mean([world.slips for world in rests]) < 0.1
    largest = np.array([world.utilisation[-1] for world in rests])
    assert largest.min() < 0.5 < 0.75 < largest.max()


def test_readings_of_grasps_tell_the_friction_that_they_are_said_to(grasps: list[World]) -> None:
    for world in grasps[:12]:
        tells = (world.utilisation > 0.4) & (world.load > 1.0)
        shear = (world.array.shear_weights() @ world.block.volts[tells].T).sum(axis=1)
        load = (world.array.normal_weights() @ world.block.volts[tells].T).sum(axis=0)
        used = np.hypot(*shear) / load / world.friction[tells]
        assert np.median(np.abs(used - world.utilisation[tells])) < 0.03
        turned = np.degrees(np.arctan2(shear[1], shear[0])) - world.direction_deg[tells]
        assert np.median(np.abs((turned + 180) % 360 - 180)) < 8


def test_an_ideal_sensor_reads_the_forces_and_nothing_else() -> None:
    n, rng = 400, np.random.default_rng(1)
    load = np.linspace(0.0, 1.0, n)[:, None] * np.arange(1, 10)
    shear = np.stack([0.3 * load, -0.1 * load], axis=1)
    forces = Forces(
        step_s=0.004,
        load=load,
        shear=shear,
        utilisation=np.zeros(n),
        slides=np.zeros(n, dtype=np.bool_),
        limit=load.sum(axis=1),
        touching=np.ones(n, dtype=np.bool_),
        acceleration_m_s2=np.zeros(n),
        usual_n=45.0,
        static_friction=1.0,
    )
    world = measure(Drawn("strokes", "press", 0, 3, 4.0, rng, is_ideal=True), forces)
    last = world.block.volts[-20:].mean(axis=0)
    loads, shears = world.array.normal_weights() @ last, world.array.shear_weights() @ last
    np.testing.assert_allclose(loads / loads.sum(), np.arange(1, 10) / 45, atol=2e-3)
    np.testing.assert_allclose(
        np.hypot(*shears) / loads, np.hypot(0.3, 0.1) * world.static_friction, rtol=0.03
    )


@pytest.mark.parametrize("towards", [None, 0.7])
@pytest.mark.parametrize("shape", ["flat", "sphere", "cylinder", "edge", "rib", "bumps"])
def test_pressures_add_up_to_the_load_wherever_the_object_moves(shape: str, towards: float | None) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-5, 5, 12), np.linspace(-5, 5, 12)))
    table = draw_table(np.random.default_rng(3), shape, x, y, towards)
    light, heavy = table.at(0.1 * table.usual_n), table.at(2.0 * table.usual_n)
    assert light.sum() == pytest.approx(0.1 * table.usual_n)
    assert heavy.sum() == pytest.approx(2.0 * table.usual_n)
    assert (light >= 0).all()
    assert (heavy > 0).sum() >= (light > 0).sum()
    moving = MovingLoads([table, table])
    np.testing.assert_allclose(moving.at(np.array([0.1, 2.0]), np.zeros(2)), np.stack([light, heavy]))
    for way_mm in (-30.0, -1.3, 0.4, 5.0):
        found = moving.at(np.array([0.1, 2.0]), np.full(2, way_mm))
        np.testing.assert_allclose(found.sum(axis=1), table.usual_n * np.array([0.1, 2.0]))


@pytest.mark.parametrize("axis", [0, 1])
def test_pressures_go_along_with_an_object_that_moves(axis: int) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-5, 5, 21), np.linspace(-5, 5, 21)))
    ball = MovingLoads([draw_table(np.random.default_rng(3), "sphere", x, y, axis * np.pi / 2)])
    along = (x, y)[axis]
    centres = [
        float((ball.at(np.ones(1), np.array([way_mm]))[0] * along).sum()) for way_mm in (-1.25, 0.0, 1.25)
    ]
    centres = [centre / float(ball.at(np.ones(1), np.zeros(1)).sum()) for centre in centres]
    assert 0.5 < centres[1] - centres[0] < 1.25
    assert 0.5 < centres[2] - centres[1] < 1.25


def test_pressures_turn_with_an_object_that_turns() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-5, 5, 41), np.linspace(-5, 5, 41)))
    inside = np.hypot(x, y) < 5  # a square would pull the axes to its own
    x, y = x[inside], y[inside]
    rib = MovingLoads([draw_table(np.random.default_rng(3), "rib", x, y, None)])
    turned = []
    for turn in (0.0, 0.2):
        load = rib.at(np.ones(1), np.array([turn * float(np.hypot(x, y).mean())]))[0]
        dx, dy = x - (load @ x) / load.sum(), y - (load @ y) / load.sum()
        turned.append(0.5 * np.arctan2(2 * (load @ (dx * dy)), load @ (dx**2) - load @ (dy**2)))
    assert turned[1] - turned[0] == pytest.approx(0.2, abs=0.03)


def test_short_runs_are_joined_to_what_is_around_them() -> None:
    flags = np.array([0, 1, 0, 1, 1, 1, 0, 1, 1, 1, 0, 0], dtype=np.bool_)
    np.testing.assert_array_equal(np.flatnonzero(runs(flags, 2)), [3, 4, 5, 7, 8, 9])
    np.testing.assert_array_equal(np.flatnonzero(runs(runs(flags, 2), 2, of=False)), [3, 4, 5, 6, 7, 8, 9])

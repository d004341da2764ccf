"""Plausibility of the random worlds of every generator."""

import numpy as np
import pytest

from bench.worlds.generators import GENERATORS, draw
from bench.worlds.sensors import runs
from bench.worlds.shapes import draw_table
from bench.worlds.world import World

NEW = [name for name in GENERATORS if name != "laws"]
_MINUTES = 0.35


@pytest.fixture(scope="module", params=NEW)
def worlds(request: pytest.FixtureRequest) -> list[World]:
    return draw(request.param, range(16), _MINUTES)


@pytest.mark.parametrize("generator", GENERATORS)
def test_a_seed_draws_the_same_bits_alone_and_in_a_batch(generator: str) -> None:
    batch = draw(generator, range(40, 43), 0.1)
    alone = draw(generator, range(41, 42), 0.1)[0]
    assert [world.seed for world in batch] == [40, 41, 42]
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
    assert not np.array_equal(batch[0].block.volts[:50], batch[2].block.volts[:50])


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
    slips = sum(len(world.gross_s) for world in worlds) / (_MINUTES * len(worlds))
    print(f"{worlds[0].generator}: {100 * share:.1f} % of the time slides, {slips:.1f} slips a minute")
    assert 0.01 < share < 0.35
    assert 0.2 < np.mean([world.slips for world in worlds]) < 0.9


@pytest.mark.parametrize("generator", NEW)
def test_a_rest_near_the_limit_never_slides(generator: str) -> None:
    for world in draw(generator, range(6), 0.2, ("near-limit",)):
        assert not world.gross.any()
        assert 0.6 < world.utilisation[-1] < 0.99


@pytest.mark.parametrize("generator", NEW)
def test_low_hands_stay_far_from_the_limit_while_they_hold(generator: str) -> None:
    for world in draw(generator, range(4), 0.2, ("low",)):
        holds = world.touching & (world.load > 0.5 * np.quantile(world.load, 0.9))
        assert np.quantile(world.utilisation[holds], 0.99) < 0.6


@pytest.mark.parametrize("shape", ["flat", "sphere", "cylinder", "edge", "rib", "bumps"])
def test_pressures_add_up_to_the_load(shape: str) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-5, 5, 12), np.linspace(-5, 5, 12)))
    table = draw_table(np.random.default_rng(3), shape, x, y)
    light, heavy = table.at(0.1 * table.usual_n), table.at(2.0 * table.usual_n)
    assert light.sum() == pytest.approx(0.1 * table.usual_n)
    assert heavy.sum() == pytest.approx(2.0 * table.usual_n)
    assert (light >= 0).all()
    assert (heavy > 0).sum() >= (light > 0).sum()


def test_short_runs_are_joined_to_what_is_around_them() -> None:
    flags = np.array([0, 1, 0, 1, 1, 1, 0, 1, 1, 1, 0, 0], dtype=np.bool_)
    np.testing.assert_array_equal(np.flatnonzero(runs(flags, 2)), [3, 4, 5, 7, 8, 9])
    np.testing.assert_array_equal(np.flatnonzero(runs(runs(flags, 2), 2, of=False)), [3, 4, 5, 6, 7, 8, 9])

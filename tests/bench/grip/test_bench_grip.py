"""Worlds and scores of the grip bench against what is known of them."""

import numpy as np
import pytest

from bench.grip.ablation import ABLATIONS, without
from bench.grip.bench import AIMS, GripFound
from bench.grip.bound import PRIOR_SD, shares, utilisation_sd
from bench.grip.cost import SHIPPED, ScanCost, cost_rows
from bench.grip.hands import count_reports
from bench.grip.score import (
    GripRecord,
    alarms,
    forecast,
    gross_told,
    margin,
    rests_called_gross,
    tell,
    warned,
)
from bench.worlds.laws import HANDS, LAWS, USUAL, Population, draw_worlds
from bench.worlds.world import World
from tactiled.detect.grip.detector import GripParams


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return draw_worlds(range(20_000, 20_012))


def test_worlds_are_repeatable_and_differ(worlds: list[World]) -> None:
    again = draw_worlds(range(20_003, 20_004))[0]
    np.testing.assert_array_equal(again.utilisation, worlds[3].utilisation)
    np.testing.assert_array_equal(again.block.volts, worlds[3].block.volts)
    assert len({world.law for world in worlds}) > 2
    assert len({world.hand for world in worlds}) > 3
    assert {world.law for world in worlds} <= set(LAWS)
    assert {world.hand for world in worlds} <= set(HANDS)


def test_truth_stays_within_physics(worlds: list[World]) -> None:
    for world in worlds:
        assert len(world.utilisation) == len(world.block) == len(world.gross)
        assert np.all((world.utilisation >= 0) & (world.utilisation <= 1.0 + 1e-6))
        assert np.isfinite(world.block.volts).all()
        assert all(0 < gross_s < USUAL.duration_s for gross_s in world.gross_s)
        assert all(a <= b for a, b in zip(world.tenth_s, world.gross_s, strict=True))
        assert world.gross.any() == world.slips or world.gross_s[-1] > USUAL.duration_s - 0.1
    assert any(world.slips for world in worlds)
    assert not all(world.slips for world in worlds)


def test_other_arrays_and_rates_are_drawn_alike() -> None:
    few = draw_worlds(range(20_000, 20_002), Population(side=2, rates_hz=(1000.0,)))
    for world in few:
        assert world.array.n_taxels == 4
        assert world.block.volts.shape == (len(world.utilisation), world.array.n_channels)
        assert len(world.block) == pytest.approx(8000, abs=2)


def perfect(world: World) -> GripRecord:
    """Events that say the truth and foresee it."""
    n = len(world.block)
    time_s = np.arange(n) / world.rate_hz
    begins = np.array([*world.gross_s, np.inf])
    lead = begins[np.searchsorted(begins, time_s)] - time_s
    within = np.stack([lead <= horizon_s for horizon_s in (0.05, 0.1, 0.3)], axis=1)
    used = np.minimum(world.utilisation, 1.0)
    return GripRecord(
        world=world,
        time_s=time_s,
        utilisation=used,
        quantiles=np.stack([used, used, used], axis=1),
        p_gross=within.astype(np.float64),
        gross=world.gross,
        told_gross=world.gross,
        within=within,
        p_bound=within.astype(np.float64),
    )


def test_scores_of_the_truth_are_perfect(worlds: list[World]) -> None:
    told = [perfect(world) for world in worlds]
    for horizon in range(3):
        found = forecast(told, horizon)
        assert found.brier_skill == pytest.approx(1.0)
        assert found.calibration_error == pytest.approx(0.0)
    assert margin(told) == (0.0, 0.0, 1.0)
    seen = warned(told, 0.5)
    assert all(seen.ahead)
    assert seen.time_in_alarm == 0
    assert all(gross_told(told, 0.1))
    assert not any(rests_called_gross(told))


def test_a_constant_probability_has_no_skill(worlds: list[World]) -> None:
    told = [perfect(world) for world in worlds]
    hours = sum(float(t.calm.sum()) / t.world.rate_hz for t in told)
    rate = sum(float(t.within[t.calm, 2].sum()) / t.world.rate_hz for t in told) / hours
    for t in told:
        t.p_gross[:] = rate
    assert forecast(told, 2).brier_skill == pytest.approx(0.0, abs=1e-9)


def test_parts_are_taken_out_and_put_back(worlds: list[World]) -> None:
    def utilisation() -> list[float]:
        return [float(v) for v in tell(worlds[0], GripParams()).quantiles[-1]]

    whole = utilisation()
    for part in ABLATIONS:
        with without(part):
            assert np.isfinite(utilisation()).all()
        assert utilisation() == whole
    with without("shares of the taxels"):
        assert utilisation() != whole


def test_an_alarm_has_hysteresis() -> None:
    p = np.zeros(100)
    p[10] = 0.6
    p[11:20] = 0.3
    on = np.flatnonzero(alarms(p, 0.5, 100.0))
    assert on[0] == 10
    assert 26 <= on[-1] <= 28  # below a quarter from 20 on, for 80 ms


def test_hands_that_hold_stay_where_they_are_planned() -> None:
    worlds = draw_worlds(
        range(40_000, 40_003), Population(hands=("rest", "sway"), duration_s=10.0, most_used=0.3)
    )
    assert [len(world.block) for world in worlds] == [round(10.0 * world.rate_hz) for world in worlds]
    assert {world.hand for world in worlds} <= {"rest", "sway"}
    for world in worlds:
        assert not world.slips
        assert 0.05 < world.utilisation.max() < 0.4
        assert count_reports(world).hours == pytest.approx(9.7 / 3600, rel=0.05)


def test_every_aim_measures_the_model_on_worlds(worlds: list[World]) -> None:
    told = [tell(world, GripParams()) for world in worlds[:4]]
    costs = {"numpy": {SHIPPED: ScanCost(400.0, 1100.0)}, "compiled": {SHIPPED: ScanCost(101.0, 600.0)}}
    found = GripFound(told, told, costs)
    for aim in AIMS:
        assert aim.measure(found).verdict in ("met", "open", "MISSED")
    assert [aim.measure(found).verdict for aim in AIMS[-2:]] == ["MISSED", "met"]
    assert list(cost_rows(costs)) == [
        {
            "array": SHIPPED,
            "numpy, hot (us)": "400",
            "numpy, live (us)": "1100",
            "compiled, hot (us)": "101",
            "compiled, live (us)": "600",
        }
    ]


def test_shares_go_from_stiffness_to_load() -> None:
    load = np.array([0.2, 1.0, 1.8])
    early, late = shares(load, 0.5, 0.001), shares(load, 0.5, 0.9999 * 0.5 * load.sum())
    np.testing.assert_allclose(early / early.sum(), np.cbrt(load) / np.cbrt(load).sum(), rtol=1e-3)
    np.testing.assert_allclose(late, 0.5 * load, rtol=1e-2)


def test_the_bound_falls_with_noise_and_is_the_priors_at_worst() -> None:
    load = np.array([0.2, 1.0, 1.8])
    sds = [utilisation_sd(load, 0.6, noise_sd, 0.0) for noise_sd in (1e-4, 1e-3, 1e-2, 1e3)]
    assert sds == sorted(sds)
    assert sds[-1] == pytest.approx(0.6 * PRIOR_SD, rel=1e-3)
    assert utilisation_sd(np.ones(3), 0.6, 1e-4, 0.0) == pytest.approx(0.6 * PRIOR_SD, rel=1e-3)

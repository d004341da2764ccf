"""Posterior of friction and the probabilities that follow from it."""

import numpy as np
import pytest

from tactiled.detect.grip.forecast import p_gross_within
from tactiled.detect.grip.friction import N_FRICTION, FrictionPosterior
from tactiled.detect.grip.trend import Trend

AT = np.array([0.05, 0.5, 0.95])
HORIZONS = np.array([0.05, 0.1, 0.3])


def test_quantiles_of_the_prior_are_lognormal() -> None:
    posterior = FrictionPosterior(0.6, 0.4)
    np.testing.assert_allclose(
        posterior.friction_quantiles(AT), 0.6 * np.exp(0.4 * np.array([-1.645, 0, 1.645])), rtol=0.03
    )


def test_utilisation_is_the_borne_ratio_over_friction() -> None:
    posterior = FrictionPosterior(0.6, 0.1)
    posterior.bear(0.3, 0.01)
    low, median, high = posterior.utilisation_quantiles(0.3, posterior.weights, AT)
    assert median == pytest.approx(0.5, rel=0.03)
    assert (low, high) == pytest.approx((0.5 * np.exp(-0.165), 0.5 * np.exp(0.165)), rel=0.05)


def test_shear_that_is_borne_refutes_lower_friction() -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    before = posterior.friction_quantiles(AT)
    for ratio in np.linspace(0, 0.9, 50):
        posterior.bear(ratio, 0.01)
    after = posterior.friction_quantiles(AT)
    assert after[0] > 0.7
    assert after[1] > before[1]
    # The same shear borne again is no new evidence.
    weights = posterior.weights.copy()
    for ratio in np.tile([0.2, 0.9], 20):
        posterior.bear(ratio, 0.01)
    np.testing.assert_array_equal(posterior.weights, weights)


@pytest.mark.parametrize("step_s", [0.02, 0.4, 2.0, 10.0])
def test_the_walk_keeps_weights_of_a_probability_at_any_scan_rate(step_s: float) -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    posterior.bear(0.5, step_s)
    for _ in range(20):
        posterior.walk(step_s)
        assert posterior.weights.min() >= 0
        assert posterior.weights.sum() == pytest.approx(1.0)


def p_gross(ratio: float, growth: float, *, is_fresh: bool = True) -> np.ndarray:
    posterior = FrictionPosterior(0.6, 0.3)
    return p_gross_within(posterior.log_used(ratio), posterior.weights, growth, 0.05, is_fresh, HORIZONS)


@pytest.mark.parametrize("log_sd", [0.1, 0.3, 0.6, 1.0])
def test_the_walk_keeps_the_prior_and_returns_to_it(log_sd: float) -> None:
    posterior = FrictionPosterior(0.6, log_sd)
    prior = posterior.friction_quantiles(AT)
    posterior.walk(1000.0)
    np.testing.assert_allclose(posterior.friction_quantiles(AT), prior, rtol=1e-9)
    posterior.bear(0.9, 0.01)
    assert posterior.friction_quantiles(AT)[1] > 1.2 * prior[1]
    posterior.walk(1000.0)
    np.testing.assert_allclose(posterior.friction_quantiles(AT), prior, rtol=1e-3)


def test_a_ratio_that_grows_slowly_comes_near_to_friction() -> None:
    """Low values are refuted one after the other, and friction must not run away before the ratio."""
    posterior = FrictionPosterior(0.6, 0.6)
    for ratio in np.linspace(0.01, 0.9, 1000):
        posterior.bear(ratio, 1.0)
        posterior.walk(1.0)
    assert posterior.friction_quantiles(AT)[1] < 1.5 * 0.9


def test_p_gross_grows_with_horizon_rate_and_ratio_and_is_a_probability() -> None:
    for ratio in (0.0, 0.3, 0.5, 0.6, 5.0):
        for growth in (-3.0, 0.0, 0.5, 5.0):
            found = p_gross(ratio, growth)
            assert np.all((found >= 0) & (found <= 1))
            assert np.all(np.diff(found) >= 0)
    assert p_gross(0.4, 2.0)[2] > p_gross(0.4, 0.2)[2]
    assert p_gross(0.5, 0.5)[2] > p_gross(0.3, 0.5)[2]
    assert p_gross(0.5, 0.5)[2] > p_gross(0.5, 0.5, is_fresh=False)[2]


def test_a_limit_that_is_met_slides_until_kinetic_friction_bears_the_ratio() -> None:
    posterior = FrictionPosterior(0.6, 0.05)
    odds = np.zeros(N_FRICTION)
    for ratio, slides in ((0.3, False), (0.62, True), (0.52, True), (0.35, False)):
        posterior.bear(ratio, 0.01)
        sliding, sticking = posterior.sliding(odds)
        assert sliding.sum() + sticking.sum() == pytest.approx(1)
        assert (sliding.sum() > 0.5) == slides
    # Nothing tells an even slide from a rest after it: the mean duration of slides decides.
    posterior.bear(0.62, 0.01)
    course = [posterior.sliding(odds)[0].sum()]
    for _ in range(600):
        posterior.bear(0.6, 0.01)
        course.append(posterior.sliding(odds)[0].sum())
    assert course[0] > 0.5
    assert course[100] > 0.7 * course[0]
    assert course[600] == pytest.approx(course[0] * np.exp(-2), rel=0.1)


def test_evidence_of_sliding_tells_friction_and_stays_after_the_slide() -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    for ratio in np.linspace(0, 0.6, 50):
        posterior.bear(ratio, 0.01)
    before = posterior.friction_quantiles(AT)
    posterior.take_sliding(4.0)
    assert posterior.sliding(np.zeros(N_FRICTION))[0].sum() > 0.8
    for _ in range(1000):
        posterior.bear(0.6, 0.01)
    assert posterior.sliding(np.zeros(N_FRICTION))[0].sum() < 0.1
    after = posterior.friction_quantiles(AT)
    assert after[1] == pytest.approx(0.6, rel=0.1)
    assert after[2] < before[2]


def test_odds_of_sliding_count_where_a_limit_may_be_met() -> None:
    posterior = FrictionPosterior(0.6, 0.3)
    posterior.bear(0.5, 0.01)
    silent, loud = (posterior.sliding(np.full(N_FRICTION, odds))[0].sum() for odds in (-1.0, 3.0))
    assert silent < 0.3 < 0.5 < loud


def test_the_next_contact_starts_from_a_wider_posterior() -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    posterior.take(-0.5 * (np.log(posterior.friction / 0.4) / 0.05) ** 2)
    low, median, high = posterior.friction_quantiles(AT)
    posterior.end_contact()
    wider_low, _, wider_high = posterior.friction_quantiles(AT)
    assert wider_low < low < median < high < wider_high
    assert posterior.friction_quantiles(np.array([0.4]))[0] == pytest.approx(0.42, abs=0.06)


def test_trend_follows_a_ramp_and_knows_what_was_borne_before() -> None:
    rng = np.random.default_rng(2)
    trend, fresh = Trend(), {}
    for k in range(500):
        t = k / 100
        course = np.interp(t, [1, 2, 3, 4, 5], [0, 0.5, 0.2, 0.4, 0.7])
        trend.step(np.array([course, 0.0, 0.0]) + rng.normal(0, 1e-3, 3), 1e-3, 0.01)
        fresh[k] = trend.is_fresh
        if k == 180:
            assert trend.growth == pytest.approx(0.5, abs=4 * trend.rate_sd)
    assert fresh[180]
    assert fresh[480]
    assert not fresh[300]
    assert not fresh[390]
    assert trend.size == pytest.approx(0.7, abs=0.02)

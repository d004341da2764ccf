"""Posterior of friction and the probabilities that follow from it."""

import numpy as np
import pytest

from tactiled.detect.grip.friction import FrictionPosterior
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
    posterior.bear(0.3)
    low, median, high = posterior.utilisation_quantiles(0.3, AT)
    assert median == pytest.approx(0.5, rel=0.03)
    assert (low, high) == pytest.approx((0.5 * np.exp(-0.165), 0.5 * np.exp(0.165)), rel=0.05)


def test_shear_that_is_borne_refutes_lower_friction() -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    before = posterior.friction_quantiles(AT)
    for ratio in np.linspace(0, 0.9, 50):
        posterior.bear(ratio)
    after = posterior.friction_quantiles(AT)
    assert after[0] > 0.7
    assert after[1] > before[1]
    # The same shear borne again is no new evidence.
    weights = posterior.weights.copy()
    for ratio in np.tile([0.2, 0.9], 20):
        posterior.bear(ratio)
    np.testing.assert_array_equal(posterior.weights, weights)


def test_p_gross_grows_with_horizon_rate_and_ratio_and_is_a_probability() -> None:
    def p(ratio: float, growth: float) -> np.ndarray:
        posterior = FrictionPosterior(0.6, 0.3)
        posterior.bear(ratio)
        return posterior.p_gross_within(ratio, growth, 0.05, 2.0, HORIZONS)

    for ratio in (0.0, 0.3, 0.5, 0.6, 5.0):
        for growth in (-3.0, 0.0, 0.5, 5.0):
            found = p(ratio, growth)
            assert np.all((found >= 0) & (found <= 1))
            assert np.all(np.diff(found) >= 0)
    assert p(0.4, 1.0)[2] > p(0.4, 0.2)[2]
    assert p(0.5, 0.5)[2] > p(0.3, 0.5)[2]


def test_a_growth_that_ends_at_known_friction_is_gross_slip_and_one_far_below_is_none() -> None:
    for stop, slides in ((0.6, True), (0.3, False)):
        posterior = FrictionPosterior(0.6, 0.05)
        for ratio in np.arange(0, stop, 0.01):
            posterior.bear(float(ratio))
        posterior.bear(stop)
        posterior.trend_ended(stop, growth=2.0, end_rate=3.0)
        assert (posterior.p_sliding > 0.5) == slides


def test_the_next_contact_starts_from_a_wider_posterior() -> None:
    posterior = FrictionPosterior(0.6, 0.6)
    posterior.take(-0.5 * (np.log(posterior.friction / 0.4) / 0.05) ** 2)
    low, median, high = posterior.friction_quantiles(AT)
    posterior.end_contact()
    wider_low, _, wider_high = posterior.friction_quantiles(AT)
    assert wider_low < low < median < high < wider_high
    assert posterior.friction_quantiles(np.array([0.4]))[0] == pytest.approx(0.42, abs=0.06)


def test_trend_follows_a_ramp_and_tells_its_end() -> None:
    rng = np.random.default_rng(2)
    trend, ends = Trend(), []
    for k in range(300):
        t = k / 100
        ratio = np.array([0.5 * np.clip(t - 1, 0, 1), 0.0, 0.0]) + rng.normal(0, 1e-3, 3)
        trend.step(ratio, 1e-3, 0.01)
        if k == 180:
            assert trend.growth == pytest.approx(0.5, abs=4 * trend.rate_sd)
        if trend.ended_at:
            ends.append(t)
    assert any(2.0 < t < 2.3 for t in ends)
    assert trend.size == pytest.approx(0.5, abs=0.01)


def test_a_hum_at_one_ratio_ends_its_growth_but_once() -> None:
    posterior = FrictionPosterior(0.6, 0.3)
    posterior.bear(0.5)
    posterior.trend_ended(0.5, growth=2.0, end_rate=3.0)
    weights, sliding = posterior.weights.copy(), posterior.sliding.copy()
    for ratio in (0.48, 0.5, 0.52):
        posterior.trend_ended(ratio, growth=2.0, end_rate=3.0)
    np.testing.assert_array_equal(posterior.weights, weights)
    np.testing.assert_array_equal(posterior.sliding, sliding)

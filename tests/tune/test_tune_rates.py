"""What counts of rare reports prove."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import poisson

from tactiled.tune.study import rate_interval


@given(st.floats(1e-3, 1e3))
def test_no_report_proves_three_over_the_time(hours: float) -> None:
    low, high = rate_interval(0, hours)
    assert low == 0
    assert high == pytest.approx(3 / hours, rel=0.002)


@given(st.integers(1, 500), st.floats(1e-3, 1e3))
def test_limits_of_a_rate_are_those_at_which_the_count_is_a_rare_one(count: int, hours: float) -> None:
    low, high = rate_interval(count, hours)
    assert poisson.sf(count - 1, low * hours) == pytest.approx(0.025)
    assert poisson.cdf(count, high * hours) == pytest.approx(0.025)

"""What counts of rare alarms prove, and how well the continued tail guesses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, poisson

from tactiled.tune.tail import fit_tail, median_interval, rate_interval, silent_from


@given(st.floats(1e-3, 1e3))
def test_no_alarm_proves_three_over_the_time(hours: float) -> None:
    low, high = rate_interval(0, hours)
    assert low == 0
    assert high == pytest.approx(3 / hours, rel=0.002)


@given(st.integers(1, 500), st.floats(1e-3, 1e3))
def test_limits_of_a_rate_are_those_at_which_the_count_is_a_rare_one(count: int, hours: float) -> None:
    low, high = rate_interval(count, hours)
    assert poisson.sf(count - 1, low * hours) == pytest.approx(0.025)
    assert poisson.cdf(count, high * hours) == pytest.approx(0.025)


def test_the_interval_of_the_exponential_tail_has_its_stated_coverage() -> None:
    """Sizes of scale 0.03 at 1200 an hour, seen for a minute: for one an hour 0.02 + 0.03 ln 1200."""
    rng = np.random.default_rng(4)
    rungs, hours = np.geomspace(0.02, 1.0, 40), 1 / 60
    truth = 0.02 + 0.03 * np.log(1200)
    covered = []
    for _ in range(400):
        sizes = 0.02 + rng.exponential(0.03, rng.poisson(1200 * hours))
        tail = fit_tail(rungs.tolist(), [int((sizes >= rung).sum()) for rung in rungs], hours)
        assert tail is not None
        value, low, high = tail.needed(1.0)
        assert low < value < high
        covered.append(low <= truth <= high)
    # Half a per cent of the level is the count's own luck, and rungs are coarse: 93 to 97 of a hundred.
    assert 0.92 <= np.mean(covered) <= 0.98


def test_a_rate_that_was_seen_needs_no_more_than_where_it_was_seen() -> None:
    tail = fit_tail([0.1, 0.2, 0.4], [3, 1, 0], hours=1.0)
    assert tail is not None
    assert tail.needed(3.0)[0] == tail.start == 0.1


def test_without_alarms_there_is_no_tail() -> None:
    assert fit_tail([0.1, 0.2], [0, 0], hours=1.0) is None


def test_silence_begins_above_the_last_alarm() -> None:
    assert silent_from([1, 2, 3, 4], [5, 0, 1, 0]) == 4
    assert silent_from([1, 2], [0, 0]) == 1
    assert silent_from([1, 2], [1, 1]) is None


def test_the_interval_of_a_median_covers_it() -> None:
    rng = np.random.default_rng(1)
    intervals = [median_interval(rng.exponential(1.0, 20).tolist()) for _ in range(1000)]
    share = np.mean([low <= np.log(2) <= high for _, low, high in intervals])
    assert 0.94 <= share <= 0.98  # 0.959: order statistics come in steps


def test_missed_detections_count_as_infinite_latency() -> None:
    assert median_interval([0.1, np.inf, np.inf])[0] == np.inf
    assert median_interval([0.1, 0.2, 0.3, np.inf])[0] == pytest.approx(0.25)
    assert median_interval([0.1]) == (0.1, 0.1, 0.1)


@given(st.integers(1, 2000))
def test_the_place_of_a_limit_is_the_quantile_of_the_binomial_distribution(n: int) -> None:
    _, low, high = median_interval(range(1, n + 1))
    place = max(int(binom.ppf(0.025, n, 0.5)), 1)
    assert (low, high) == (place, n + 1 - place)

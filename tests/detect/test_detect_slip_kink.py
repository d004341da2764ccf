"""When a response began to grow, and how well that is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.detect.slip_kink import find_kink


@given(st.floats(4, 40), st.sampled_from([1.0, 2**0.5, 2.0]), st.floats(1.0, 1e3))
def test_a_kink_without_noise_is_found_between_scans(delay: float, power: float, size: float) -> None:
    k = np.arange(100.0)
    kink = find_kink(size * np.maximum(k - (99 - delay), 0) ** power, 60, 1e-6)
    assert kink.delay_scans == pytest.approx(delay, abs=0.5)
    assert abs(kink.delay_scans - delay) < 3 * kink.sd_scans


@given(st.floats(8, 40), st.floats(1, 2.5), st.integers(0, 999))
def test_shapes_between_those_that_are_tried_are_covered_by_the_sigma(
    delay: float, power: float, seed: int
) -> None:
    rise = 100 * (np.maximum(np.arange(100.0) - (99 - delay), 0) / delay) ** power
    kink = find_kink(rise + np.random.default_rng(seed).normal(size=100), 60, 1.0)
    assert abs(kink.delay_scans - delay) < 5 * kink.sd_scans


@given(st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=60))
@settings(max_examples=50)
def test_a_kink_is_stated_for_anything(course: list[float]) -> None:
    kink = find_kink(np.array(course), 20, 0.0)
    assert 0 <= kink.delay_scans <= 40
    assert 0.01 < kink.sd_scans < 40


def test_a_jolt_that_a_scan_or_two_show_began_anywhere_since_the_scan_before() -> None:
    k = np.arange(100.0)
    delays = np.linspace(0.2, 1.2, 51)
    kinks = [find_kink(100 * np.maximum(k - (99 - delay), 0), 60, 0.5) for delay in delays]
    errors = np.array([kink.delay_scans for kink in kinks]) - delays
    assert abs(errors.mean()) < 0.1
    assert np.abs(errors).max() < 0.5
    assert np.mean(np.abs(errors) < [kink.sd_scans for kink in kinks]) > 0.6


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_a_kink_s_sigma_holds_under_noise_for_loads_that_swell(power: float, noise: float) -> None:
    rng = np.random.default_rng(8)
    k = np.arange(100.0)
    errors = []
    for _ in range(400):
        delay = rng.uniform(12, 30)
        rise = 60 * (np.maximum(k - (99 - delay), 0) / delay) ** power
        kink = find_kink(rise + noise * rng.normal(size=100), 60, noise)
        errors.append((kink.delay_scans - delay) / kink.sd_scans)
    assert 0.6 < np.mean(np.abs(errors) < 1) < 0.9


def test_the_instant_stated_lies_between_the_first_growth_and_a_load_that_all_would_call_one() -> None:
    k = np.arange(100.0)
    delay, size, least = 40.0, 0.05, 5.0  # a parabola that has risen by 5 after 10 scans
    kink = find_kink(size * np.maximum(k - (99 - delay), 0) ** 2, 80, 1e-3, least)
    assert kink.delay_scans == pytest.approx(delay - 5, abs=1)
    assert kink.sd_scans == pytest.approx(5, abs=1)

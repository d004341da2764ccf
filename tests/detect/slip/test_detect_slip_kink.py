"""Onset of growth of a response and its standard deviation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.detect.slip.kink import KinkEstimate, find_kink


def kink_of(course: FloatArray, longest: float, noise: float, least: float = 0.0) -> KinkEstimate:
    """Estimate the onset from one reading per scan with equal noise."""
    ago = np.arange(len(course) - 1.0, -1.0, -1.0)
    return find_kink(ago, course, np.full(len(course), noise), longest, least)


@given(st.floats(4, 40), st.sampled_from([1.0, 2**0.5, 2.0]), st.floats(1.0, 1e3))
def test_a_kink_without_noise_is_found_between_scans(delay: float, power: float, size: float) -> None:
    k = np.arange(100.0)
    kink = kink_of(size * np.maximum(k - (99 - delay), 0) ** power, 60, 1e-6)
    assert kink.delay_scans == pytest.approx(delay, abs=0.5)
    assert abs(kink.delay_scans - delay) < 3 * kink.sd_scans


@given(st.floats(8, 40), st.floats(1, 2.5), st.integers(0, 999))
def test_shapes_between_those_that_are_tried_are_covered_by_the_sigma(
    delay: float, power: float, seed: int
) -> None:
    rise = 100 * (np.maximum(np.arange(100.0) - (99 - delay), 0) / delay) ** power
    kink = kink_of(rise + np.random.default_rng(seed).normal(size=100), 60, 1.0)
    assert abs(kink.delay_scans - delay) < 5 * kink.sd_scans


@given(st.floats(1, 20), st.floats(2, 30), st.integers(0, 999))
def test_a_drag_that_slips_as_a_whole_since_is_covered_by_the_sigma(
    full_scans: float, delay: float, seed: int
) -> None:
    travel = np.minimum(np.maximum(np.arange(100.0) - (99 - delay), 0) / full_scans, 1.0)
    kink = kink_of(300 * (1 - (1 - travel) ** 1.5) + np.random.default_rng(seed).normal(size=100), 60, 1.0)
    assert abs(kink.delay_scans - delay) < max(4 * kink.sd_scans, 0.5)


@given(st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=60), st.floats(0, 1e6))
@settings(max_examples=50)
def test_a_kink_is_stated_for_anything(course: list[float], least: float) -> None:
    kink = kink_of(np.array(course), 20, 0.5, least)
    assert 0 <= kink.delay_scans <= 20
    assert 0.01 < kink.sd_scans < 20


def test_a_jolt_that_a_scan_or_two_show_began_anywhere_since_the_scan_before() -> None:
    k = np.arange(100.0)
    delays = np.linspace(0.2, 1.2, 51)
    kinks = [kink_of(100 * np.maximum(k - (99 - delay), 0), 60, 0.5) for delay in delays]
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
        kink = kink_of(rise + noise * rng.normal(size=100), 60, noise)
        errors.append((kink.delay_scans - delay) / kink.sd_scans)
    assert 0.6 < np.mean(np.abs(errors) < 1) < 0.9


def test_the_onset_is_where_growth_reaches_the_least_size() -> None:
    k = np.arange(100.0)
    delay, size, least = 40.0, 0.05, 5.0  # a parabola that has risen by 5 after 10 scans
    kink = kink_of(size * np.maximum(k - (99 - delay), 0) ** 2, 80, 1e-3, least)
    assert kink.delay_scans == pytest.approx(delay - 10, abs=1)
    assert kink.sd_scans < 2


def test_means_of_scans_reveal_an_onset_long_ago() -> None:
    rng = np.random.default_rng(3)
    scans = np.arange(2000.0)
    errors = []
    for _ in range(50):
        delay = rng.uniform(500, 1500)
        course = 0.2 * np.maximum(scans - (1999 - delay), 0) + rng.normal(size=2000)
        ago = np.concatenate([1999 - scans[:1840].reshape(-1, 8).mean(axis=1), 1999 - scans[1840:]])
        means = np.concatenate([course[:1840].reshape(-1, 8).mean(axis=1), course[1840:]])
        noise = np.repeat([8**-0.5, 1.0], [230, 160])
        kink = find_kink(ago, means, noise, 1900, 0.0)
        errors.append((kink.delay_scans - delay) / kink.sd_scans)
        assert kink.sd_scans < 40
    assert np.mean(np.abs(errors) < 1) > 0.5
    assert np.abs(errors).max() < 4

"""Opposed pairs: direction, share of shear and pressure, and missing channels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import load_array
from tactiled.detect.wang2019.opposed_pairs import PairResponse, mean_response, whole_weights

ARRAY = load_array("wang2019-3x3")
PAIRS = PairResponse(ARRAY)
ALL = np.ones(9, dtype=np.bool_)


def sheared(direction_deg: float, size: float = 100.0) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Readings of a skin dragged by a motion; the trailing side is loaded (R1 is at -x)."""
    toward = np.radians(np.nan_to_num(ARRAY.azimuth_deg) - direction_deg)
    return -size * np.cos(toward)


@given(st.floats(-180, 180), st.integers(1, 2**9 - 1))
def test_the_summed_response_points_along_the_motion(direction_deg: float, chosen: int) -> None:
    taxels = np.array([chosen >> t & 1 for t in range(9)], dtype=np.bool_)
    x, y = PAIRS.motion_weights(taxels) @ sheared(direction_deg)
    off_deg = (np.degrees(np.arctan2(y, x)) - direction_deg + 180) % 360 - 180
    assert abs(off_deg) < 1e-3


def test_shear_and_pressure_are_told_apart() -> None:
    opposed, common = PAIRS.opposed_and_common(sheared(30.0), ALL)
    assert opposed == pytest.approx(100.0, rel=1e-3)
    assert common == pytest.approx(0.0, abs=1e-6)
    opposed, common = PAIRS.opposed_and_common(np.full(36, 7.0), ALL)
    assert (opposed, common) == pytest.approx((0.0, 7.0), abs=1e-3)


def test_a_taxel_with_a_missing_side_is_left_out() -> None:
    usable = np.ones(36, dtype=np.bool_)
    usable[4 * 5 + 2] = False
    assert np.flatnonzero(~PAIRS.whole_taxels(usable)).tolist() == [5]


@given(st.lists(st.integers(-(2**20), 2**20), min_size=36 * 4, max_size=36 * 4), st.permutations(range(4)))
def test_means_of_whole_readings_are_exact_in_any_order(steps: list[int], order: list[int]) -> None:
    scans = np.array(steps, dtype=np.float64).reshape(4, 36)
    weights = PAIRS.motion_weights(ALL)
    assert (mean_response(weights, scans) == mean_response(weights, scans[order])).all()
    assert (whole_weights(weights) == weights).all()


def test_the_stated_sd_of_a_direction_holds_for_unequal_resistors() -> None:
    """Gains that scatter by 20 %: the error over the stated sd has about unit variance."""
    rng, along = np.random.default_rng(0), np.array([1.0, 0.0])
    ratios = []
    for _ in range(400):
        moved = sheared(0.0) * (1 + 0.2 * rng.standard_normal(36)) + 20 * rng.standard_normal(36)
        x, y = PAIRS.motion_weights(ALL) @ moved
        ratios.append(np.degrees(np.arctan2(y, x)) / PAIRS.direction_sd_deg(moved, ALL, along, 0.0))
    assert 0.5 < np.std(ratios) < 1.2


def test_without_a_response_there_is_no_direction() -> None:
    assert PAIRS.direction_sd_deg(np.zeros(36), ALL, np.array([1.0, 0.0]), 0.0) == 180.0


def test_the_sd_of_a_direction_is_the_standard_error_of_the_sum_of_unequal_taxels() -> None:
    rng = np.random.default_rng(1)
    along_x, along_y = (np.repeat(rng.uniform(*span, 9), 4) for span in ((0.5, 1.5), (-0.5, 0.5)))
    moved = along_x * sheared(0.0) + along_y * sheared(90.0)
    each = np.array([PAIRS.motion_weights(np.arange(9) == t) @ moved for t in range(9)])
    along = each.sum(axis=0) / np.hypot(*each.sum(axis=0))
    across = each @ [-along[1], along[0]]
    spread_deg = np.degrees(np.sqrt(9) * across.std(ddof=1) / np.hypot(*each.sum(axis=0)))
    of_model = PAIRS.direction_sd_deg(sheared(0.0), ALL, np.array([1.0, 0.0]), 0.0)  # of equal taxels
    assert of_model == pytest.approx(1.5, rel=1e-6)
    stated = PAIRS.direction_sd_deg(moved, ALL, along, 4.0)
    assert stated == pytest.approx(np.sqrt(4.0**2 + spread_deg**2 + of_model**2), rel=1e-3)

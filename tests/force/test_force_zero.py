"""Zero of the channels: what it follows and how fast, where it stands still, and how sure it is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tactiled.array import load_array
from tactiled.force.estimator import DriftZero

ARRAY = load_array("wang2019-3x3")
N = ARRAY.n_channels
STEP_S = 0.01
LARGEST = 2.0  # largest calibrated reading, so that parts of it differ from volts
NOISE = 0.01  # readings below five times this are of a free array


def zero() -> DriftZero:
    return DriftZero(ARRAY, np.full(N, LARGEST), NOISE, 0.003)


def steps(source: DriftZero, reading: float, n: int, *, is_complete: bool = True) -> np.ndarray:
    """Relative readings of the last of n equal scans."""
    for _ in range(n):
        relative = source.step(np.full(N, reading), STEP_S, is_complete=is_complete)
    return relative


@pytest.mark.parametrize("sign", [1, -1])
def test_a_slow_drift_is_averaged_over_two_seconds(sign: int) -> None:
    source = zero()
    steps(source, sign * 1e-4, 300)
    assert_allclose(source.offset, sign * 1e-4 * (1 - (1 - STEP_S / 2.0) ** 300))
    assert source.touched_s == 0.0
    assert not source.touching


@pytest.mark.parametrize("sign", [1, -1])
def test_no_zero_moves_faster_than_one_percent_in_fifty_seconds(sign: int) -> None:
    source = zero()
    steps(source, sign * 0.04, 500)
    assert_allclose(source.offset, sign * 2e-4 * LARGEST * 5.0)


def test_a_reading_above_five_noises_is_contact_in_either_direction() -> None:
    for reading, touches in [(0.049, False), (0.051, True), (-0.049, False), (-0.051, True)]:
        source = zero()
        steps(source, reading, 1)
        assert source.touching is touches
    one = zero()
    readings = np.zeros(N)
    readings[7] = 0.051
    one.step(readings, STEP_S, is_complete=True)
    assert one.touching


def test_a_noiseless_array_still_has_a_level() -> None:
    source = DriftZero(ARRAY, np.full(N, LARGEST), 0.0, 0.0)
    steps(source, LARGEST / 2048 * 0.99, 1)
    assert not source.touching
    steps(source, LARGEST / 2048 * 1.01, 1)
    assert source.touching


def test_a_contact_uses_the_zero_of_up_to_a_second_before_it() -> None:
    """Its slow beginning was taken for drift, which must not be subtracted from the force."""
    source = zero()
    offsets = []
    for _ in range(400):
        steps(source, 0.04, 1)
        offsets.append(source.offset[0])
    relative = steps(source, 1.0, 1)
    age = (400 - 1 - int(np.argmin(np.abs(np.array(offsets) - source.offset[0])))) * STEP_S
    assert 0.7 <= age <= 1.0
    assert source.offset[0] < offsets[-1]
    assert_allclose(relative, 1.0 - source.offset)
    held = source.offset.copy()
    steps(source, 1.0, 1000)
    assert_allclose(source.offset, held)
    assert source.touched_s == pytest.approx(1001 * STEP_S)


def test_a_scan_that_lacks_channels_moves_no_zero() -> None:
    source = zero()
    steps(source, 0.01, 100, is_complete=False)
    assert not source.offset.any()
    assert source.touching
    assert source.touched_s == pytest.approx(1.0)


def test_drift_in_a_contact_is_followed_a_second_after_its_end() -> None:
    source = zero()
    steps(source, 1.0, 20_000)  # in 200 s the zero may have drifted by 0.08, but 2 % of the press are less
    left = 0.02 * 1.0
    steps(source, 0.05 + left * 1.05, 300)
    assert source.touching
    steps(source, 0.05 + left * 0.95, 99)
    assert source.touching
    steps(source, 0.05 + left * 0.95, 1, is_complete=False)  # not known to be calm
    steps(source, 0.05 + left * 0.95, 99)
    assert source.touching
    steps(source, 0.05 + left * 0.95, 3)
    assert not source.touching
    assert source.touched_s == 0.0
    before = source.offset.copy()
    steps(source, 0.05 + left * 0.95, 100)
    assert_allclose(source.offset - before, 2e-4 * LARGEST, rtol=1e-6)


def test_a_short_contact_leaves_no_more_than_drift_can_have_made() -> None:
    source = zero()
    steps(source, 1.0, 1000)  # 10 s: 0.004 at most, and as much in each second of waiting
    steps(source, 0.05 + 0.01, 200)
    assert source.touching


def test_the_margin_that_drift_gave_is_withdrawn_as_the_zero_follows() -> None:
    source = zero()
    steps(source, 1.0, 20_000)
    steps(source, 0.05, 110)
    assert not source.touching
    steps(source, 0.05, 12_000)  # far longer than 0.02 takes at the fastest drift
    assert abs(source.offset[0] - 0.05) < 0.01
    steps(source, source.offset[0] + 0.051, 1)
    assert source.touching

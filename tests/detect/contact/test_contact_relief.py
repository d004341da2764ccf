"""Loads and shears where a side of the taxels has lost its load."""

from array import array

import numpy as np
import pytest

from tactiled.array import ArrayFile, FloatArray, Grid, TaxelChannel, build, load_array
from tactiled.detect.signal.front_end import RelievedSides, response_weights

ARRAY = load_array("wang2019-3x3")
SPREAD = 0.45  # of the pressed side's reading, that the side without load shows


def read(load: float, shear: tuple[float, float]) -> FloatArray:
    """Readings (36,) of nine equal taxels; the side that shear relieves reads no less than what spreads."""
    x, y = (s / 2 for s in shear)
    sides = np.array([load - x, load - y, load + x, load + y])
    return np.tile(np.maximum(sides, SPREAD * np.roll(sides, 2)), 9)


def correct(relieved: RelievedSides, volts: FloatArray) -> FloatArray:
    """Load and shears (3, taxels) of readings, corrected."""
    response = response_weights(ARRAY) @ volts
    flat = array("d", response.ravel())
    relieved.correct(array("d", volts), 0, flat)
    return np.array(flat).reshape(response.shape)


def corrected(courses: FloatArray) -> FloatArray:
    """Means (n, 3) of load and shears over the taxels, for courses (n, 3) of the true ones."""
    relieved = RelievedSides(ARRAY)
    return np.array([correct(relieved, read(load, (x, y))).mean(axis=1) for load, x, y in courses])


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 135.0, 270.0])
def test_shear_goes_on_and_the_load_stays_where_a_side_is_relieved(direction_deg: float) -> None:
    size = np.append(np.linspace(0, 1.5, 100), np.linspace(1.5, 0, 100))
    angle = np.radians(direction_deg)
    truth = np.stack([np.ones(200), size * np.cos(angle), size * np.sin(angle)], axis=1)
    np.testing.assert_allclose(corrected(truth), truth, atol=0.01)
    as_read = np.array([(response_weights(ARRAY) @ read(load, (x, y))).mean(axis=1) for load, x, y in truth])
    assert np.abs(as_read - truth).max() > 0.08


@pytest.mark.parametrize("last", [0.7, 1.2])
def test_a_load_that_changes_is_seen_by_the_other_pair(last: float) -> None:
    load = np.append(np.ones(50), np.linspace(1, last, 50))
    truth = np.stack([load, np.append(np.linspace(0, 1.2, 50), np.full(50, 1.2)), np.zeros(100)], axis=1)
    np.testing.assert_allclose(corrected(truth), truth, atol=0.01)


def test_noise_of_one_scan_does_not_stay_in_the_shear_of_relieved_sides() -> None:
    rng = np.random.default_rng(0)
    relieved, shears = RelievedSides(ARRAY), []
    for x in np.append(np.linspace(0, 0.74, 60), np.full(60, 0.8)):  # relieved from 0.76 on
        volts = read(1.0, (x, 0.0)) + 3e-3 * rng.standard_normal(36)
        shears.append(correct(relieved, volts)[1])
    assert all(list(relieved.relieved)[:9])
    np.testing.assert_allclose(np.mean(shears[-50:], axis=0), 0.8, rtol=0.008)


def test_arrays_without_opposed_sides_are_left_as_they_are() -> None:
    channels = [
        TaxelChannel(name="x", kind="shear_x"),
        TaxelChannel(name="y", kind="shear_y"),
        TaxelChannel(name="z", kind="normal"),
    ]
    xyz = build(ArrayFile(name="xyz", grids=[Grid(x_mm=[0.0], y_mm=[0.0])], taxel_channels=channels))
    assert RelievedSides(ARRAY).is_due
    assert not RelievedSides(xyz).is_due

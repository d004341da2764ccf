"""Direction of a slip and its standard deviation."""

import numpy as np
import pytest

from tactiled.array import FloatArray, load_array
from tactiled.detect.slip.direction import direction
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.response import ResponseModel
from tactiled.events.types import UNKNOWN_SD_DEG

ARRAY = load_array("wang2019-3x3")
PRESSED = 1e6  # steps


class AllTaxels(ShearEvidence):
    """Evidence that includes every taxel from the first scan on."""

    taxels = np.ones(ARRAY.n_taxels, dtype=np.bool_)
    weights = ResponseModel(ARRAY).weights(taxels)


EVIDENCE = AllTaxels(ARRAY, 100.0, 1.0, 0.1)


def sheared(x: float, y: float) -> FloatArray:
    """Return the readings (channels,) of equal taxels under a shear over pressure."""
    way = np.linalg.pinv(ARRAY.shear_weights().reshape(-1, ARRAY.n_channels))
    shear = way @ np.repeat([x, y], ARRAY.n_taxels)
    return np.asarray(PRESSED * np.maximum(1.0 + shear, 0.45))


def said(before: FloatArray, now: FloatArray) -> tuple[float, float]:
    change = now - before
    grown = EVIDENCE.weights @ change
    along = grown[:3] - grown[3:6]
    return direction(EVIDENCE, along / np.linalg.norm(along), change, EVIDENCE.weights @ now)


@pytest.mark.parametrize("degrees", [0.0, 37.0, 90.0, -120.0, 179.0])
def test_shear_that_grows_from_nothing_goes_where_it_grows(degrees: float) -> None:
    x, y = 0.3 * np.cos(np.radians(degrees)), 0.3 * np.sin(np.radians(degrees))
    direction_deg, sd_deg = said(sheared(0.0, 0.0), sheared(x, y))
    assert np.cos(np.radians(direction_deg - degrees)) == pytest.approx(1.0, abs=1e-6)
    assert sd_deg < 0.5


@pytest.mark.parametrize("there", [0.3, 0.5, -0.5])
def test_shear_at_an_angle_leaves_all_open_between_growth_and_sum_at_the_limit(there: float) -> None:
    direction_deg, sd_deg = said(sheared(0.0, there), sheared(0.1, there))
    at_limit_deg = np.degrees(np.arctan2(there, np.sqrt(1.1**2 - there**2)))
    assert 0.0 < direction_deg / at_limit_deg < 0.5
    # A drag goes where the shear grows, a pull towards the sum.
    assert abs(direction_deg) < 1.5 * sd_deg
    assert abs(at_limit_deg - direction_deg) < 3 * sd_deg


def test_shear_there_already_in_the_same_direction_leaves_nothing_open() -> None:
    direction_deg, sd_deg = said(sheared(0.3, 0.3), sheared(0.4, 0.4))
    assert direction_deg == pytest.approx(45.0, abs=1e-6)
    assert sd_deg < 0.5


def test_what_unequal_resistors_show_of_shear_leaves_nothing_open() -> None:
    direction_deg, sd_deg = said(sheared(0.0, 0.05), sheared(0.1, 0.05))
    assert direction_deg == pytest.approx(0.0, abs=1e-6)
    assert sd_deg < 0.5


def test_a_side_that_is_relieved_of_all_it_carries_hides_growth_and_the_sigma_knows() -> None:
    before, now = sheared(0.0, 0.0), sheared(0.3, 2.0)
    direction_deg, sd_deg = said(before, now)
    true_deg = np.degrees(np.arctan2(2.0, 0.3))
    assert abs(direction_deg - true_deg) > 2
    assert abs(direction_deg - true_deg) < 2 * sd_deg


def test_a_skin_that_turns_on_the_spot_goes_nowhere() -> None:
    along = np.array([0.3, 0.3, 0.9])
    now = EVIDENCE.weights @ sheared(0.0, 0.0)
    assert direction(EVIDENCE, along, np.zeros(ARRAY.n_channels), now) == (0.0, UNKNOWN_SD_DEG)

"""Direction of a slip from courses of shear that are known."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tactiled.array import FloatArray
from tactiled.detect.contact.direction import Direction, direction
from tactiled.detect.contact.filter import ContactFilter
from tactiled.events.types import UNKNOWN_SD_DEG

N_TAXELS = 9


def found(course: FloatArray, *, is_gross: bool = False, spread: float = 0.0, n: int = N_TAXELS) -> Direction:
    """Direction after a course (scans, 2) of total shear over load, shared by n taxels of unequal gain."""
    rng = np.random.default_rng(5)
    gains = 1 + spread * rng.normal(size=(2, n))
    past = np.array([np.repeat(total[:, np.newaxis] / n, n, axis=1) * gains for total in course])
    contact = SimpleNamespace(
        signs=SimpleNamespace(ratio_noise=1e-4),
        friction_now=(0.7, 0.8, 0.9),
        p_sliding_now=0.3 * is_gross,
        p_incipient=0.9,
        load=1.0,
        total_x=course[-1, 0],
        total_y=course[-1, 1],
        moment=0.0,
    )
    return direction(cast(ContactFilter, cast(Any, contact)), past, 3, is_gross=is_gross)


def arc(turn_deg: float, size: float = 0.6, n: int = 60) -> FloatArray:
    """Growth along +x at first, whose direction turns evenly by an angle."""
    angles = np.deg2rad(np.linspace(0.0, turn_deg, n))
    return np.cumsum(size / n * np.stack([np.cos(angles), np.sin(angles)], axis=1), axis=0)


def test_a_straight_growth_has_the_opposite_direction_and_no_spread() -> None:
    told = found(arc(0.0))
    assert abs(abs(told.angle_deg) - 180.0) < 1e-6
    assert told.sd_deg < 0.01


def test_unequal_gains_widen_the_standard_deviation_in_proportion() -> None:
    along = np.linspace(0, 0.6, 60)[:, np.newaxis] * np.array([0.8, 0.6])
    small, large = found(along, spread=0.02).sd_deg, found(along, spread=0.08).sd_deg
    assert large == pytest.approx(4 * small, rel=0.1)


def test_a_bend_is_uncertainty_before_gross_slip_and_its_first_half_counts_after() -> None:
    before, after = found(arc(20.0)), found(arc(20.0), is_gross=True)
    assert before.sd_deg == pytest.approx(5.0, abs=1.0)  # the halves are 5 degrees from the whole
    # Away from the growth the sum at the limit has its part; its turn is the same in both.
    turned_deg = (after.angle_deg - before.angle_deg + 180) % 360 - 180
    assert turned_deg == pytest.approx(-5.0, abs=1.0)
    assert after.sd_deg < before.sd_deg


def test_shear_that_falls_while_all_slides_opposes_the_slip() -> None:
    rises, falls = np.linspace(0, 0.6, 30), np.linspace(0.6, 0.3, 90)
    course = np.stack([np.concatenate([rises, falls])[30:], np.zeros(90)], axis=1)
    assert abs(abs(found(course, is_gross=True).angle_deg) - 180.0) < 1e-6
    assert abs(found(course).angle_deg) < 90.0  # of a contact that holds, the growth counts


@pytest.mark.parametrize("is_gross", [True, False])
def test_a_shear_that_was_released_first_does_not_turn_the_direction(is_gross: bool) -> None:
    released = np.linspace(0.7, 0.05, 40)[:, np.newaxis] * np.array([[0.0, 1.0]])
    grows = np.array([[0.0, 0.05]]) + arc(0.0)
    told = found(np.concatenate([released, grows]), is_gross=is_gross)
    assert abs(abs(told.angle_deg) - 180.0) < 5.0  # of the growth along +x


@pytest.mark.parametrize("is_gross", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_noise_of_a_shear_that_fell_and_rests_is_no_growth(is_gross: bool, seed: int) -> None:
    left = np.concatenate([np.linspace(0.6, 0.3, 40), np.full(40, 0.3)])
    course = left[:, np.newaxis] * np.array([[1.0, 0.0]])
    course += 1e-3 * np.random.default_rng(seed).standard_normal(course.shape)
    fell_deg = 180.0 if is_gross else 0.0  # a slip opposes what is left; of a contact that holds, the change
    assert abs((found(course, is_gross=is_gross).angle_deg - fell_deg + 180.0) % 360.0 - 180.0) < 5.0


def test_few_taxels_have_the_noise_and_the_unequal_resistors_of_one() -> None:
    assert found(arc(0.0), n=1).sd_deg == pytest.approx(np.degrees(0.05), rel=0.01)
    assert found(arc(0.0), n=4).sd_deg < 0.01


def test_no_growth_has_no_direction() -> None:
    assert found(np.zeros((20, 2))).sd_deg == UNKNOWN_SD_DEG

"""Wave vectors that the phases allow: limits, known motion, and readings that cannot be told apart."""

import dataclasses

import numpy as np
import pytest
from gratings import (
    ARRAY,
    Grating,
    MotionOf,
    Slide,
    answer,
    assert_refused,
    assert_right,
    fit,
    grid,
    known,
    motions,
    unknown,
)

from tactiled.detect.grooves.model import WaveMotion
from tactiled.detect.grooves.params import WaveParams


def test_an_uncertain_speed_widens_the_period() -> None:
    slide = Slide((Grating(angle_deg=0.0),))
    sure, unsure = answer(fit(slide, known(slide))), answer(fit(slide, WaveMotion(2.0, 0.01, 0.0, 0.0)))
    # Not by all of it: delays alone determine the period too, and an uncertain speed has less weight.
    assert sure.period_sd_mm < 0.9 * unsure.period_sd_mm
    assert unsure.period_sd_mm < 1.01 * answer(fit(slide, unknown(slide))).period_sd_mm
    assert_right(fit(slide, WaveMotion(2.02, 0.02, 0.0, 0.0)), slide.gratings[0])


@pytest.mark.parametrize("tilt_deg", [0.0, 18.0, -50.0])
@pytest.mark.parametrize("off_deg", [-5.0, 4.8])
def test_a_direction_off_by_its_sigma_is_allowed_for_in_windows_of_many_periods(
    tilt_deg: float, off_deg: float
) -> None:
    """Also along the normal, where the frequency depends on the direction in second order only."""
    slide = Slide((Grating(1.0, tilt_deg),), speed_mm_s=9.0)
    found = answer(fit(slide, WaveMotion(9.0, 0.0, off_deg, 3.0)))
    assert_right(found, slide.gratings[0])
    assert found.uses_given_speed


@motions
def test_vibration_of_the_whole_pad_is_no_wave(motion_of: MotionOf) -> None:
    slide = Slide(duration_s=5.0)
    offsets_s = np.linspace(0, 0.007, 36)
    hum = 0.1 * np.cos(2 * np.pi * 7.3 * (slide.times()[:, np.newaxis] + offsets_s))
    assert_right(fit(slide, motion_of(slide), volts=slide.volts(ARRAY, offsets_s) + hum), slide.gratings[0])
    still = dataclasses.replace(slide, gratings=())
    assert_refused(fit(still, motion_of(slide), volts=still.volts(ARRAY, offsets_s) + hum), "low-snr")


def test_equal_gaps_answer_where_the_limits_leave_one_reading() -> None:
    slide = Slide((Grating(4.0, 20.0),), speed_mm_s=6.0)
    array = grid([0.0, 3.5, 7.0], [0.0, 3.5, 7.0])
    found = fit(slide, known(slide), array, params=WaveParams(max_tilt_deg=30.0, min_period_mm=2.0))
    assert_right(found, slide.gratings[0])


def test_one_column_needs_the_speed_and_motion_across_it() -> None:
    column = grid([0.0], [0.0, 3.5, 7.3])
    slide = Slide((Grating(2.0, 20.0),))
    assert_right(fit(slide, known(slide), column), slide.gratings[0])
    assert_refused(fit(slide, unknown(slide), column), "ambiguous")
    along = dataclasses.replace(slide, direction_deg=90.0, gratings=(Grating(2.0, 70.0),))
    assert_refused(fit(along, known(along), column), "ambiguous")


@motions
@pytest.mark.parametrize("angle_deg", [84.0, 88.0, 90.0])
def test_grooves_along_the_motion_are_refused_and_never_wrong(motion_of: MotionOf, angle_deg: float) -> None:
    slide = Slide((Grating(1.2, angle_deg),), speed_mm_s=2.0, duration_s=4.0)
    assert_refused(fit(slide, motion_of(slide)), "too-few-periods", "low-snr", "ambiguous")


@motions
@pytest.mark.parametrize("period_mm", [3.5, 3.8, 7.3, 3.65, 0.3 * 3.5, 1.9])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0])
def test_periods_that_are_a_spacing(motion_of: MotionOf, period_mm: float, angle_deg: float) -> None:
    slide = Slide((Grating(period_mm, angle_deg),), speed_mm_s=4.0, duration_s=8.0)
    assert_right(fit(slide, motion_of(slide)), slide.gratings[0])


@motions
@pytest.mark.parametrize("angle_deg", [-29.0, -28.0, 28.5, 29.5])
def test_grooves_just_within_the_limits_are_not_taken_for_others(
    motion_of: MotionOf, angle_deg: float
) -> None:
    """The maximum is inside the limits although the nearest grid point is not."""
    grating = Grating(6.54, angle_deg)
    slide = Slide((grating,), speed_mm_s=15.0, duration_s=2.0)
    limits = WaveParams(min_period_mm=5.0, max_tilt_deg=30.0)
    assert_right(fit(slide, motion_of(slide), params=limits), grating)


@pytest.mark.parametrize("angle_deg", [20.0, 40.0])
@pytest.mark.parametrize("direction_sd_deg", [1.0, 3.0])
def test_a_column_with_an_uncertain_direction_finds_the_wave(
    angle_deg: float, direction_sd_deg: float
) -> None:
    """Taxels of one column do not determine the component along the motion; only the motion does."""
    slide = Slide((Grating(1.0, angle_deg),), speed_mm_s=2.0, duration_s=3.0)
    motion = WaveMotion(2.0, 0.0, 0.0, direction_sd_deg)
    assert_right(fit(slide, motion, grid([0.0], [0.0, 3.5, 7.3])), slide.gratings[0])

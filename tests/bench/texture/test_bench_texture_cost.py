"""Windows that the cost table times are answered in full."""

import numpy as np
import pytest

from bench.texture.cost import STRAY_RAD, grating_of
from bench.texture.signal import readings
from bench.texture.trials import DIRECTION_SD_DEG, joint_fit
from tactiled.array import load_array
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal

ARRAY = load_array("wang2019-3x3")


def fit(stray_rad: float, speed_mm_s: float) -> GrooveAnswer | Refusal:
    grating = grating_of(ARRAY, 2.0, stray_rad)
    volts, direction_deg = readings(grating, np.random.default_rng(1)), grating.wave.direction_deg
    return joint_fit(ARRAY, volts, grating.sensed.offset_s, speed_mm_s, direction_deg, DIRECTION_SD_DEG)


@pytest.mark.parametrize("speed_mm_s", [9.0, 0.0])
def test_windows_that_are_timed_are_answered(speed_mm_s: float) -> None:
    alike, straying = fit(0.0, speed_mm_s), fit(STRAY_RAD, speed_mm_s)
    assert isinstance(alike, GrooveAnswer)
    assert isinstance(straying, GrooveAnswer)
    assert alike.period_mm == pytest.approx(1.2, abs=4 * alike.period_sd_mm)
    assert straying.period_mm == pytest.approx(1.2, abs=4 * straying.period_sd_mm)
    assert straying.angle_sd_deg > 2 * alike.angle_sd_deg  # strays are there, and the fit has seen them

"""Windows that the cost tables time are answered in full; cells of those tables."""

import numpy as np
import pytest

from bench.texture.cost import STRAY_RAD, FitCost, OnlineCost, cost_table, grating_of, online_table
from bench.texture.signal import readings
from bench.texture.trials import DIRECTION_SD_DEG, joint_fit
from tactiled.array import load_array
from tactiled.detect.grooves.model import WaveFit

ARRAY = load_array("wang2019-3x3")


def fit(stray_rad: float, speed_mm_s: float) -> WaveFit:
    grating = grating_of(ARRAY, 2.0, stray_rad)
    volts, direction_deg = readings(grating, np.random.default_rng(1)), grating.wave.direction_deg
    return joint_fit(ARRAY, volts, grating.sensed.offset_s, speed_mm_s, direction_deg, DIRECTION_SD_DEG)


@pytest.mark.parametrize("speed_mm_s", [9.0, 0.0])
def test_windows_that_are_timed_are_answered(speed_mm_s: float) -> None:
    alike, straying = fit(0.0, speed_mm_s), fit(STRAY_RAD, speed_mm_s)
    assert (alike.status, straying.status) == ("ok", "ok")
    assert alike.period_mm == pytest.approx(1.2, abs=4 * alike.period_sd_mm)
    assert straying.period_mm == pytest.approx(1.2, abs=4 * straying.period_sd_mm)
    assert straying.angle_sd_deg > 2 * alike.angle_sd_deg  # strays are there, and the fit has seen them


def test_the_share_is_of_the_cheapest_and_of_the_dearest_fit() -> None:
    cells = (
        cost_table([FitCost("joint fit", "pad", 9, 2.0, [4.0, 5.0, 10.0, 8.0], 1.0, (1.0, 2.0))])
        .splitlines()[-1]
        .split("|")
    )
    assert [cell.strip() for cell in cells[5:-1]] == [
        "4.0",
        "5.0",
        "10.0",
        "8.0",
        "1.0 (10 to 25 %)",
        "1.0 to 2.0",
    ]


def test_the_longest_hop_is_said() -> None:
    row = online_table([OnlineCost("quick", 100, 15000.0, 1.52, 21.4, 1000.0)]).splitlines()[-1]
    assert "1.5 ms" in row
    assert "21 ms" in row
    assert "10.0 %" in row  # of a core, at a hundred scans a second

"""Onsets estimated from kinks of known position."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tactiled.detect.signal.wavelet import taps
from tactiled.detect.wang2019.kink import KinkFit

THRESHOLD = 0.002


@pytest.mark.parametrize("level", range(1, 7))
@given(slope=st.floats(1e-4, 1.0), begins=st.floats(0, 1), turn=st.sampled_from([1.0, -1.0]))
@settings(max_examples=40, deadline=None)
def test_a_clean_kink_is_dated_to_a_fraction_of_a_scan(
    level: int, slope: float, begins: float, turn: float
) -> None:
    filtered = taps(level)
    n = len(filtered)
    scans = np.arange(3 * n)
    response = turn * slope * np.maximum(scans - n - begins, 0)
    coefficients = np.convolve(response, filtered)[: len(response)]
    crossing = np.flatnonzero(np.abs(coefficients) >= THRESHOLD)
    assume(len(crossing) > 0)
    at = int(crossing[0])
    delay = KinkFit(level).fit(response[at - n + 1 : at + 1], float(coefficients[at]))
    assert abs(at - delay.scans - n - begins) <= max(1.5, delay.sd_scans)


def test_no_movement_has_no_direction() -> None:
    fit = KinkFit(3)
    onset = fit.onset(np.ones((36, 2)), np.zeros(2))
    assert onset.direction_sd_deg == 180.0
    assert onset.delay.scans == pytest.approx(fit.middle_scans)


@given(st.floats(-179, 179), st.floats(0, 0.01))
@settings(deadline=None)
def test_direction_and_its_sigma(direction_deg: float, noise: float) -> None:
    fit = KinkFit(3)
    theta = np.radians(direction_deg)
    rising = np.maximum(np.arange(36) - 22, 0)[:, np.newaxis] * 0.01
    responses = rising * [np.cos(theta), np.sin(theta)] + noise * np.random.default_rng(1).normal(
        size=(36, 2)
    )
    onset = fit.onset(responses, taps(3)[::-1] @ responses)
    off_deg = abs((onset.direction_deg - direction_deg + 180) % 360 - 180)
    assert off_deg <= max(1e-6, 4 * onset.direction_sd_deg)

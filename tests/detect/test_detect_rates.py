"""Detection at every scan rate that a board may have, from one scan in ten seconds on."""

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import SlipEvent
from tactiled.pipeline import RATES_HZ
from tactiled.samples.block import regular_block


@pytest.mark.parametrize("rate_hz", [RATES_HZ[0], 1.0, 4.0, 10.0, 12.4, 13.0, 50.0, 1000.0, RATES_HZ[1]])
def test_shear_that_grows_under_pressure_is_reported_at_any_rate(rate_hz: float) -> None:
    array = load_array("wang2019-3x3")
    n = max(300, round(0.2 * rate_hz))  # the filter looks each 20 ms
    volts = np.zeros((100 + n, array.n_channels))
    volts[50:] = 1.0
    grown = np.linspace(0.0, 0.4, n)[:, np.newaxis]
    volts[100:, 0::4] += grown
    volts[100:, 2::4] -= grown
    volts += np.random.default_rng(1).normal(0.0, 1e-3, volts.shape)
    events = build_suite(array, DetectParams()).process(regular_block(volts, rate_hz))
    onsets = [event for event in events if isinstance(event, SlipEvent) and event.state == "onset"]
    assert onsets
    assert onsets[0].detected_s > 100 / rate_hz

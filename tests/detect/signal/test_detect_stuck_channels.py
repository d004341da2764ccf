"""Channels that do not follow the load are found, and quiet or noisy ones are not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from touches import LSB, Touch

from tactiled.array import FloatArray, load_array
from tactiled.detect.signal.fast import StuckChannels
from tactiled.detect.signal.quantise import Quantiser

ARRAY = load_array("wang2019-3x3")


def steps(volts: FloatArray) -> FloatArray:
    return np.asarray(np.rint(np.floor(volts / LSB + 0.5) * LSB / Quantiser(ARRAY).volts_per_step))


def stuck_in(volts: FloatArray) -> NDArray[np.bool_]:
    rows = steps(volts)
    stuck = np.empty(rows.shape, dtype=np.bool_)
    search = StuckChannels(ARRAY, Quantiser(ARRAY).volts_per_step)
    any_stuck = search.take(len(rows), 0, rows.ravel(), stuck.reshape(-1).view(np.uint8))
    assert any_stuck == stuck.any()
    return stuck


def test_a_press_that_is_over_mends_no_channel() -> None:
    touch = Touch(slide_s=3.0, stop_s=3.5, lift_s=4.0, end_s=5.0)
    volts = np.concatenate([touch.volts(ARRAY, 100.0)] * 2)
    volts[:, 5] = 2.9  # before it could have had noise
    stuck = stuck_in(volts)
    assert stuck[150:, 5].all()
    assert not np.delete(stuck, 5, axis=1).any()
    volts[600:, 5] += LSB
    assert not stuck_in(volts)[600, 5]


@given(st.floats(0.0, 0.6), st.floats(-2e-4, 2e-4), st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_a_quiet_converter_repeats_its_codes_lawfully(noise_lsb: float, drift_v_s: float, seed: int) -> None:
    """A press, a slip and its end with noise below the last bit, and a drift through its codes."""
    touch = Touch(noise=0.0, seed=seed, end_s=10.0, lift_s=20.0).volts(ARRAY, 100.0)
    rng = np.random.default_rng(seed)
    volts = touch + noise_lsb * LSB * rng.normal(size=touch.shape)
    volts += drift_v_s * np.arange(len(volts))[:, np.newaxis] / 100
    assert not stuck_in(volts).any()


def test_noise_that_stops_everywhere_sticks_nothing() -> None:
    rng = np.random.default_rng(5)
    volts = 1.2 + 2e-3 * rng.normal(size=(1500, ARRAY.n_channels)) * (np.arange(1500) < 700)[:, np.newaxis]
    assert not stuck_in(volts).any()


@pytest.mark.parametrize("noise", [1e-3, 10e-3])
def test_noise_of_a_last_bit_repeats_no_code_for_long(noise: float) -> None:
    rng = np.random.default_rng(6)
    assert not stuck_in(1.2 + noise * rng.normal(size=(60_000, ARRAY.n_channels))).any()

"""Published sensitivities from the force on a taxel to volts; what rubber and multiplexer do on the way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.emulator import electronics
from tactiled.emulator.electronics import PUBLISHED_SENSITIVITY, ElectronicsParams, calibrate
from tactiled.emulator.mechanics.fem.reference import load_reference
from tactiled.errors import ConfigError

FloatArray = NDArray[np.float64]
AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])
ONE_TAXEL = np.zeros(4, dtype=np.int64)


def taxel_v(params: ElectronicsParams, side_n: FloatArray) -> FloatArray:
    """Volts of R1..R4 from the forces on the edge areas."""
    quarter = electronics.spread_n(params, electronics.quarter_n(side_n, "edge"), ONE_TAXEL, AZIMUTH)
    return electronics.divider_v(params, electronics.conductance_s(params, quarter))


def test_normal_sensitivities_are_the_published_ones() -> None:
    load_n = np.array([0.0, 6.0, 15.0])
    at_rest = np.repeat(load_n[:, None] * electronics.PART_OF_LOAD["edge"], 4, axis=1)
    volts = taxel_v(PUBLISHED_SENSITIVITY, at_rest).mean(axis=1)
    assert np.diff(volts) / np.diff(load_n) == pytest.approx([0.201, 0.067], rel=1e-6)
    assert volts.max() < 3.0  # within the ADC


@pytest.mark.parametrize(("axis", "published"), [(0, 0.471), (1, 0.466)])
def test_shear_sensitivities_are_the_published_ones(axis: int, published: float) -> None:
    """With left and right as finite elements give them; the middle of the first range, 3 N."""
    columns = load_reference("coarse", "flat-0.6").columns
    left, right, rest = columns["edge_0_n"][-1], columns["edge_2_n"][-1], columns["edge_0_n"][5]
    change = np.array([left - right, 0.0, right - left, 0.0]) / (2 * rest)  # at friction 0.6
    shear_n = 0.01
    sides = 3.0 * electronics.PART_OF_LOAD["edge"] * (1 + np.roll(change, axis) * shear_n / (0.6 * 3.0))
    volts = taxel_v(PUBLISHED_SENSITIVITY, sides)
    assert (volts[axis] - volts[axis + 2]) / shear_n == pytest.approx(published, rel=0.01)


def test_the_rubber_stays_above_500_kiloohm_per_newton() -> None:
    force_n = np.linspace(0.02, 0.7, 500)
    resistance = 1 / electronics.conductance_s(PUBLISHED_SENSITIVITY, force_n)
    assert np.all(np.diff(resistance) / np.diff(force_n) < -500e3)


@given(st.floats(0.05, 0.4), st.floats(0.1, 0.9), st.floats(0.2, 0.45))
def test_calibration_meets_what_it_is_given(first: float, part: float, shear: float) -> None:
    params = calibrate((first, part * first), (shear * first, shear * first))
    volts = [float(taxel_v(params, np.full(4, n * electronics.PART_OF_LOAD["edge"])).mean()) for n in (6, 15)]
    assert volts[0] / 6 == pytest.approx(first, rel=1e-6)
    assert (volts[1] - volts[0]) / 9 == pytest.approx(part * first, rel=1e-5)


def test_impossible_sensitivities_are_refused() -> None:
    with pytest.raises(ConfigError, match="second must be smaller"):
        calibrate((0.1, 0.2))
    with pytest.raises(ConfigError, match="the areas give no more than"):
        calibrate(shear_v_per_n=(2.0, 2.0))


def test_default_hold_of_20_newtons_reads_about_a_volt_on_edge_areas_too() -> None:
    part = electronics.PART_OF_LOAD["edge"]
    volts = taxel_v(ElectronicsParams(), np.full(4, 20.0 / 9 * part))
    assert np.all((volts > 1.0) & (volts < 1.5))


@given(st.lists(st.floats(0, 2), min_size=4, max_size=4))
def test_spreading_keeps_the_sum_and_order(force_n: list[float]) -> None:
    sides = np.array(force_n)
    even = ElectronicsParams(spread_x=0.4, spread_y=0.4)
    read = electronics.spread_n(even, sides, ONE_TAXEL, AZIMUTH)
    assert read.sum() == pytest.approx(sides.sum(), abs=1e-9)
    assert np.ptp(read) <= np.ptp(sides) + 1e-12
    same = ElectronicsParams(spread_x=0.0, spread_y=0.0)
    np.testing.assert_array_equal(electronics.spread_n(same, sides, ONE_TAXEL, AZIMUTH), sides)


def test_unloading_conducts_more_than_loading_and_warmth_less() -> None:
    params = ElectronicsParams(hysteresis=0.1)
    load_n = np.linspace(0.0, 5.0, 11)
    gain = electronics.hysteresis_gain(params, load_n, np.full(11, 5.0))
    assert np.all(np.diff(gain * load_n) > 0)
    assert gain[-1] == 1.0
    assert gain[5] == pytest.approx(1.1)
    np.testing.assert_array_equal(electronics.hysteresis_gain(params, load_n, load_n)[1:], 1.0)
    warmth = electronics.temperature_gain(params, np.array([0.0, 10.0, 1e6]))
    np.testing.assert_allclose(warmth, [1.0, 0.97, 0.1])


def test_multiplexer_and_crosstalk_mix_neighbours_only() -> None:
    taxel = np.repeat([0, 1], 4)
    volts = np.zeros((1, 8))
    volts[0, 2] = 1.0
    slow = electronics.sampled_v(ElectronicsParams(unsettled=0.1), volts, taxel)
    np.testing.assert_allclose(slow[0], [0, 0, 0.9, 0.1, 0, 0, 0, 0])
    picked = electronics.sampled_v(ElectronicsParams(crosstalk=0.2), volts, taxel)
    np.testing.assert_allclose(picked[0], [0.05, 0.05, 0.85, 0.05, 0, 0, 0, 0])
    np.testing.assert_array_equal(electronics.sampled_v(ElectronicsParams(), volts, taxel), volts)

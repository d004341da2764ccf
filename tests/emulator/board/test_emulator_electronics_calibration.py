"""Published sensitivities from the force on a taxel to volts; what rubber and multiplexer do on the way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import FloatArray, load_array
from tactiled.emulator.board import electronics
from tactiled.emulator.board.electronics import ElectronicsParams
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.mechanics.base import Surface
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.scene.description import load_scene

# The constants play these sensitivities, over the forces of contact model `lumped`.
PUBLISHED_SENSITIVITY = load_scene("one-taxel").electronics
AZIMUTH = np.array([180.0, 270.0, 0.0, 90.0])
ONE_TAXEL = np.zeros(4, dtype=np.int64)


def taxel_v(params: ElectronicsParams, side_n: FloatArray) -> FloatArray:
    """Volts of R1..R4 from the forces on the edge areas."""
    quarter = electronics.spread_n(params, electronics.quarter_n(side_n), ONE_TAXEL, AZIMUTH)
    return electronics.divider_v(params, electronics.conductance_s(params, quarter))


def pressed_n(load_n: float, way_mm: tuple[float, float] = (0.0, 0.0)) -> tuple[FloatArray, float]:
    """Forces on R1..R4 of a taxel that is pressed and then moved, and friction, on contact model `lumped`."""
    model, load = Lumped(Surface(0.6), AZIMUTH, 1), np.array([load_n])
    model.step(load, np.zeros((1, 2)), 0.01)
    felt = model.step(load, np.array([way_mm]), 0.01)
    return felt.side_n[0], float(np.linalg.norm(felt.tangential_n))


def test_normal_sensitivities_are_the_published_ones() -> None:
    load_n = np.array([0.0, 6.0, 15.0])
    volts = np.array([taxel_v(PUBLISHED_SENSITIVITY, pressed_n(n)[0]).mean() for n in load_n.tolist()])
    assert np.diff(volts) / np.diff(load_n) == pytest.approx([0.201, 0.067], rel=1e-3)
    assert volts.max() < 3.0  # within the ADC


@pytest.mark.parametrize(("axis", "published"), [(0, 0.471), (1, 0.466)])
def test_shear_sensitivities_are_the_published_ones(axis: int, published: float) -> None:
    """In the middle of the first range, 3 N, under little friction."""
    sides, shear_n = pressed_n(3.0, (1e-4, 0.0) if axis == 0 else (0.0, 1e-4))
    volts = taxel_v(PUBLISHED_SENSITIVITY, sides)
    assert (volts[axis] - volts[axis + 2]) / shear_n == pytest.approx(published, rel=0.003)


def test_a_scene_plays_the_published_sensitivities() -> None:
    """Through contact, sensor and divider; a taxel's areas are unequal by up to 5 %, so over some seeds."""
    played = load_scene("one-taxel")
    array = load_array(played.array)
    (taxel,) = played.touching
    own = np.flatnonzero(array.channel_taxel == taxel)
    ends = np.cumsum([phase.duration_s for phase in played.phases])
    # At rest under 3 N, a little later while the slide begins; then under 6 N and under 15 N.
    instants = np.array([ends[0], ends[0] + 0.02, ends[2] + 6.0, ends[3]])
    normal, shear = [], []
    for seed in range(1, 4):
        sensor = Sensor(played.with_changes(seed=seed), array, adc_bits=12, adc_reference_v=3.0)
        volts = sensor.volts(np.repeat(instants[:, None], array.n_channels, axis=1))[:, own]
        friction = float(np.linalg.norm(sensor.contact.state(instants).tangential_n[1, taxel]))
        difference = volts[:, 0] - volts[:, 2]
        shear.append((difference[1] - difference[0]) / friction)
        mean = volts.mean(axis=1)
        normal.append([mean[2] / 6.0, (mean[3] - mean[2]) / 9.0])
    assert np.mean(shear) == pytest.approx(0.471, rel=0.03)
    assert np.mean(normal, axis=0) == pytest.approx([0.201, 0.067], rel=0.03)


def test_the_constants_of_the_scene_follow_from_the_sensitivities() -> None:
    """0.201 and 0.067 V/N of pressure and 0.471 and 0.466 V/N of shear fix rubber, supply and spread.

    With ``V = U x / (x + c)``, x a quarter of the load less the dead zone and ``c = rubber / divider``, the
    two normal sensitivities, up to 6 N and from there to 15 N, fix U and c. Under 3 N and little friction T,
    an area's force changes by ``imbalance T / N`` of itself, of which the electrode sees ``1 - spread``.
    """
    params = PUBLISHED_SENSITIVITY
    # Of model `lumped`: part of the load that an area bears at rest, over PART_OF_LOAD, at 3 N and from 3.8 N
    # up; left minus right at 3 N, per newton of friction, over twice the area's force at rest and the load.
    at_3_n, at_rest, imbalance = 1.0236, 1.0317, 2.981
    x1, x2 = (n / 4 * at_rest - params.dead_zone_n for n in (6.0, 15.0))
    v1, v2 = 0.201 * 6.0, 0.201 * 6.0 + 0.067 * 9.0
    c = (v2 - v1) / (v1 / x1 - v2 / x2)  # both ask for the same U: v1 (x1 + c) / x1 = v2 (x2 + c) / x2
    supply_v = v1 * (x1 + c) / x1
    slope = supply_v * c / (3.0 / 4 * at_3_n - params.dead_zone_n + c) ** 2
    full = 2 * slope / 4 * at_3_n * imbalance
    assert params.supply_v == pytest.approx(supply_v, rel=1e-4)
    assert params.rubber_ohm_n == pytest.approx(c * params.divider_ohm, rel=1e-4)
    assert params.spread_x == pytest.approx(1 - 0.471 / full, rel=1e-4)
    assert params.spread_y == pytest.approx(1 - 0.466 / full, rel=1e-4)


def test_default_hold_of_20_newtons_reads_about_a_volt_on_edge_areas_too() -> None:
    part = electronics.PART_OF_LOAD
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


def test_warmth_conducts_less() -> None:
    warmth = electronics.temperature_gain(np.array([0.0, 10.0, 1e6]))
    np.testing.assert_allclose(warmth, [1.0, 0.97, 0.1])

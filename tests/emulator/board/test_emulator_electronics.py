"""From newtons to counts, and the scene as the ADC sees it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.array import load_array
from tactiled.emulator.board import electronics
from tactiled.emulator.board.electronics import ElectronicsParams
from tactiled.emulator.board.noise import ScanNoise
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import Scene, load_scene

PARAMS = ElectronicsParams()
WANG = load_array("wang2019-3x3")


def sensor(scene: Scene) -> Sensor:
    return Sensor(scene, load_array(scene.array), adc_bits=12, adc_reference_v=3.0)


def at_rate(start_s: float, end_s: float, rate_hz: float = 100.0) -> NDArray[np.float64]:
    return np.repeat(np.arange(start_s, end_s, 1 / rate_hz)[:, None], 36, axis=1)


@pytest.mark.parametrize("params", [PARAMS, load_scene("one-taxel").electronics])
def test_rubber_has_the_published_sensitivity_and_a_dead_zone(params: ElectronicsParams) -> None:
    force_n = np.linspace(0.02, 0.7, 500)
    resistance = 1 / electronics.conductance_s(params, force_n)
    assert np.all(np.diff(resistance) / np.diff(force_n) < -500e3)  # ohm per newton below 0.7 N
    assert np.all(electronics.conductance_s(params, np.array([-1.0, 0.0, 0.0125])) == 0)


@given(st.lists(st.floats(-10, 1e4), min_size=2, max_size=20))
@settings(max_examples=50)
def test_volts_grow_with_force_and_stay_below_the_supply(force_n: list[float]) -> None:
    volts = electronics.divider_v(PARAMS, electronics.conductance_s(PARAMS, np.sort(force_n)))
    assert np.all(np.diff(volts) >= 0)
    assert np.all((volts >= 0) & (volts < PARAMS.supply_v))


def test_adc_rounds_to_its_counts_and_clips_at_both_ends() -> None:
    lsb = 3.0 / 4096
    counts = electronics.adc_counts(np.array([-1.0, 0.0, 0.4 * lsb, 0.6 * lsb, 1.5, 2.9999, 9.0]), 12, 3.0)
    assert counts.tolist() == [0, 0, 0, 1, 2048, 4095, 4095]


def test_a_hold_of_20_newtons_reads_about_a_volt_on_each_resistor() -> None:
    volts = sensor(load_scene("flat-experiment")).volts(at_rate(15.0, 15.1))
    assert volts.min() > 1.0
    assert volts.max() < 1.5


def test_creep_is_slow_and_small() -> None:
    volts = sensor(load_scene("flat-experiment")).volts(at_rate(8.0, 23.0))
    rise = volts[-1] - volts[0]
    assert np.all((rise > 1e-4) & (rise < 0.03))
    assert np.abs(np.diff(volts, axis=0)).max() < 5e-5  # a twentieth of a count from scan to scan


def slope_change(volts: NDArray[np.float64], at: int) -> NDArray[np.float64]:
    """Volts per second by which the slope differs just behind a scan and before it."""
    return np.asarray(100.0 * ((volts[at + 1] - volts[at]) - (volts[at - 1] - volts[at - 2])))


@pytest.mark.parametrize("name", ["prescribed", "flat-experiment", "flat-simulation"])
def test_slip_is_a_larger_kink_than_holding(name: str) -> None:
    scene = load_scene(name)
    volts = sensor(scene).volts(at_rate(0.0, scene.duration_s))
    starts = np.cumsum([phase.duration_s for phase in scene.phases])
    kinds = [phase.kind for phase in scene.phases]
    hold, slip = (round(100 * starts[kinds.index(kind) - 1]) for kind in ("hold", "slide"))
    for channels, sign in ((slice(0, 36, 4), 1), (slice(2, 36, 4), -1)):  # R1 rises, R3 falls
        slipped = sign * slope_change(volts, slip)[channels]
        assert np.all(slipped > 0.3)
        assert np.all(slipped > 2 * np.abs(slope_change(volts, hold)[channels]))


@given(st.integers(0, 2**62), st.integers(0, 10**6), st.lists(st.integers(1, 300), min_size=1, max_size=5))
@settings(max_examples=30, deadline=None)
def test_noise_depends_on_the_scan_alone(seed: int, first: int, chunks: list[int]) -> None:
    whole = ScanNoise(seed, 3).normal(first, sum(chunks))
    other = ScanNoise(seed, 3)
    parts, at = [], first
    for n in chunks:
        parts.append(other.normal(at, n))
        at += n
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_noise_is_white_normal_and_of_the_stated_size() -> None:
    noise = ScanNoise(5, 36).normal(0, 5000)
    n = noise.size
    assert abs(noise.mean()) < 5 / np.sqrt(n)
    assert abs(noise.std() - 1) < 5 / np.sqrt(2 * n)
    for lag in (noise[1:] * noise[:-1], noise[:, 1:] * noise[:, :-1]):
        assert abs(lag.mean()) < 5 / np.sqrt(lag.size)
    scene = load_scene("flat-experiment").with_changes(electronics={"noise_v": 5e-3, "creep_per_n": 0.0})
    time_s = at_rate(10.0, 20.0)
    counts = sensor(scene).counts(0, time_s)
    rms = (counts * 3.0 / 4096 - sensor(scene).volts(time_s)).std()
    assert rms == pytest.approx(np.hypot(5e-3, 3.0 / 4096 / np.sqrt(12)), rel=0.02)


def test_any_chunking_gives_the_same_counts() -> None:
    time_s = at_rate(5.5, 7.5) + np.arange(36) * 2e-4
    whole = sensor(load_scene("prescribed")).counts(550, time_s)
    other = sensor(load_scene("prescribed"))
    single = [other.counts(550 + k, time_s[k : k + 1]) for k in reversed(range(len(time_s)))]
    np.testing.assert_array_equal(whole, np.concatenate(single[::-1]))


def test_overload_saturates_at_the_top_count() -> None:
    press = {"kind": "press", "duration_s": 1.0, "force_n": 500.0}
    scene = Scene.model_validate({"name": "overload", "phases": [press]})
    assert np.all(sensor(scene).counts(0, at_rate(2.0, 2.1)) == 4095)


@pytest.mark.parametrize("name", ["prescribed", "flat-experiment", "flat-simulation"])
def test_scenes_stay_within_the_range_of_the_adc(name: str) -> None:
    scene = load_scene(name)
    counts = sensor(scene).counts(0, at_rate(0.0, scene.duration_s, 20.0))
    assert counts.max() < 4095
    assert counts[-1].max() > 1000


def test_shear_channels_swing_around_mid_scale() -> None:
    array = load_array("xyz-two-pads-4x4")
    press = {"kind": "press", "duration_s": 1.0, "force_n": 20.0}
    slide = {"kind": "slide", "duration_s": 2.0, "speed_mm_s": 1.0, "direction_deg": 180.0}
    scene = Scene.model_validate({"name": "shear", "array": array.name, "phases": [press, slide]})
    volts = Sensor(scene, array, adc_bits=12, adc_reference_v=3.0).volts(np.full((1, 96), 3.0))[0]
    kinds = np.array(array.channel_kind)
    assert np.all(volts[kinds == "shear_x"] < 1.4)
    np.testing.assert_allclose(volts[kinds == "shear_y"], 1.5)
    assert np.all(volts[kinds == "normal"] > 0.5)

"""Arrays in any unit with any zero: contact, slip and tare are those of the same touch in volts."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from contact_gate import ContactGate
from numpy.typing import NDArray
from scipy import signal
from touches import Touch, contact_states

from tactiled.array import Array, ArrayFile, FloatArray, Grid, TaxelChannel, build, load_array
from tactiled.detect.signal.fast import RestNoise
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import StartZero, TunedSuite
from tactiled.events.types import ContactEvent, Event, SlipEvent
from tactiled.samples.block import ScanBlock, regular_block

WANG = load_array("wang2019-3x3")
TOUCH = Touch(slide_s=2.5, stop_s=4.5, lift_s=5.5, end_s=6.0, uneven=0.1)  # a clear slide


def wang_in(unit: str, low: float, high: float, zero: str) -> Array:
    """The 2019 array with readings in another unit, without declared contact levels."""
    text = Path(__file__).parents[3].joinpath("config/arrays/wang2019-3x3.toml").read_text()
    text = text[: text.index("# Pressure responses")]
    text = text.replace(
        'name = "wang2019-3x3"', f'name = "x"\nunit = "{unit}"\nrange = [{low}, {high}]\nzero = {zero}'
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.toml"
        path.write_text(text)
        return load_array(str(path))


@cache
def counts() -> tuple[Array, ScanBlock, list[Event]]:
    """An array whose zero comes from the data, the touch on it, and its events."""
    array = wang_in("count", 0, 65535, '"first 0.3 s"')
    block = regular_block(np.rint(38000 + 5000 * TOUCH.volts(WANG, 100.0)), 100.0)
    return array, block, told(array, block)


@cache
def slips_in_volts() -> list[SlipEvent]:
    events = told(WANG, regular_block(TOUCH.volts(WANG, 100.0), 100.0))
    return [event for event in events if isinstance(event, SlipEvent)]


def told(array: Array, block: ScanBlock, size: int = 10_000) -> list[Event]:
    suite = TunedSuite(array, DetectParams())
    return [e for n in range(0, len(block), size) for e in suite.process(block[n : n + size])]


@pytest.mark.parametrize(
    ("unit", "low", "high", "zero", "scale", "offset"),
    [
        ("count", 0, 65535, "38000", 5000.0, 38000.0),
        ("count", 0, 65535, '"first 0.3 s"', 5000.0, 38000.0),
        ("count", 0, 4095, '"first 0.3 s"', 500.0, 200.0),
        ("uT", -5000, 5000, '"first 0.3 s"', 300.0, -800.0),
        ("N", -20, 20, "0.0", 2.0, 0.0),
    ],
)
def test_the_same_touch_in_another_unit_is_the_same_contact_and_slip(
    unit: str, low: float, high: float, zero: str, scale: float, offset: float
) -> None:
    volts = TOUCH.volts(WANG, 100.0)
    readings = offset + scale * volts
    if unit == "count":
        readings = np.rint(readings)
    array = wang_in(unit, low, high, zero)
    events = told(array, regular_block(readings, 100.0, valid=array.in_range(readings)))
    slips = [e for e in events if isinstance(e, SlipEvent)]
    expected = slips_in_volts()
    assert [(e.state, e.kind) for e in slips] == [(e.state, e.kind) for e in expected]
    for found, true in zip(slips, expected, strict=True):
        assert found.onset_s == pytest.approx(true.onset_s, abs=0.03)
        if found.state == "onset":
            assert found.direction_deg == pytest.approx(true.direction_deg, abs=3.0)
    contact = [e for e in events if isinstance(e, ContactEvent)]
    assert contact[0].state == "loading"
    assert contact[0].time_s == pytest.approx(0.5, abs=0.25)  # TOUCH presses from 0.5 s on
    assert contact[-1].state == "none"


@pytest.mark.parametrize("size", [1, 7, 64, 300])
def test_events_do_not_depend_on_chunks_where_levels_and_zero_come_from_the_data(size: int) -> None:
    array, block, whole = counts()
    assert told(array, block, size) == whole


def test_noise_alone_is_no_contact_whatever_its_size() -> None:
    array = wang_in("count", 0, 65535, "0.0")
    for sd in (0.3, 5.0, 100.0, 2000.0):
        noise = sd * np.random.default_rng(1).normal(size=(20_000, 36))
        gate = ContactGate(array)
        assert contact_states(gate.process(regular_block(np.rint(noise), 100.0))) == []


def rest_noise(
    steps: FloatArray,
    ok: NDArray[np.bool_] | None = None,
    early: float = 50.0,
    n_mean: int = 0,
    most: float = 1e9,
) -> tuple[FloatArray, list[int]]:
    """Return the noise (n, channels) after each scan, and where it becomes known."""
    rest, noise, known = RestNoise(steps.shape[1], early, n_mean, most), np.empty(steps.shape), []
    flags = np.ones(steps.size, dtype=np.uint8) if ok is None else ok.ravel().astype(np.uint8)
    for k in range(len(steps)):
        if rest.take(k * steps.shape[1], steps.ravel(), flags):
            known.append(k)
        noise[k] = rest.noise
    return noise, known


def test_the_rest_noise_is_that_before_a_contact_and_not_that_of_a_slide() -> None:
    rng = np.random.default_rng(2)
    sd = np.where(np.arange(3000) < 1000, 10.0, 200.0)[:, np.newaxis]
    found, known = rest_noise(np.rint(sd * rng.normal(size=(3000, 4)) + np.arange(3000)[:, np.newaxis]))
    assert known == [3, 15]
    assert (found[:3] == 2.0**23).all()  # unknown
    assert (found[3:15] == 50.0).all()  # no less than was said
    assert (found[15:] < 14.0).all()
    assert (found[15:] > 3.0).all()
    assert (
        np.diff(np.delete(found, 127, axis=0), axis=0)[127:] <= 0
    ).all()  # the mean of eight groups may be more


def test_the_noise_at_rest_is_not_told_less_with_time() -> None:
    """The least of single groups would be below 0.3 of the true noise."""
    noise, _ = rest_noise(np.random.default_rng(4).normal(size=(100_000, 4)) * 1000.0, n_mean=16)
    assert (noise[-1] > 500.0).all()
    assert (noise[-1] < 1000.0).all()


@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_the_rest_noise_is_that_of_the_quietest_whole_groups_and_of_medians_before(lost: float) -> None:
    rng = np.random.default_rng(3)
    steps = np.rint(rng.choice([0.3, 5.0, 900.0], (1, 6)) * rng.normal(size=(160, 6)))
    ok: NDArray[np.bool_] = np.asarray(rng.random(steps.shape) >= lost)
    found, _ = rest_noise(steps, ok, early=0.01)
    groups, whole = steps.reshape(10, 16, 6), np.asarray(ok.reshape(10, 16, 6).all(axis=1))
    power = (np.diff(groups, 2, axis=1) ** 2).mean(axis=1) / 6  # of second differences of white noise
    least = [
        min(4.0 * read[:7].min(), read[:8].mean()) if len(read) >= 8 else read.min()
        for read in (power[whole[:, c], c] for c in range(6))
    ]
    change = np.abs(np.diff(groups, axis=1))
    step = np.where((change > 0) & whole[:, np.newaxis], change, np.inf).min(axis=(0, 1))
    rounding = np.where(np.isfinite(step), step, 0.0) / np.sqrt(12)
    np.testing.assert_allclose(found[-1], np.maximum(np.sqrt(least), rounding), rtol=1e-12)
    bend = np.abs(np.diff(steps[:10], 2, axis=0))
    bend[~(ok[2:10] & ok[1:9] & ok[:8])] = np.nan
    early_step = np.abs(np.diff(steps[:10], axis=0))[ok[1:10] & ok[:9]]
    half = 0.5 * early_step[early_step > 0].min()
    of_all = spread_median(bend.ravel(), half) / (0.6745 * np.sqrt(6))
    of_each = np.array([spread_median(own, half) for own in bend.T]) / (0.6745 * np.sqrt(6))
    least = of_all * min(1.0, np.exp(3 * 1.63 / np.sqrt(np.isfinite(bend).sum())) / 2)
    expected = np.where(of_each > 2 * of_all, of_each, least)
    np.testing.assert_allclose(found[9], np.maximum(expected, 0.01), rtol=1e-12)


def test_readings_that_wander_are_as_noisy_as_their_means_and_white_ones_are_not() -> None:
    rng = np.random.default_rng(5)
    white = 10.0 * rng.normal(size=(2000, 6))
    below_1_hz = signal.butter(2, 1.0, fs=100.0, output="sos")
    wandering = signal.sosfilt(below_1_hz, 100.0 * rng.normal(size=(2000, 6)), axis=0)
    steps = np.hstack([white, wandering])
    plain, _ = rest_noise(steps, n_mean=0)
    slow, _ = rest_noise(steps, n_mean=16)
    np.testing.assert_array_equal(slow[:, :6], plain[:, :6])
    means = wandering.reshape(125, 16, 6).mean(axis=1)
    bends = np.diff(means, 2, axis=0) ** 2 / 6
    windows = np.lib.stride_tricks.sliding_window_view(bends, 6, axis=0).mean(axis=-1)
    least = np.minimum(4.0 * windows[:63].min(axis=0), windows[:64].mean(axis=0))
    np.testing.assert_allclose(slow[-1, 6:], np.sqrt(least), rtol=1e-9)
    assert (slow[-1, 6:] > 10 * plain[-1, 6:]).all()
    bounded, _ = rest_noise(steps, n_mean=16, most=0.1)
    np.testing.assert_array_equal(bounded[-1], np.maximum(plain[-1], 0.1))


def spread_median(values: FloatArray, half: float) -> float:
    """Return the median of finite values, of which equal ones are spread evenly over a step."""
    known = values[np.isfinite(values)]
    middle = float(np.median(known))
    same, below = int((known == middle).sum()), int((known < middle).sum())
    if same == 0:
        return middle
    return float(np.interp(0.5 * len(known), [below, below + same], [max(middle - half, 0.0), middle + half]))


@pytest.mark.parametrize("hum", [0.0, 200.0])
def test_a_press_soon_after_the_start_is_told_at_once_and_hum_is_none(hum: float) -> None:
    array = wang_in("count", 0, 65535, "0.0")
    rng, scan = np.random.default_rng(4), np.arange(60)
    rest = 3.0 * rng.normal(size=(60, 36)) + hum * np.sin(2 * np.pi * 0.13 * scan)[:, np.newaxis]
    pressed = np.where(scan < 8, 0.0, 20_000.0)[:, np.newaxis]
    assert contact_states(ContactGate(array).process(regular_block(np.rint(rest), 100.0))) == []
    events = ContactGate(array).process(regular_block(np.rint(rest + pressed), 100.0))
    assert contact_states(events)[0] == "loading"
    assert events[0].evidence_s == pytest.approx(0.08)


def pad_of_counts() -> Array:
    """Nine taxels of one channel, without a level of contact."""
    places = [0.0, 4.0, 8.0]
    return build(
        ArrayFile(
            name="pad",
            unit="count",
            range=(0, 65535),
            zero=0.0,
            grids=(Grid(x_mm=places, y_mm=places),),
            taxel_channels=(TaxelChannel(name="N", kind="normal"),),
        )
    )


@pytest.mark.parametrize("sd", [650.0, 1300.0])
def test_one_noisy_channel_is_no_contact_in_the_first_scans(sd: float) -> None:
    array = pad_of_counts()
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(40, 9)) * np.where(np.arange(9) == 4, sd, 3.0)
        assert contact_states(ContactGate(array).process(regular_block(np.rint(noise), 100.0))) == []


def hand_of_counts() -> Array:
    """Forty cells of 8 bits, without a level of contact."""
    return build(
        ArrayFile(
            name="hand",
            unit="count",
            range=(0, 255),
            zero="first 0.3 s",
            taxel_count=40,
            taxel_channels=(TaxelChannel(name="N", kind="normal"),),
        )
    )


@pytest.mark.parametrize("sd", [0.2, 0.3, 0.4])
def test_a_grasp_of_few_scans_is_told_from_the_noise_of_whole_counts(sd: float) -> None:
    array, scan = hand_of_counts(), np.arange(12)
    load = np.clip(scan - 4, 0, 6)[:, np.newaxis] * (np.arange(40) < 3)
    n_told = 0
    for seed in range(20):
        rest = 200.0 + np.random.default_rng(seed).uniform(size=40)
        noise = sd * np.random.default_rng(100 + seed).normal(size=(12, 40))
        empty, grasp = np.rint(rest + noise), np.rint(rest + noise + load)
        assert contact_states(told(array, regular_block(empty, 10.0))) == []
        n_told += contact_states(told(array, regular_block(grasp, 10.0))) != []
    assert n_told >= 19


@pytest.mark.parametrize("dead", [[], [0, 1], [3, 4, 5, 6, 7, 8]])
@pytest.mark.parametrize("missing", [[], [1], [2, 7]])
def test_a_press_from_the_first_scan_has_an_unknown_beginning(dead: list[int], missing: list[int]) -> None:
    counts = np.rint(20_000.0 + 5.0 * np.random.default_rng(5).normal(size=(60, 9)))
    counts[:, dead] = np.nan
    counts[missing, 2] = np.nan
    events = ContactGate(pad_of_counts()).process(regular_block(counts, 100.0))
    assert contact_states(events)[0] == "unknown"


def test_counts_that_flicker_by_one_are_no_contact() -> None:
    array = wang_in("count", 0, 255, "0.0")
    rng = np.random.default_rng(6)
    flicker = (rng.random((500, 36)) < 0.02).astype(np.float64)
    assert contact_states(ContactGate(array).process(regular_block(flicker, 100.0))) == []


def test_a_tare_replaces_the_zero_of_the_array() -> None:
    array = wang_in("count", 0, 65535, "38000")
    suite = TunedSuite(array, DetectParams())
    rng = np.random.default_rng(3)
    assert suite.process(regular_block(45_000 + rng.normal(0, 3, (200, 36)), 100.0)) != []
    reason, _ = suite.tare(force=True)
    assert reason == ""
    resting = regular_block(45_000 + rng.normal(0, 3, (200, 36)), 100.0, start_s=2.0, index=200)
    assert suite.process(resting) == []


def test_a_channel_without_a_zero_is_left_out() -> None:
    """Its first reading is no press of its whole value; the others go on."""
    pad = replace(wang_in("count", 0, 65535, "38000"), zero_first_s=0.3)
    volts = 38_000 + np.random.default_rng(3).normal(0, 3, (300, 36))
    volts[:40, 4:8] = np.nan  # a taxel comes up late
    valid = np.isfinite(volts)
    assert TunedSuite(pad, DetectParams()).process(regular_block(volts, 100.0, valid=valid)) == []
    volts[200:, 8:12] += 4000
    (event, *_) = TunedSuite(pad, DetectParams()).process(regular_block(volts, 100.0, valid=valid))
    assert isinstance(event, ContactEvent)
    assert event.taxels == (2,)


def test_a_start_zero_leaves_out_what_is_invalid() -> None:
    volts = np.array([[1.0, 7.0], [np.nan, 8.0], [3.0, 9.0], [50.0, 50.0]])
    valid = np.array([[True, False], [True, False], [True, False], [True, True]])
    start = StartZero(0.03)
    block = regular_block(volts, 100.0, valid=valid)
    assert start.process(block[:2]) == []
    assert len(start.process(block[2:])) == 2
    assert start.zero is not None
    assert start.zero[0] == 2.0
    assert np.isnan(start.zero[1])


def test_the_grid_reaches_over_the_range_from_the_zero() -> None:
    assert Quantiser(wang_in("count", 0, 65535, "38000")).full_scale_volts == 2**16
    assert Quantiser(WANG).full_scale_volts == 8.0
    assert Quantiser(replace(WANG, low=0.0, high=0.5)).full_scale_volts == 0.5

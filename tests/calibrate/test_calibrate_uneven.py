"""Calibration from logs of others: uneven stamps, a clock of their own or the same, curves of a divider."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import Array, load_array
from tactiled.calibrate.clock import align
from tactiled.calibrate.data import AlignedReference, ReferenceTable, bin_log, pose_log
from tactiled.calibrate.folds import segments
from tactiled.calibrate.study import CalibrationStudy, calibrate, force_walk
from tactiled.calibrate.uncertainty import axis_uncertainty
from tactiled.errors import DataError
from tactiled.force.estimator import ForceEstimator
from tactiled.force.model import low_passed
from tactiled.recording.spacing import to_blocks
from tactiled.scan_log import start_zero

SKIN = load_array("magnetometers-5")
CELL = load_array("load-cell")
PRESS_S = 10.0


def presses_n(time_s: np.ndarray) -> np.ndarray:
    """Normal force (n,): each ten seconds a press that is larger or smaller than the one before."""
    size_n = 12.0 + 6.0 * np.sin(1.7 * np.floor(time_s / PRESS_S))
    return size_n * np.clip(1.4 * np.sin(np.pi * ((time_s % PRESS_S) - 2.0) / 7.0), 0.0, 1.0)


def creeping_skin(time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Readings (n, 15) whose sensitivity grows by a fifth while it is pressed; stamps may be uneven."""
    fine_s = np.arange(0.0, time_s[-1] + 1.0, 0.01)
    force_n = presses_n(fine_s)
    relaxed = low_passed(force_n[:, np.newaxis], np.full(len(fine_s), 0.01), 4.0)[:, 0]
    seen = np.interp(time_s, fine_s, force_n + 0.2 * relaxed)
    gains = np.random.default_rng(1).normal(30.0, 20.0, SKIN.n_channels)  # signs differ from chip to chip
    return np.asarray(seen[:, np.newaxis] * gains + 1.0 * rng.standard_normal((len(time_s), len(gains))))


def uneven_s(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Stamps as of a program that reads two devices in turn: 35, 73 and 136 ms, and pauses of 1 s."""
    steps_s = rng.choice([0.035, 0.073, 0.136, 1.0], 20 * int(seconds), p=[0.2, 0.5, 0.29, 0.01])
    time_s = np.cumsum(steps_s)
    return np.asarray(time_s[time_s < seconds])


def reference(late_s: float = 0.0, seconds: float = 100.0, rate_hz: float = 50.0) -> ReferenceTable:
    time_s = np.arange(0.0, seconds, 1 / rate_hz)
    values = np.full((len(time_s), 6), np.nan)
    values[:, 2] = presses_n(time_s)
    return ReferenceTable(time_s + late_s, values)


def live_error_n(
    found: CalibrationStudy, array: Array, time_s: np.ndarray, readings: np.ndarray
) -> np.ndarray:
    """Errors (n,) of the running estimator on a log, whose beginning is the zero."""
    estimator = ForceEstimator(array, found.file)
    relative = readings - start_zero(time_s, readings, array)
    blocks = to_blocks(time_s, relative, None, np.isfinite(readings))
    events = [event for block in blocks for event in estimator.process(block)]
    found_n = np.array([event.fz_n for event in events])
    return np.asarray(found_n - presses_n(np.array([event.time_s for event in events])))


def test_an_uneven_log_is_calibrated_as_well_as_an_even_one() -> None:
    rng = np.random.default_rng(0)
    for time_s in (np.arange(0.0, 100.0, 0.07), uneven_s(100.0, rng)):
        found = calibrate(SKIN, time_s, creeping_skin(time_s, rng), reference(), "skin")
        assert found.file.smooth is not None
        assert found.file.smooth.creep_s
        later_s = uneven_s(200.0, np.random.default_rng(5))
        error_n = live_error_n(found, SKIN, later_s, creeping_skin(later_s, rng))[later_s > 100.0]
        assert np.sqrt((error_n**2).mean()) < 0.15


def test_the_offset_of_the_clocks_is_within_its_standard_deviation() -> None:
    misses = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        time_s, late_s = uneven_s(100.0, rng), float(rng.uniform(-1.0, 1.0))
        found = calibrate(SKIN, time_s, creeping_skin(time_s, rng), reference(late_s), "skin")
        assert 0.0 < found.late_sd_s < 0.5
        misses.append((found.late_s - late_s) / found.late_sd_s)
    assert max(np.abs(misses)) < 4.0


def test_records_of_one_clock_are_not_moved() -> None:
    rng = np.random.default_rng(3)
    time_s = uneven_s(100.0, rng)
    readings = creeping_skin(time_s, rng)
    found = calibrate(SKIN, time_s, readings, reference(), "skin", is_same_clock=True)
    assert (found.late_s, found.late_sd_s) == (0.0, 0.0)
    with pytest.raises(DataError, match="overlap"):
        calibrate(SKIN, time_s + 500.0, readings, reference(), "skin", is_same_clock=True)


@pytest.mark.parametrize(("log_from_s", "origin_s"), [(0.0, 30.0), (0.0, -70.0), (0.0, 1e9), (30.0, 0.0)])
def test_clocks_of_other_origins_are_told_from_records_that_began_apart(
    log_from_s: float, origin_s: float
) -> None:
    """Both records began together, or one later than the other by the same clock."""
    time_s = np.arange(0.0, 100.0, 0.04)
    readings = creeping_skin(time_s, np.random.default_rng(0))
    rows = time_s >= log_from_s
    found = calibrate(SKIN, time_s[rows] + origin_s, readings[rows], reference(), "skin")
    assert found.late_s == pytest.approx(-origin_s, abs=0.1)
    assert found.rms[2] < 0.4


@pytest.mark.parametrize("offset_n", [0.0, 5.0])
def test_a_press_in_a_pause_of_the_reference_is_no_force_of_zero(offset_n: float) -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 100.0, 0.04)
    table, readings = reference(), creeping_skin(time_s, rng)
    whole = calibrate(SKIN, time_s, readings, table, "skin")
    seen = (table.time_s < 31.0) | (table.time_s > 51.0)  # two presses are missing
    holed = ReferenceTable(table.time_s[seen], table.values[seen] + offset_n)
    found = calibrate(SKIN, time_s, readings, holed, "skin")
    for one in (whole, found):
        assert np.sqrt((live_error_n(one, SKIN, time_s, readings) ** 2).mean()) < 0.4
    assert any("s were left out: the reference pauses" in words for words in found.file.verdict)


@pytest.mark.parametrize(("late_s", "seed"), [(0.0, 0), (0.0, 3), (3.0, 0)])
def test_a_hole_does_not_mislead_the_clocks(late_s: float, seed: int) -> None:
    """Presses repeat: with a straight line over the hole, another offset resembles the log more."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 100.0, 0.04)
    table, readings = reference(), creeping_skin(time_s, rng)
    readings += 3.0 * rng.standard_normal(readings.shape)
    seen = (table.time_s < 31.0) | (table.time_s > 51.0)
    holed = ReferenceTable(table.time_s[seen] + late_s, table.values[seen])
    found = calibrate(SKIN, time_s, readings, holed, "skin")
    assert found.late_s == pytest.approx(late_s, abs=0.1)
    assert np.sqrt((live_error_n(found, SKIN, time_s, readings) ** 2).mean()) < 0.4


@pytest.mark.parametrize("is_same_clock", [False, True])
def test_a_reference_that_stutters_is_taken(is_same_clock: bool) -> None:
    """Presses of 2.5 s, and each 8 s a pause of 1.2 s: within some seconds of every bin one is unseen."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 100.0, 0.04)
    table, force_n = reference(), presses_n(4.0 * time_s)
    table.values[:, 2] = presses_n(4.0 * table.time_s)
    seen = (table.time_s - 3.3) % 8.0 > 1.2
    stuttering = ReferenceTable(table.time_s[seen], table.values[seen])
    readings = (force_n + 0.05 * rng.standard_normal(len(time_s)))[:, np.newaxis]
    found = calibrate(CELL, time_s, readings, stuttering, "cell", is_same_clock=is_same_clock)
    assert found.late_s == pytest.approx(0.0, abs=0.1)
    assert np.sqrt((found.left_out[:, 2] ** 2).mean()) < 0.3


def test_noise_bends_no_pause_of_one_channel() -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 100.0, 0.04)
    table, force_n = reference(), presses_n(time_s)
    value = np.round(table.values[:, 2], 1)
    rows = np.flatnonzero(np.diff(value, prepend=np.nan, append=np.nan)[:-1] != 0)
    rows = np.unique(np.concatenate([rows, np.maximum(rows - 1, 0)]))
    readings = (force_n + 0.5 * rng.standard_normal(len(time_s)))[:, np.newaxis]
    written = ReferenceTable(table.time_s[rows], table.values[rows])
    found = calibrate(CELL, time_s, readings, written, "cell")
    assert not any("left out: the reference" in words for words in found.file.verdict)


def test_the_reference_is_a_straight_line_between_its_samples() -> None:
    time_s = np.arange(0.0, 10.0, 0.02)
    slow_s = np.arange(0.0, 10.1, 1.0)
    values = np.zeros((len(slow_s), 6))
    values[:, 2] = slow_s**2
    table = ReferenceTable(slow_s, values)
    log = bin_log(time_s, np.zeros((len(time_s), SKIN.n_channels)), SKIN)
    means = AlignedReference(table, log).means(0.0, 0.0)[:, 2]
    middle_s = (log.start_s + log.end_s) / 2
    at_once = np.floor(log.start_s) == np.floor(log.end_s)  # a bin with a sample in it has a bent line
    assert at_once.sum() > 100
    assert means[at_once] == pytest.approx(np.interp(middle_s, slow_s, slow_s**2)[at_once])


@pytest.mark.parametrize(
    ("offset_n", "noise", "seed", "error_n"),
    [(0.0, 0.0, 0, 0.2), (5.0, 0.0, 0, 0.2), *((0.0, 45.0, seed, 2.0) for seed in range(3))],
)
def test_a_reference_that_is_written_on_a_change_is_used_whole(
    offset_n: float, noise: float, seed: int, error_n: float
) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 100.0, 0.04)
    table, readings = reference(), creeping_skin(time_s, rng)
    readings += noise * rng.standard_normal(readings.shape)
    value = np.round(table.values[:, 2], 1)
    changes = np.flatnonzero(np.diff(value, prepend=np.nan) != 0)
    rows = np.unique(np.concatenate([changes, np.maximum(changes - 1, 0)]))
    written = ReferenceTable(table.time_s[rows], table.values[rows] + offset_n)
    found = calibrate(SKIN, time_s, readings, written, "skin")
    assert not any("left out: the reference" in words for words in found.file.verdict)
    assert np.sqrt((live_error_n(found, SKIN, time_s, readings) ** 2).mean()) < error_n


def test_records_that_overlap_at_one_offset_only_are_aligned() -> None:
    time_s = np.arange(0.0, 100.0, 0.03)
    log = bin_log(time_s, np.outer(presses_n(time_s), np.ones(SKIN.n_channels)), SKIN)
    table = reference()
    table.values[:, 2] = presses_n(np.maximum(table.time_s - 94.98, 0.0))
    found = align(log, AlignedReference(table, log), SKIN, [99.98], np.zeros(len(log), dtype=np.bool_))
    assert found.late_s == pytest.approx(94.98)
    assert 0.0 < found.sd_s < 0.02


@pytest.mark.parametrize("curve", ["log", "inverse"])
def test_a_resistive_cell_follows_the_curve_of_its_divider(curve: str) -> None:
    cell = replace(CELL, unit="V", zero_first_s=1.0)
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 100.0, 0.02)
    force_n = presses_n(time_s)
    falls = np.exp(-force_n / 5.0) if curve == "log" else 1.0 / (1.0 + force_n / 3.0)
    readings = (3.0 * falls + 1e-3 * rng.standard_normal(len(time_s)))[:, np.newaxis]
    found = calibrate(cell, time_s, readings, reference(), "cell")
    assert found.file.smooth is not None
    assert found.file.smooth.curve == curve
    assert found.rms[2] < 0.3 * found.baseline[2]
    error_n = live_error_n(found, cell, time_s, readings)
    assert np.sqrt((error_n**2).mean()) < 1.5 * found.rms[2]


@pytest.mark.parametrize("noise_falls", [True, False])
def test_a_foil_of_low_resistance_may_be_bent_where_its_noise_falls_with_it(noise_falls: bool) -> None:
    """A hundredth of the resistance at rest is clear of a noise that is a part of it."""
    cell = replace(CELL, unit="V", zero_first_s=1.0)
    time_s = np.arange(0.0, 100.0, 0.02)
    ohm = 700.0 / (1.0 + 100.0 * presses_n(time_s) / presses_n(time_s).max())
    noise = (1e-3 * ohm if noise_falls else 2.0) * np.random.default_rng(4).standard_normal(len(time_s))
    curves = bin_log(time_s, (ohm + noise)[:, np.newaxis], cell).curves
    assert curves == (("linear", "log", "inverse") if noise_falls else ("linear",))


@pytest.mark.parametrize(("least_v", "lsb_v"), [(1e-6, 0.0), (0.01, 0.01)])
def test_readings_at_the_rail_or_of_few_steps_are_not_bent(least_v: float, lsb_v: float) -> None:
    cell = replace(CELL, unit="V", zero_first_s=1.0)
    time_s = np.arange(0.0, 100.0, 0.02)
    volts = np.maximum(2.0 - 0.25 * presses_n(time_s), least_v)
    volts = np.maximum(np.rint(volts / lsb_v), 1.0) * lsb_v if lsb_v else volts
    assert bin_log(time_s, volts[:, np.newaxis], cell).curves == ("linear",)


def test_curves_of_poses_do_not_depend_on_their_order() -> None:
    cell = replace(CELL, unit="V", zero=np.full(CELL.n_channels, 3.0), zero_first_s=0.0)
    volts = np.linspace(0.2, 3.0, 40)[:, np.newaxis]
    shuffled = np.random.default_rng(0).permutation(volts)
    assert pose_log(volts, cell).curves == pose_log(shuffled, cell).curves == ("linear", "log", "inverse")


def test_curves_of_a_log_whose_lowest_readings_are_its_first_and_last() -> None:
    cell = replace(CELL, unit="V", zero_first_s=1.0)
    time_s = np.arange(0.0, 1.5, 0.02)
    volts = 3.0 - 0.1 * np.sin(np.pi * time_s / time_s[-1])
    assert bin_log(time_s, (6.0 - volts)[:, np.newaxis], cell).curves == ("linear", "log", "inverse")


@given(
    st.lists(st.floats(0.001, 300.0), min_size=1, max_size=60),
    st.floats(0.05, 50.0),
    st.integers(0, 2**32 - 1),
)
def test_low_passed_values_follow_the_recurrence(steps: list[float], time_s: float, seed: int) -> None:
    values = np.random.default_rng(seed).standard_normal((len(steps), 2))
    state, expected = np.zeros(2), []
    for step_s, value in zip(steps, values, strict=True):
        state = state + (1 - math.exp(-step_s / time_s)) * (value - state)
        expected.append(state)
    assert low_passed(values, np.array(steps), time_s) == pytest.approx(np.array(expected), abs=1e-6)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.005, 0.01, 0.08]))
def test_bins_of_uneven_scans_follow_each_other_and_leave_out_pauses(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    steps_s = scale * rng.uniform(0.5, 1.5, 400)
    pause = int(rng.integers(50, 350))
    steps_s[pause] = 100 * scale
    time_s = np.cumsum(steps_s)
    log = bin_log(time_s, np.zeros((400, SKIN.n_channels)), SKIN)
    assert (log.end_s > log.start_s).all()
    gaps_s = log.start_s[1:] - log.end_s[:-1]
    assert (gaps_s >= -1e-9).all()
    inside_s = float((log.end_s - log.start_s).sum() + gaps_s.sum())
    assert inside_s == pytest.approx(log.end_s[-1] - log.start_s[0])
    n = len(time_s) // log.bin_scans
    in_bins_s = time_s[: n * log.bin_scans].reshape(n, -1)
    whole_s = in_bins_s[np.ptp(in_bins_s, axis=1) < 100 * scale]
    assert log.middle_s == pytest.approx(whole_s.mean(axis=1) - time_s[0])
    assert np.abs(log.middle_s - (log.start_s + log.end_s) / 2).max() < log.bin_scans * scale


@pytest.mark.parametrize("bunch", [1, 2, 4])
def test_bins_of_scans_whose_stamps_come_in_bunches_are_as_long_as_those_of_others(bunch: int) -> None:
    scan = np.arange(1000)
    time_s = (scan // bunch) * bunch / 100.0 + (scan % bunch) * 1e-4
    assert bin_log(time_s, np.zeros((1000, SKIN.n_channels)), SKIN).bin_scans == 4


@pytest.mark.parametrize(("n", "rate_hz"), [(1, 100.0), (2, 100.0), (3, 100.0), (500, 20_000.0)])
def test_a_log_of_a_few_scans_is_refused(n: int, rate_hz: float) -> None:
    readings = np.random.default_rng(0).standard_normal((n, CELL.n_channels))
    with pytest.raises(DataError, match="press for"):
        calibrate(CELL, np.arange(n) / rate_hz, readings, reference(), "cell")


def test_scans_that_are_too_far_apart_are_refused_as_such() -> None:
    time_s = np.arange(0.0, 100.0, 0.5)
    readings = 100.0 + presses_n(5.0 * time_s)[:, np.newaxis]  # presses of two seconds
    with pytest.raises(DataError, match="record at 10 Hz or more"):
        calibrate(CELL, time_s, readings, reference(), "cell")


def test_a_press_is_never_half_in_a_fold() -> None:
    time_s = np.arange(0.0, 100.0, 0.05)
    outputs = np.zeros((len(time_s), 6))
    outputs[:, 2] = presses_n(time_s)
    segment = segments(outputs, [2], 0.05)
    for press in range(10):
        inside = (time_s // PRESS_S == press) & (outputs[:, 2] > 1.0)
        assert len(set(segment[inside].tolist())) == 1


@pytest.mark.parametrize("n", range(1, 13))
def test_the_shortest_record_has_a_bin_in_every_segment(n: int) -> None:
    assert np.bincount(segments(np.ones((n, 6)), [2], 1.0)).min() > 0


def test_a_walk_of_the_error_is_found_and_none_is_made_up() -> None:
    rng = np.random.default_rng(6)
    found = []
    time_s, segment = np.linspace(0.0, 400.0, 4000), np.arange(4000) // 100
    for _ in range(40):
        errors = np.zeros((4000, 6))
        errors[:, 2] = np.cumsum(0.02 * math.sqrt(0.1) * rng.standard_normal(4000))  # 0.02 N in a second
        errors[:, 0] = 0.1 * rng.standard_normal(40)[segment]  # each contact has an error of its own
        found.append(force_walk(errors, time_s, segment))
    squares = np.mean(np.square(found), axis=0)
    assert np.sqrt(squares[2]) == pytest.approx(0.02, rel=0.3)
    assert np.sqrt(squares[0]) < 0.005
    assert force_walk(np.ones((30, 6)), np.arange(30.0), np.arange(30) // 10) == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("n_features", [5, 60, 200])
def test_nine_of_ten_differences_are_inside_whatever_the_number_of_features(n_features: int) -> None:
    rng = np.random.default_rng(n_features)
    features = rng.standard_normal((2000, n_features))
    covariance = np.eye(n_features) / n_features  # most of the error is that of the weights
    left_out = rng.standard_normal(2000)
    force = rng.uniform(0, 5, 2000)
    found = axis_uncertainty("fz", features, covariance, left_out, force, force, 0.0, 200)
    inside = np.abs(left_out) < 1.645 * np.sqrt(found.variance(features, force, force))
    assert 0.88 < inside.mean() < 0.96

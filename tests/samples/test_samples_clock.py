"""The clock fit recovers instants from arrivals that a line delays, bunches and stalls."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.clock import _LINES, LineConditions, timing
from tactiled.emulator.board.scanning import Crystal
from tactiled.emulator.line.faults import FaultParams
from tactiled.samples.clock import STEEPEST_PPM, ClockFit, ClockParams
from tactiled.samples.envelope import Band, lines_through

LATENCY_S = 0.0145
Floats = NDArray[np.float64]


def estimate(
    fit: ClockFit, board_s: Floats, arrival_s: Floats, bunch_s: float = 0.0
) -> tuple[Floats, Floats]:
    """What the fit says after each arrival; an adapter's reads are `bunch_s` apart and end within frames."""
    out = []
    last_s = -np.inf
    for board, arrival in zip(board_s.tolist(), arrival_s.tolist(), strict=True):
        waited_s = bunch_s or (arrival - last_s if arrival > last_s else np.inf)
        fit.add(board, arrival, waited_s, whole=not bunch_s)
        last_s = arrival
        out.append(fit.time_of(board))
    table = np.array(out)
    return table[:, 0], table[:, 1]


@pytest.mark.parametrize(
    ("drift_ppm", "bunch_s"), [(100.0, 0.016), (-100.0, 0.016), (100.0, 0.0), (0.0, 0.0)]
)
def test_instants_within_half_a_millisecond_after_ten_seconds(drift_ppm: float, bunch_s: float) -> None:
    """Bunches, drift and stalls of half a second, as the emulator's line makes them."""
    line = LineConditions("test", drift_ppm, FaultParams(bunch_s=bunch_s, stall_per_s=0.1))
    runs = [timing(line, seed, 30.0) for seed in range(3)]
    error_s = np.concatenate([error[1000:] for error, _ in runs])
    sd_s = np.concatenate([sd[1000:] for _, sd in runs])
    assert np.sqrt(np.mean(error_s**2)) < 0.5e-3
    assert np.sqrt(np.mean((error_s / sd_s) ** 2)) < 1.5  # the stated sigma is no boast
    assert np.sqrt(np.mean(sd_s**2)) < 1e-3  # and not useless


def test_sixteen_millisecond_steps_without_relative_drift_stay_inside_the_stated_sigma() -> None:
    """Nothing moves, so nothing narrows the step of 2 ms: the fit must know that it does not know."""
    line = LineConditions("test", 0.0, FaultParams(bunch_s=0.016))
    worst = 0.0
    for seed in range(4):
        error_s, sd_s = timing(line, seed, 20.0)
        worst = max(worst, float(np.max(np.abs(error_s / sd_s)[1000:])))
    assert 0.3 < worst < 2.5  # uniform errors end at 1.7 sigma


def test_a_step_of_the_board_clock_is_followed_after_a_few_scans() -> None:
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(500):
        fit.add(k * 0.01, 100 + k * 0.01)
    for k in range(500, 510):  # board seconds jump ahead by one second: arrivals look too early
        fit.add(k * 0.01 + 1.0, 100 + k * 0.01)
    time_s, _ = fit.time_of(5.09 + 1.0)
    assert time_s == pytest.approx(105.09, abs=1e-6)


def test_one_impossible_arrival_moves_nothing() -> None:
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(500):
        fit.add(k * 0.01, 100 + k * 0.01)
    fit.add(6.0, 104.9)
    assert fit.time_of(5.0)[0] == pytest.approx(105.0, abs=1e-6)


def test_no_drift_over_a_hundred_million_scans() -> None:
    """Board time as large as 10^8 scans make it: nothing loses precision, memory is bounded."""
    fit = ClockFit(ClockParams(), 0.0)
    start = 1e6
    for k in range(3000):
        fit.add(start + k * 0.01, 5e6 + k * 0.01)
    assert fit.time_of(start + 29.99)[0] == pytest.approx(5e6 + 29.99, abs=1e-4)
    assert len(fit._bands) <= ClockParams().window_buckets  # noqa: SLF001  the bound on memory


@given(
    slope=st.floats(-2e-4, 2e-4),
    offset=st.floats(-5, 5),
    widths=st.lists(st.floats(1e-5, 1e-2), min_size=2, max_size=30),
)
def test_the_mean_line_passes_through_every_band(slope: float, offset: float, widths: list[float]) -> None:
    bands = [
        Band(x + 0.3, offset + slope * (x + 0.3) - w, float(x), offset + slope * x + w / 3)
        for x, w in enumerate(widths)
    ]
    line = lines_through(bands, 3e-4, 3e-4).line
    for band in bands:
        assert line.at(band.low_x) >= band.low - 1e-9
        assert line.at(band.high_x) <= band.high + 1e-9
        assert line.variance_at(band.low_x) >= 0


def test_moments_agree_with_sampling() -> None:
    """Centroid and covariance of the feasible lines against brute force."""
    bands = [Band(0.0, -1.0, 0.0, 1.0), Band(1.0, -0.4, 1.0, 0.7), Band(2.0, -1.0, 2.0, 0.5)]
    line = lines_through(bands, 10.0, 10.0).line
    rng = np.random.default_rng(0)
    y0, y1 = rng.uniform(-3, 3, (2, 400_000))
    middle = (y0 + y1) / 2
    inside = (abs(y0) <= 1) & (y1 >= -1) & (y1 <= 0.5) & (middle >= -0.4) & (middle <= 0.7)
    assert line.y0 == pytest.approx(y0[inside].mean(), abs=0.01)
    assert line.at(line.x1) == pytest.approx(y1[inside].mean(), abs=0.01)
    assert line.var00 == pytest.approx(y0[inside].var(), abs=0.01)
    assert line.var01 == pytest.approx(np.cov(y0[inside], y1[inside])[0, 1], abs=0.01)


def test_bounds_that_contradict_newer_ones_are_ignored() -> None:
    """The old band says 5 to 6, the newer two say -1 to 0: the clock was slewed, the newer hold."""
    bands = [Band(0.0, 5.0, 0.0, 6.0), Band(1.0, -1.0, 1.0, 0.0), Band(2.0, -1.0, 2.0, 0.0)]
    line = lines_through(bands, 1e-3, 0.05).line
    assert -1.1 <= line.at(2.0) <= 0.1
    assert -1.1 <= line.at(1.0) <= 0.1


@pytest.mark.parametrize(
    ("bunch_s", "rate_hz", "drift_ppm"),
    [
        (0.001, 100.0, 5.0),
        (0.005, 100.0, 5.0),
        (0.016, 50.0, 30.0),
        (0.004, 125.0, 30.0),
        (0.010, 100.0, 5.0),
    ],
)
def test_errors_match_the_stated_sigma_for_any_adapter_timer(
    bunch_s: float, rate_hz: float, drift_ppm: float
) -> None:
    """Timers that divide the scan period hide a constant delay; the sigma must know it."""
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        number = np.arange(int(30 * rate_hz))
        true_s = 500.0 + rng.uniform(0, 0.02) + number / rate_hz / (1 + drift_ppm * 1e-6)
        arrival_s = np.ceil((true_s + LATENCY_S) / bunch_s) * bunch_s
        board_s = np.asarray(number / rate_hz, dtype=np.float64)
        time_s, sd_s = estimate(ClockFit(ClockParams(), LATENCY_S), board_s, arrival_s, bunch_s)
        ratios.append(((time_s - true_s) / sd_s)[int(10 * rate_hz) :])
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.parametrize("is_configured", [False, True])
def test_a_configured_timer_is_used_where_reads_do_not_reveal_it(is_configured: bool) -> None:
    """16 ms hand-overs of whole 62.5 Hz frames look like a perfect line, 8 ms off on the average."""
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        number = np.arange(2000)
        true_s = 500.0 + rng.uniform(0, 0.016) + number * 0.016
        arrival_s = np.ceil((true_s + LATENCY_S) / 0.016) * 0.016
        fit = ClockFit(ClockParams(handover_s=0.016 if is_configured else None), LATENCY_S)
        fit.handover_s = 0.016
        time_s, sd_s = estimate(fit, np.asarray(number * 0.016, dtype=np.float64), arrival_s)
        ratios.append(((time_s - true_s) / sd_s)[-1])
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.parametrize("rate_hz", [4.0, 35.7, 100.0])
@pytest.mark.parametrize("reads", [1, 5])
def test_the_backlog_of_a_stall_does_not_move_the_clock(rate_hz: float, reads: int) -> None:
    """Whole seconds of scans that all came late, in one read or in several close together."""
    fit = ClockFit(ClockParams(), 0.0)
    period_s = 1 / rate_hz
    for k in range(int(60 * rate_hz)):
        true_s = 100 + k * period_s
        begin_s = 130.3 if true_s < 145 else 150.3
        stalled = begin_s <= true_s < begin_s + 2.4
        # The backlog in order, a few reads of it 0.2 ms apart.
        part = math.floor(reads * (true_s - begin_s) / 2.4) * 2e-4 if stalled else 0.0
        arrival_s = begin_s + 2.4 + part if stalled else true_s
        waited_s = math.inf if stalled and part else 2.4 if stalled else period_s
        fit.add(k * period_s, arrival_s, waited_s)
        if true_s > 110:
            time_s, sd_s = fit.time_of(k * period_s)
            assert time_s == pytest.approx(true_s, abs=1e-3)
            assert sd_s < 1e-2


def test_a_board_whose_clock_lost_time_is_followed_after_a_while() -> None:
    """Ticks stood still for half a second: from then on everything is late, and stays so."""
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(5000):
        fit.add(k * 0.01, 100 + k * 0.01 + (0.5 if k > 2000 else 0.0), 0.01)
    assert fit.time_of(49.99)[0] == pytest.approx(150.49, abs=1e-3)


@pytest.mark.parametrize("bunch_s", [0.0, 0.016])
@pytest.mark.parametrize("drift", [-0.03, -0.01, -0.001, 0.001, 0.01, 0.03])
def test_a_clock_beyond_the_limit_stays_inside_its_sigma_and_is_named(drift: float, bunch_s: float) -> None:
    """From the first scan on: a board whose clock is off by more than two crystals can be."""
    params = ClockParams()
    rng = np.random.default_rng(1)
    number = np.arange(2500)
    true_s = 500.0 + rng.uniform(0, 0.02) + number * 0.01 / (1 + drift)
    arrival_s = true_s + LATENCY_S + rng.uniform(0, 1e-4, len(number))
    if bunch_s:
        arrival_s = np.ceil(arrival_s / bunch_s) * bunch_s
    fit = ClockFit(params, LATENCY_S)
    time_s, sd_s = estimate(fit, np.asarray(number * 0.01, dtype=np.float64), arrival_s, bunch_s)
    ratio = (time_s - true_s) / sd_s
    assert np.sqrt(np.mean(ratio**2)) < 1.8  # a truth at the end of a band is sqrt(3) sigma from its middle
    assert np.mean(np.abs(ratio) > 3) < 0.003
    assert np.max(sd_s[1000:]) < 0.02  # and not useless
    if abs(drift) >= 0.01 or not bunch_s:
        assert "max_drift_ppm = 200" in fit.warning
        assert ("too fast" if drift > 0 else "too slow") in fit.warning
        setting = float(fit.warning.split("set samples.clock.max_drift_ppm = ")[1].split(",")[0])
        assert setting > abs(drift) * 1e6
        told = ClockFit(ClockParams(max_drift_ppm=setting), LATENCY_S)
        estimate(told, np.asarray(number * 0.01, dtype=np.float64), arrival_s, bunch_s)
        assert told.warning == ""


@pytest.mark.parametrize(
    ("bunch_s", "stall_per_s", "drift_ppm"),
    [(0.010, 0.0, 5.0), (0.001, 0.0, 5.0), (0.016, 0.1, -100.0), (0.0, 0.1, 100.0)],
)
def test_with_pings_sigma_is_small_and_correct_for_any_adapter(
    bunch_s: float, stall_per_s: float, drift_ppm: float
) -> None:
    line = LineConditions("test", drift_ppm, FaultParams(bunch_s=bunch_s, stall_per_s=stall_per_s))
    runs = [timing(line, seed, 20.0, pings=True) for seed in range(2)]
    error_s = np.concatenate([error[1000:] for error, _ in runs])
    sd_s = np.concatenate([sd[1000:] for _, sd in runs])
    assert np.sqrt(np.mean((error_s / sd_s) ** 2)) < 1.5
    assert np.sqrt(np.mean(error_s**2)) < 0.3e-3
    assert np.sqrt(np.mean(sd_s**2)) < 0.3e-3


@pytest.mark.parametrize("drift_ppm", [50.0, -10_000.0])
def test_a_busy_host_does_not_make_sigma_smaller_than_the_error(drift_ppm: float) -> None:
    """It reads 5 ms late on average, so that hand-overs look later than they were; pings bound both sides."""
    line = LineConditions("test", drift_ppm, FaultParams(bunch_s=0.016), wake_s=0.005)
    for seed in range(2):
        error_s, sd_s = timing(line, seed, 40.0, pings=True)
        errors = np.abs(error_s / sd_s)[1000:]
        assert np.sqrt(np.mean(errors**2)) < 1.5
        assert np.mean(errors > 5.0) == 0.0
        assert np.median(sd_s[1000:]) < 0.3e-3


def test_the_bench_says_which_way_a_clock_is_off() -> None:
    """Its error without pings is four times as large behind a slow clock as behind a fast one."""
    (line,) = (one for one in _LINES if "1 %" in one.name)
    counted_s = Crystal(0.0, line.drift_ppm, tick_s=1e-6, bits=32).board_s(100.0)
    assert counted_s == pytest.approx(99.0)
    assert "slow" in line.name


def test_pings_that_are_answered_no_more_leave_the_bounds_to_the_reads() -> None:
    fit, rng = ClockFit(ClockParams(), 0.0), np.random.default_rng(5)
    for k in range(20_000):
        at_s = k * 0.01
        fit.add(at_s, 100 + at_s + float(rng.exponential(1e-4)), 0.01)
        if k < 500 and k % 90 == 40:
            fit.answered(at_s, 100 + at_s - 5e-4, 100 + at_s + 5e-4)
        time_s, sd_s = fit.time_of(at_s)
        if k > 1000:
            assert abs(time_s - 100 - at_s) < 5 * sd_s
            assert sd_s < 5e-3


def test_a_host_clock_that_is_slewed_the_other_way_is_followed_between_two_answers() -> None:
    """It runs 1 % fast for half a minute, then 1 % slow; each second has an answer."""
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(2000):
        board_s = k * 0.04
        host_s = 100 + float(np.interp(board_s, (0, 20, 50, 80), (0, 20, 50.3, 80)))
        fit.add(board_s, host_s + 0.001, 0.04)
        if k % 25 == 12:
            fit.answered(board_s, host_s - 0.001, host_s + 0.001)
        assert abs(fit.time_of(board_s)[0] - host_s) < 1e-6 * STEEPEST_PPM


def test_a_round_trip_through_a_backlog_and_ticks_of_another_clock_move_nothing() -> None:
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(500):
        fit.add(k * 0.01, 100 + k * 0.01, 0.01)
    before = fit.time_of(4.995)
    fit.answered(4.995, 100 + 4.995 - 3.0, 100 + 4.995 + 5.0)  # sent 3 s before, read 5 s after
    fit.answered(1e5, 105.0, 105.1)
    fit.answered(4.999, 107.0, 107.1)  # two seconds after the board's clock can have read this
    for k in range(500, 700):
        fit.add(k * 0.01, 100 + k * 0.01, 0.01)
    assert fit.time_of(4.995) == pytest.approx(before, abs=1e-5)


def test_a_stall_longer_than_a_bucket_moves_nothing_once_pings_are_answered() -> None:
    """A whole bucket of backlog has no bound from below, and no bound that is made up in its place."""
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(1200):
        true_s = 100 + k * 0.05
        stalled = 130.3 <= true_s < 134.3
        fit.add(k * 0.05, 134.3 if stalled else true_s + 0.004, math.inf if stalled else 0.05)
        if k % 20 == 10 and not stalled:
            fit.answered(k * 0.05 + 0.01, true_s + 0.0095, true_s + 0.03)
        if k > 200:
            time_s, sd_s = fit.time_of(k * 0.05)
            assert abs(time_s - true_s) < 5e-3
            assert sd_s < 5e-3


def test_a_ping_revokes_the_assumption_of_unbunched_frames() -> None:
    """Whole frames each 10 ms from a 10 ms timer look like a line that nothing bunches, and are 6 ms late."""
    fit = ClockFit(ClockParams(), 0.0)
    for k in range(1000):
        fit.add(k * 0.01, 100 + k * 0.01 + 0.006, 0.01)
        if k % 100 == 50:
            fit.answered(k * 0.01 + 0.002, 100 + k * 0.01 + 0.0018, 100 + k * 0.01 + 0.016)
        if k == 300 or k == 999:
            time_s, sd_s = fit.time_of(k * 0.01)
            assert abs(time_s - 100 - k * 0.01) < 1.8 * sd_s
            assert sd_s < 3e-3


def test_a_reading_of_the_board_is_behind_only_beyond_what_the_fit_may_err() -> None:
    params = ClockParams()
    fit = ClockFit(params, 0.0)
    for k in range(500):
        fit.add(k * 0.01, 100 + k * 0.01)
    time_s, sd_s = fit.time_of(5.0)
    assert sd_s > 0
    assert not fit.is_behind(5.0, time_s + params.gate_s + 2 * sd_s)
    assert fit.is_behind(5.0, time_s + params.gate_s + 4 * sd_s)

"""The clock fit recovers instants from arrivals that a line delays, bunches and stalls."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tactiled.samples.clock import ClockFit, ClockParams
from tactiled.samples.envelope import line_through

LATENCY_S = 0.0145
Floats = NDArray[np.float64]


def arrivals(
    rng: np.random.Generator, ppm: float, bunch_s: float, stalls: bool, duration_s: float = 40.0
) -> tuple[Floats, Floats, Floats]:
    """True instants, board seconds, host arrivals of 100 Hz scans over a bad line."""
    number = np.arange(int(duration_s * 100))
    true_s = 500.0 + rng.uniform(0, 0.01) + number * 0.01 / (1 + ppm * 1e-6)
    board_s = number * 0.01
    arrival_s = true_s + LATENCY_S + rng.exponential(1e-4, len(number))
    if bunch_s:
        phase = rng.uniform(0, bunch_s)
        arrival_s = np.ceil((arrival_s - phase) / bunch_s) * bunch_s + phase
    if stalls:
        for start in np.arange(503.0, 500 + duration_s, 7.3):
            arrival_s[(arrival_s > start) & (arrival_s < start + 0.5)] = start + 0.5
    handed_s: Floats = np.maximum.accumulate(arrival_s)
    return np.asarray(true_s, dtype=np.float64), np.asarray(board_s, dtype=np.float64), handed_s


def estimate(fit: ClockFit, board_s: Floats, arrival_s: Floats) -> tuple[Floats, Floats]:
    out = []
    for board, arrival in zip(board_s.tolist(), arrival_s.tolist(), strict=True):
        fit.add(board, arrival)
        out.append(fit.time_of(board))
    table = np.array(out)
    return table[:, 0], table[:, 1]


@pytest.mark.parametrize(("ppm", "bunch_s"), [(100.0, 0.016), (-100.0, 0.016), (100.0, 0.0), (0.0, 0.0)])
def test_instants_within_half_a_millisecond_after_ten_seconds(ppm: float, bunch_s: float) -> None:
    errors, sigmas = [], []
    for seed in range(5):
        true_s, board_s, arrival_s = arrivals(np.random.default_rng(seed), ppm, bunch_s, stalls=True)
        time_s, sd_s = estimate(ClockFit(ClockParams(), LATENCY_S), board_s, arrival_s)
        errors.append((time_s - true_s)[1000:])
        sigmas.append(sd_s[1000:])
    rms_s = np.sqrt(np.mean(np.square(errors)))
    stated_s = np.sqrt(np.mean(np.square(sigmas)))
    assert rms_s < 0.5e-3
    assert rms_s < 1.5 * stated_s  # the stated sigma is no boast
    assert stated_s < 1e-3  # and not useless


def test_sixteen_millisecond_steps_without_relative_drift_stay_inside_the_stated_sigma() -> None:
    """Nothing moves, so nothing narrows the step of 2 ms: the fit must know that it does not know."""
    worst = 0.0
    for seed in range(8):
        true_s, board_s, arrival_s = arrivals(np.random.default_rng(seed), 0.0, 0.016, stalls=False)
        time_s, sd_s = estimate(ClockFit(ClockParams(), LATENCY_S), board_s, arrival_s)
        worst = max(worst, float(np.max(np.abs(time_s - true_s)[1000:] / sd_s[1000:])))
    assert worst < 2.5  # uniform errors end at 1.7 sigma


def test_a_stepped_board_clock_is_believed_after_a_few_scans() -> None:
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
    assert len(fit._bands) <= ClockParams().window_buckets


@given(
    slope=st.floats(-2e-4, 2e-4),
    offset=st.floats(-5, 5),
    widths=st.lists(st.floats(1e-5, 1e-2), min_size=2, max_size=30),
)
def test_the_mean_line_passes_through_every_band(slope: float, offset: float, widths: list[float]) -> None:
    bands = [(float(x), offset + slope * x - w, offset + slope * x + w / 3) for x, w in enumerate(widths)]
    line = line_through(bands, 3e-4)
    for x, low, high in bands:
        assert low - 1e-9 <= line.at(x) <= high + 1e-9
        assert line.variance_at(x) >= 0


def test_moments_agree_with_sampling() -> None:
    """Centroid and covariance of the feasible lines against brute force."""
    bands = [(0.0, -1.0, 1.0), (1.0, -0.4, 0.7), (2.0, -1.0, 0.5)]
    line = line_through(bands, 10.0)
    rng = np.random.default_rng(0)
    y0, y1 = rng.uniform(-3, 3, (2, 400_000))
    middle = (y0 + y1) / 2
    inside = (abs(y0) <= 1) & (y1 >= -1) & (y1 <= 0.5) & (middle >= -0.4) & (middle <= 0.7)
    assert line.y0 == pytest.approx(y0[inside].mean(), abs=0.01)
    assert line.y1 == pytest.approx(y1[inside].mean(), abs=0.01)
    assert line.var00 == pytest.approx(y0[inside].var(), abs=0.01)
    assert line.var01 == pytest.approx(np.cov(y0[inside], y1[inside])[0, 1], abs=0.01)


def test_a_low_that_contradicts_the_highs_is_passed_over() -> None:
    line = line_through([(0.0, -1.0, 0.0), (1.0, 5.0, 6.0), (2.0, -1.0, 0.0)], 1e-3)
    assert -1.1 <= line.at(1.0) <= 0.1

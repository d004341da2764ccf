"""Bounds of the delay of an ideal arrival, from the arrivals of one bucket, by hand-made arrivals."""

import math

import pytest

from tactiled.samples.bucket import Bucket

JITTER_S, SLACK_S = 1e-4, 1e-6


def bucket(*delays_s: float, waited_s: float = 0.01, is_whole: bool = True) -> Bucket:
    """Bucket with one arrival every 10 ms of board time."""
    made = Bucket(1.0)
    for number, delay_s in enumerate(delays_s):
        made.add(0.01 * number, delay_s, waited_s, is_whole, delay_s)
    return made


@pytest.mark.parametrize(
    ("delays_s", "handover_s", "low_s"),
    [
        ((0.005, 0.002, 0.009), None, 0.009 - 0.008),  # the largest of the lower bounds
        ((0.005, 0.002, 0.0105), None, 0.005 - 0.008),  # the last frame waited behind others: no bound
        ((0.005, 0.002, 0.006), 0.004, 0.006 - 0.004),  # a configured timer in place of the waits
    ],
)
def test_a_frame_was_not_complete_at_the_hand_over_before(
    delays_s: tuple[float, ...], handover_s: float | None, low_s: float
) -> None:
    band = bucket(*delays_s, waited_s=0.008, is_whole=False).band(handover_s, 1.0, is_pinged=False)
    assert (band.high, band.high_x) == (0.002, 0.01)  # the earliest arrival bounds the line from above
    assert band.low == pytest.approx(low_s - JITTER_S - SLACK_S)


@pytest.mark.parametrize("handover_s", [0.0, None])
def test_where_nothing_is_bunched_the_mean_delay_bounds_the_earliest(handover_s: float | None) -> None:
    delays = [0.0010, 0.0012, 0.0014, 0.0012]
    band = bucket(*delays).band(handover_s, 1.0, is_pinged=False)
    assert band.low == pytest.approx(0.0010 - 0.3 * (sum(delays) / 4 - 0.0010) - SLACK_S)
    # Reads that end within frames are bunched, and answers to pings rule the assumption out.
    bunched = bucket(*delays, is_whole=False).band(None, 1.0, is_pinged=False)
    assert bunched.low == pytest.approx(0.0014 - 0.01 - JITTER_S - SLACK_S)
    assert bucket(*delays).band(None, 1.0, is_pinged=True).low == -math.inf


def test_an_answer_tightens_both_bounds_and_a_looser_one_changes_nothing() -> None:
    made = bucket(0.005, 0.004, waited_s=0.008, is_whole=False)
    for board_s, low_s, high_s in [(0.3, 0.0011, 0.0020), (0.4, 0.0009, 0.0030)]:
        made.answer(board_s, low_s, high_s)
        band = made.band(None, 1.0, is_pinged=True)
        assert band.low == pytest.approx(0.0011 - SLACK_S)
        assert band.low_x == 0.3
        assert (band.high, band.high_x) == (0.0020, 0.3)


@pytest.mark.parametrize(("low_s", "counts"), [(0.0021, True), (0.0019, False)])
def test_an_answer_counts_where_it_is_no_looser_than_a_read(low_s: float, *, counts: bool) -> None:
    made = bucket(0.005, 0.004, waited_s=0.002)
    assert not made.is_answered(1.0)
    made.answer(0.3, low_s, 0.02)
    assert made.is_answered(1.0) is counts


def test_nothing_is_known_below_where_no_wait_is_known() -> None:
    assert bucket(0.005, 0.004, waited_s=math.inf).band(None, math.inf, is_pinged=True).low == -math.inf


@pytest.mark.parametrize(("wait_s", "counts"), [(0.0119, True), (0.0121, False)])
def test_a_wait_of_three_usual_ones_is_a_stall_and_no_bound(wait_s: float, *, counts: bool) -> None:
    made = bucket(*[0.001] * 8, waited_s=0.004, is_whole=False)
    made.add(0.5, 0.0125, wait_s, False, 0.0125)
    tightest = 0.0125 - wait_s if counts else 0.001 - 0.004
    assert made.band(None, 1.0, is_pinged=False).low == pytest.approx(tightest - JITTER_S - SLACK_S)


@pytest.mark.parametrize("delays_ms", [(1, 4), (4, 1)])
def test_a_trend_is_doubt(delays_ms: tuple[int, int]) -> None:
    made = bucket(*[1e-3 * delays_ms[0]] * 32, *[1e-3 * delays_ms[1]] * 32)
    made.running_band(0.004, 1.0, is_pinged=False)
    assert made.doubt_s == pytest.approx(0.003 / 0.75)


def test_an_earlier_arrival_shows_in_the_running_band_at_once() -> None:
    made = bucket(*[0.005] * 100)
    before = made.running_band(None, 1.0, is_pinged=False)
    made.add(1.5, 0.004, 0.01, True, 0.004)
    band = made.running_band(None, 1.0, is_pinged=False)
    assert (before.high, band.high, band.high_x) == (0.005, 0.004, 1.5)

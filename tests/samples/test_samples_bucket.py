"""Bounds of the delay of an ideal arrival, from the arrivals of one bucket, by hand-made arrivals."""

import math

import pytest

from tactiled.samples.bucket import SLOTS, Bucket, FrameArrival

JITTER_S, SLACK_S = 1e-4, 1e-6


def bucket(*delays_s: float, waited_s: float = 0.01, is_whole: bool = True, width_s: float = 1.0) -> Bucket:
    """Bucket with one arrival every 10 ms of board time."""
    made = Bucket(width_s)
    for number, delay_s in enumerate(delays_s):
        made.add(FrameArrival(0.01 * number, delay_s, waited_s, is_whole), delay_s)
    return made


def test_the_earliest_arrival_bounds_the_line_from_above() -> None:
    band = bucket(0.005, 0.002, 0.009).band(None, 1.0, is_pinged=False)
    assert (band.high, band.high_x) == (0.002, 0.01)


def test_a_frame_was_not_complete_at_the_hand_over_before() -> None:
    band = bucket(0.005, 0.002, 0.009, waited_s=0.008, is_whole=False).band(None, 1.0, is_pinged=False)
    # 0.009 - 0.008 is the largest of the lower bounds.
    assert band.low == pytest.approx(0.009 - 0.008 - JITTER_S - SLACK_S)
    assert band.low_x == 0.02
    assert not band.is_assumed


def test_a_frame_that_waited_behind_others_is_no_bound() -> None:
    band = bucket(0.005, 0.002, 0.0105, waited_s=0.008, is_whole=False).band(None, 1.0, is_pinged=False)
    assert band.low == pytest.approx(0.005 - 0.008 - JITTER_S - SLACK_S)


def test_a_configured_timer_takes_the_place_of_the_waits() -> None:
    band = bucket(0.005, 0.002, 0.006, waited_s=0.008).band(0.004, 1.0, is_pinged=False)
    assert band.low == pytest.approx(0.006 - 0.004 - JITTER_S - SLACK_S)


@pytest.mark.parametrize("handover_s", [0.0, None])
def test_where_nothing_is_bunched_the_mean_delay_bounds_the_earliest(handover_s: float | None) -> None:
    delays = [0.0010, 0.0012, 0.0014, 0.0012]
    band = bucket(*delays, waited_s=0.01).band(handover_s, 1.0, is_pinged=False)
    mean_late_s = sum(delays) / 4 - 0.0010
    assert band.low == pytest.approx(0.0010 - 0.3 * mean_late_s - SLACK_S)
    assert band.low_x == band.high_x == 0.0
    assert band.is_assumed is (handover_s is None)


def test_reads_that_end_within_frames_are_bunched() -> None:
    made = bucket(0.0010, 0.0012, 0.0014, 0.0012, is_whole=False)
    assert not made.band(None, 1.0, is_pinged=False).is_assumed


def test_answers_to_pings_rule_the_assumption_out() -> None:
    made = bucket(0.0010, 0.0012, 0.0014, 0.0012)
    assert made.band(None, 1.0, is_pinged=False).is_assumed
    assert not made.band(None, 1.0, is_pinged=True).is_assumed


def test_an_answer_tightens_both_bounds_and_a_looser_one_changes_nothing() -> None:
    made = bucket(0.005, 0.004, waited_s=0.008, is_whole=False)
    for board_s, low_s, high_s in [(0.3, 0.0011, 0.0020), (0.4, 0.0009, 0.0030)]:
        made.answer(board_s, low_s, high_s)
        band = made.band(None, 1.0, is_pinged=True)
        assert band.low == pytest.approx(0.0011 - SLACK_S)
        assert band.low_x == 0.3
        assert (band.high, band.high_x) == (0.0020, 0.3)
        assert made.is_answered(1.0)


def test_an_answer_counts_where_it_is_no_looser_than_a_read() -> None:
    for low_s, counts in [(0.0021, True), (0.0019, False)]:
        made = bucket(0.005, 0.004, waited_s=0.002)
        assert not made.is_answered(1.0)
        made.answer(0.3, low_s, 0.02)
        assert made.is_answered(1.0) is counts
        assert made.band(None, 1.0, is_pinged=True).high == 0.004


def test_nothing_is_known_below_where_no_wait_is_known() -> None:
    made = bucket(0.005, 0.004, waited_s=math.inf)
    assert made.band(None, math.inf, is_pinged=True).low == -math.inf
    assert not made.is_answered(math.inf)


def test_the_usual_wait_is_a_quartile_and_at_most_twice_the_one_before() -> None:
    made = Bucket(1.0)
    for number, waited_s in enumerate([0.5, 0.004, 0.5, 0.5, 0.004, 0.5, 0.003, 0.5]):
        made.add(FrameArrival(0.01 * number, 0.0, waited_s, True), 0.0)
    assert made.usual_wait_s(1.0) == sorted([0.5, 0.004, 0.5, 0.5, 0.004, 0.5, 0.003, 0.5])[2]
    assert made.usual_wait_s(0.001) == 0.002


def test_a_wait_of_three_usual_ones_is_a_stall_and_no_bound() -> None:
    for wait_s, counts in [(0.0119, True), (0.0121, False)]:
        made = bucket(*[0.001] * 8, waited_s=0.004, is_whole=False)
        made.add(FrameArrival(0.5, 0.0125, wait_s, False), 0.0125)
        tightest = 0.0125 - wait_s - JITTER_S if counts else 0.001 - 0.004 - JITTER_S
        assert made.band(None, 1.0, is_pinged=False).low == pytest.approx(tightest - SLACK_S)


def test_one_arrival_in_each_slot_is_kept() -> None:
    made = Bucket(1.0)
    made.begin(3)
    for number in range(10_000):
        made.add(FrameArrival(3.0 + number / 10_000, 0.001, 0.01, True), 0.001)
    assert len(made) == 10_000
    assert made.n_kept == SLOTS
    assert made.newest_s == pytest.approx(3.9999 + 0.001)
    slow = Bucket(1.0)
    for number in range(200):
        slow.add(FrameArrival(number / 200, 0.001, 0.01, True), 0.001)
    assert slow.n_kept == 200
    turning = Bucket(1.0)
    for number in range(10_000):  # board time goes back and forth
        turning.add(FrameArrival((number % 2) * 0.5, 0.001, 0.01, True), 0.001)
    assert turning.n_kept == SLOTS


def test_a_new_bucket_knows_nothing_of_the_one_before() -> None:
    made, new = bucket(0.001, 0.002), Bucket(1.0)
    made.answer(0.1, 0.0005, 0.0008)
    made.running_band(None, 1.0, is_pinged=True)
    made.begin(4)
    new.begin(4)
    for one in (made, new):
        one.add(FrameArrival(4.0, 0.005, 0.01, True), 0.005)
    assert (made.number, len(made), made.n_kept, made.newest_s) == (4, 1, 1, new.newest_s)
    assert made.running_band(None, 1.0, is_pinged=False) == new.running_band(None, 1.0, is_pinged=False)
    assert made.doubt_s == new.doubt_s
    assert not made.is_answered(0.001)


def test_a_trend_and_an_unknown_timer_are_doubt() -> None:
    made = bucket(*[0.001] * 32, *[0.004] * 32)
    made.running_band(0.004, 1.0, is_pinged=False)
    assert made.doubt_s == pytest.approx(0.003 / 0.75)
    falling = bucket(*[0.004] * 32, *[0.001] * 32)
    falling.running_band(0.004, 1.0, is_pinged=False)
    assert falling.doubt_s == pytest.approx(0.003 / 0.75)
    for waited_s, doubt_s in [(0.01, 0.01), (0.05, 0.016)]:  # the timer of FTDI at most
        young = bucket(*[0.001] * 15, waited_s=waited_s)
        young.running_band(None, 1.0, is_pinged=False)
        assert young.doubt_s == pytest.approx(doubt_s)
        old = bucket(*[0.001] * 16, waited_s=waited_s)
        old.running_band(None, 1.0, is_pinged=False)
        assert old.doubt_s == 0.0


def test_an_earlier_arrival_shows_in_the_running_band_at_once() -> None:
    made = bucket(*[0.005] * 100)
    before = made.running_band(None, 1.0, is_pinged=False)
    assert before.high == 0.005
    made.add(FrameArrival(1.5, 0.004, 0.01, True), 0.004)
    band = made.running_band(None, 1.0, is_pinged=False)
    assert (band.high, band.high_x) == (0.004, 1.5)
    assert band.low == min(before.low, 0.004)
    for number in range(5):  # nothing earlier, and fewer than an eighth more
        made.add(FrameArrival(1.6 + 0.01 * number, 0.009, 0.01, True), 0.009)
        assert made.running_band(None, 1.0, is_pinged=False) is band
    for number in range(8):
        made.add(FrameArrival(1.7 + 0.01 * number, 0.009, 0.01, True), 0.009)
    assert made.running_band(None, 1.0, is_pinged=False) is not band

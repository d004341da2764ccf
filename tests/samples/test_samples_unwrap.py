"""Counters of a board: wraps, losses, duplicates and restarts, against the counts that were made."""

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.samples.unwrap import CounterStep, ScanCounter

RATE_HZ, TICK_S = 100.0, 1e-6


@dataclass
class Board:
    """A board of which scan 0 has given counters; a crystal may be off by some parts per million."""

    sequence0: int = 0
    tick0: int = 0
    drift_ppm: float = 0.0
    sequence_bits: int = 16
    tick_bits: int = 32

    def scan(self, number: int) -> tuple[int, int]:
        """Sequence number and ticks of a scan."""
        ticks = self.tick0 + round(number / RATE_HZ / TICK_S * (1 + 1e-6 * self.drift_ppm))
        return (self.sequence0 + number) % 2**self.sequence_bits, ticks % 2**self.tick_bits


def counter(board: Board, *, ticks: bool = True) -> ScanCounter:
    return ScanCounter(board.sequence_bits, board.tick_bits if ticks else None, TICK_S if ticks else None)


@given(
    st.integers(0, 2**16 - 1),
    st.integers(0, 2**32 - 1),
    st.floats(-200, 200),
    st.lists(st.one_of(st.just(1), st.integers(1, 40), st.integers(1, 200_000)), min_size=1, max_size=30),
    st.booleans(),
)
def test_each_scan_counts_the_scans_since_the_one_before(
    sequence0: int, tick0: int, drift_ppm: float, jumps: list[int], ticks: bool
) -> None:
    """Losses of up to 2,000 s: the sequence number wraps three times, the ticks less than once."""
    board, number = Board(sequence0, tick0, drift_ppm), 0
    target = counter(board, ticks=ticks)
    sequence, tick = board.scan(0)
    assert target.step(sequence, tick if ticks else None, 5.0, RATE_HZ) == CounterStep("next", 1)
    for jump in jumps:
        number += jump
        sequence, tick = board.scan(number)
        step = target.step(sequence, tick if ticks else None, 5.0 + number / RATE_HZ, RATE_HZ)
        assert step == CounterStep("next", jump)
    by_crystal = 1 + 1e-6 * drift_ppm if ticks else 1.0
    assert target.board_s == pytest.approx(number / RATE_HZ * by_crystal, rel=1e-9, abs=TICK_S)


@given(st.integers(0, 2**16 - 1), st.integers(0, 15))
def test_a_repeated_or_late_scan_is_a_duplicate_and_changes_nothing(sequence0: int, back: int) -> None:
    board = Board(sequence0, 2**32 - 50)
    target = counter(board)
    for number in (0, 20):
        target.step(*board.scan(number), number / RATE_HZ, RATE_HZ)
    before = target.board_s
    assert target.step(*board.scan(20 - back), 0.2, RATE_HZ) == CounterStep("duplicate", 0)
    assert target.board_s == before
    assert target.step(*board.scan(21), 0.21, RATE_HZ) == CounterStep("next", 1)


@pytest.mark.parametrize("away_s", [0.0, 3.0, 3600.0])
def test_counters_that_begin_again_are_a_restart(away_s: float) -> None:
    board, again = Board(40_000, 3_000_000_000), Board()
    target = counter(board)
    target.step(*board.scan(0), 0.0, RATE_HZ)
    target.step(*board.scan(1), 0.01, RATE_HZ)
    assert target.step(*again.scan(0), 0.02 + away_s, RATE_HZ).kind == "restart"


def test_ticks_read_between_scans_are_placed_on_the_boards_time() -> None:
    board = Board(0, 2**32 - 5)
    target = counter(board)
    assert target.board_s_at(0, 0.0) is None
    target.step(*board.scan(0), 0.0, RATE_HZ)
    assert target.board_s_at((2**32 - 5 + 2_500) % 2**32, 0.003) == pytest.approx(0.0025)
    assert target.board_s_at(2**31, 0.003) is None  # 36 minutes away: of another run


def after(away_s: float, sequence: int, board_s: float, *, ticks: bool = True) -> CounterStep:
    """Step to a scan that came `away_s` later, with this sequence number and board time since the last."""
    target = counter(Board(), ticks=ticks)
    target.step(0, 0 if ticks else None, 5.0, RATE_HZ)
    return target.step(sequence % 2**16, round(board_s / TICK_S) if ticks else None, 5.0 + away_s, RATE_HZ)


@pytest.mark.parametrize(
    ("n_scans", "kind"), [(105, "next"), (107, "restart"), (95, "next"), (93, "restart")]
)
def test_numbers_and_ticks_differ_by_five_scans_and_a_percent(n_scans: int, kind: str) -> None:
    assert after(1.0, n_scans, 1.0).kind == kind


@pytest.mark.parametrize(("n_scans", "kind"), [(155, "next"), (157, "restart"), (45, "next")])
def test_without_ticks_the_host_may_be_half_a_second_off_as_well(n_scans: int, kind: str) -> None:
    assert after(1.0, n_scans, 0.0, ticks=False).kind == kind


@given(stall_s=st.floats(0.1, 10.0), n_scans=st.integers(1, 1000))
def test_without_ticks_a_scan_that_waited_in_the_host_is_no_restart(stall_s: float, n_scans: int) -> None:
    n_scans = min(n_scans, max(round(stall_s * RATE_HZ), 1))
    assert after(stall_s, n_scans, 0.0, ticks=False) == CounterStep("next", n_scans)


def test_no_scan_waits_for_longer_than_ten_seconds() -> None:
    assert after(10.1, 1, 0.0, ticks=False).kind == "restart"


@pytest.mark.parametrize(("back", "kind"), [(0, "duplicate"), (15, "duplicate"), (16, "restart")])
def test_an_older_scan_than_the_line_repeats_is_of_another_run(back: int, kind: str) -> None:
    target = counter(Board())
    target.step(100, 1_000_000, 5.0, RATE_HZ)
    assert target.step(100 - back, 1_000_000 - 10_000 * back, 5.0, RATE_HZ) == CounterStep(kind, 0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("n_scans", "away_s", "kind"),
    [(100, 11.0, "next"), (100, 11.2, "restart"), (17, 10.4, "restart"), (16, 10.4, "next")],
)
def test_a_silence_ten_seconds_longer_than_the_ticks_say_is_a_power_cycle(
    n_scans: int, away_s: float, kind: str
) -> None:
    assert after(away_s, n_scans, n_scans / RATE_HZ).kind == kind


@pytest.mark.parametrize(("ahead_s", "fits"), [(10.0, True), (10.3, False), (-10.0, True), (-10.3, False)])
def test_ticks_between_scans_belong_to_the_run_within_ten_seconds(ahead_s: float, *, fits: bool) -> None:
    target = counter(Board())
    target.step(0, 0, 5.0, RATE_HZ)
    ticks = round((20.0 + ahead_s) / TICK_S)
    assert target.runs_on(ticks, 25.0) is fits
    assert target.board_s_at(ticks, 25.0) == (pytest.approx(20.0 + ahead_s) if fits else None)
    assert target.board_s == 0.0


def test_scans_without_numbers_follow_each_other_at_the_rate() -> None:
    target = counter(Board(), ticks=False)
    for number in range(5):
        assert target.follow(5.0 + number, RATE_HZ) == CounterStep("next", 1)
        assert target.board_s == pytest.approx(number / RATE_HZ)
    target.reset()
    target.follow(50.0, RATE_HZ)
    assert target.board_s == 0.0


def test_after_a_stop_the_next_scan_counts_one_and_board_time_runs_on() -> None:
    target = counter(Board())
    target.step(500, 0, 5.0, RATE_HZ)
    target.forget_sequence()
    assert target.step(3, round(2.0 / TICK_S), 7.0, RATE_HZ) == CounterStep("next", 1)
    assert target.board_s == pytest.approx(2.0)
    target.forget_sequence()
    assert target.step(0, round(40.0 / TICK_S), 9.0, RATE_HZ) == CounterStep("restart", 0)
    assert target.board_s == pytest.approx(2.0)
    assert target.step(1, round(3.0 / TICK_S), 8.0, RATE_HZ).kind == "next"  # any number follows a stop

"""Load of the host: the longest turn is said once, and a warning stays for ten seconds."""

from hypothesis import given
from hypothesis import strategies as st

from tactiled.daemon.board.host_load import HostLoad, LoopTurns


def test_a_long_turn_is_a_warning_that_ends() -> None:
    turns = LoopTurns()
    load = HostLoad(turns)
    turns.add(4.95, 0.21)
    load.note_status(5.0, 0)
    assert "could not react for up to 210 ms" in load.warning()
    load.note_status(14.0, 0)
    assert load.warning()
    load.note_status(15.1, 0)
    assert load.warning() == ""


def test_late_fits_are_a_warning_that_counts_the_last_ten_seconds() -> None:
    load = HostLoad(LoopTurns())
    for tenth in range(100):
        load.note_status(tenth / 10, tenth // 20)
    assert load.warning().startswith("4 groove fits were not ready in time")
    for tenth in range(100, 150):
        load.note_status(tenth / 10, 4)
    assert load.warning().startswith("2 groove fits were not ready")
    load.note_status(60.0, 4)
    assert load.warning() == ""


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 5)), max_size=60), st.integers(0, 100))
def test_the_longest_turn_is_that_of_all_since_an_instant(steps: list[tuple[int, int]], back: int) -> None:
    turns, known, now_s = LoopTurns(), list[tuple[float, float]](), 0.0
    for step, duration in steps:
        now_s += step / 100
        turns.add(now_s, float(duration))
        known.append((now_s, float(duration)))
    since_s = now_s - back / 100
    assert turns.longest_since(since_s) == max((d for end, d in known if end > since_s), default=0.0)


def test_every_board_of_a_process_sees_the_turns_of_the_one_loop() -> None:
    turns = LoopTurns()
    first, second = HostLoad(turns), HostLoad(turns)
    turns.add(0.02, 0.01)
    assert first.note_status(0.05, 0) == 0.01
    turns.add(0.08, 0.004)
    assert second.note_status(0.1, 0) == 0.01
    assert first.note_status(0.15, 0) == 0.004

"""Offset to epoch seconds: constant under jitter, corrected when the wall clock is stepped."""

from hypothesis import given
from hypothesis import strategies as st

from tactiled.daemon.clock import EpochClock


class Clocks:
    """Two clocks of a machine, each reading of which takes time."""

    def __init__(self, reading_s: float = 1e-7) -> None:
        self.time_s, self.offset_s, self.reading_s = 5000.0, 1.7e9, reading_s

    def monotonic(self) -> float:
        self.time_s += self.reading_s
        return self.time_s

    def wall(self) -> float:
        self.time_s += self.reading_s
        return self.time_s + self.offset_s


@given(readings_s=st.lists(st.floats(1e-8, 2e-3), max_size=20))
def test_jitter_of_the_readings_never_moves_the_offset(readings_s: list[float]) -> None:
    clocks = Clocks()
    clock = EpochClock(clocks.monotonic, clocks.wall)
    before = clock.offset_s
    for clocks.reading_s in readings_s:
        assert clock.follow() == 0.0
    assert clock.offset_s == before


def test_a_first_measurement_that_is_preempted_is_repeated() -> None:
    clocks = Clocks()
    readings = iter(range(12))

    def wall() -> float:
        unix_s = clocks.wall()
        clocks.time_s += 0.02 * (next(readings, 12) < 12)  # so many brackets are 20 ms wide
        return unix_s

    clock = EpochClock(clocks.monotonic, wall)
    assert abs(clock.offset_s - clocks.offset_s) < 1e-6
    assert clock.follow() == 0.0


@given(step_s=st.floats(-1e5, 1e5).filter(lambda s: abs(s) > 2e-3))
def test_a_step_is_followed_once_and_reported(step_s: float) -> None:
    clocks = Clocks()
    clock = EpochClock(clocks.monotonic, clocks.wall)
    clocks.offset_s += step_s
    assert abs(clock.follow() - step_s) < 1e-5
    assert abs(clock.offset_s - clocks.offset_s) < 1e-5
    assert clock.follow() == 0.0


def test_small_steps_add_up_and_are_followed_in_the_end() -> None:
    clocks = Clocks()
    clock = EpochClock(clocks.monotonic, clocks.wall)
    for _ in range(100):
        clocks.offset_s += 1e-4
        clock.follow()
    assert abs(clock.offset_s - clocks.offset_s) < 1.1e-3

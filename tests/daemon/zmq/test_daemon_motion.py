"""Announced motion of a controller with a clock of its own: when its values hold by the daemon's clock."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.daemon.zmq.commands import DRIFT, EVENT_PERIOD_S, WINDOW_S, Commands, MotionSenders, SenderClock
from tactiled.daemon.zmq.requests import Motion, Requester

ROUNDING_S = 1e-6  # of clocks that count from 1970
ME = ("", "1", "me")
commands = st.lists(  # time since the one before, and delay
    st.tuples(st.floats(0.001, 3.0), st.floats(0.0, 0.05)), min_size=1, max_size=60
)


@given(offset_s=st.floats(-1e9, 1e9), drift=st.floats(-DRIFT, DRIFT), sent=commands)
def test_instants_are_never_too_early_and_late_by_the_least_delay_at_most(
    offset_s: float, drift: float, sent: list[tuple[float, float]]
) -> None:
    """Instants of sending, 1e9 s after the zero of the sender's clock, in the daemon's clock."""
    clock, left_s = SenderClock(), 0.0
    arrivals: list[tuple[float, float]] = []  # instant and delay
    for since_s, delay_s in sent:
        left_s += max(since_s, delay_s)  # commands of a client arrive in order
        sent_s = 1e9 + offset_s + left_s * (1 + drift)
        now_s = 5000.0 + left_s + delay_s
        arrivals.append((now_s, delay_s))
        late_s = sent_s + clock.offset_s(sent_s, now_s) - (5000.0 + left_s)
        assert late_s >= -ROUNDING_S
        window = [(now_s - at_s, delay) for at_s, delay in arrivals if now_s - at_s <= WINDOW_S]
        assert late_s <= min(delay + 2 * DRIFT * age_s for age_s, delay in window) + ROUNDING_S
        assert late_s <= delay_s + ROUNDING_S


@pytest.mark.parametrize("jump_s", [-1000.0, 1000.0])
def test_a_clock_that_was_set_is_followed_after_two_windows(jump_s: float) -> None:
    clock, late_s = SenderClock(), math.inf
    for k in range(100):
        clock.offset_s(100.0 + 0.1 * k, 500.0 + 0.1 * k)
    for k in range(round(2 * WINDOW_S / 0.1) + 1):
        now_s = 510.0 + 0.1 * k
        sent_s = now_s - 400.0 + jump_s
        late_s = sent_s + clock.offset_s(sent_s, now_s) - now_s
    assert late_s == pytest.approx(0.0, abs=2 * DRIFT * WINDOW_S)


@pytest.mark.parametrize("jump_s", [-1000.0, 1000.0])
def test_a_clock_that_was_set_in_a_long_pause_is_followed_at_once(jump_s: float) -> None:
    clock = SenderClock()
    for k in range(100):
        clock.offset_s(100.0 + 0.1 * k, 500.0 + 0.1 * k)
    sent_s, now_s = 210.0 + 3 * WINDOW_S + jump_s, 610.0 + 3 * WINDOW_S
    assert sent_s + clock.offset_s(sent_s, now_s) == pytest.approx(now_s)


def motion(**fields: Any) -> Motion:
    return Motion(v=1, id="1", do="motion", **fields)


def test_a_batch_keeps_its_steps_and_a_value_without_instant_counts_from_its_arrival() -> None:
    senders = MotionSenders()
    batch = motion(acceleration_m_s2=[9.81, 12.0], time_s=[50.0, 50.5], sent_s=50.75)
    assert senders.course(batch, ME, 200.0) == (
        "", {"time_s": [199.25, 199.75], "acceleration_m_s2": [9.81, 12.0]}
    )  # fmt: skip
    reason, course = senders.course(motion(acceleration_m_s2=11.0), ME, 200.5)
    assert (reason, course) == ("", {"time_s": [200.5], "acceleration_m_s2": [11.0]})


def test_each_sender_has_a_clock_of_its_own_and_few_are_kept() -> None:
    senders = MotionSenders()
    for k in range(100):
        command = motion(acceleration_m_s2=9.81, time_s=float(k), sent_s=float(k))
        _, course = senders.course(command, ("", "1", str(k)), 200.0)
        assert course["time_s"] == [200.0]
    assert len(senders._senders) <= 8  # noqa: SLF001  the bound on memory


class CourseKeeper:
    """Pipeline that keeps the instants of announced motion."""

    def __init__(self) -> None:
        self.times_s: list[list[float]] = []

    def command(self, _name: str, arguments: dict[str, Any], _now_s: float) -> tuple[str, list[Any]]:
        self.times_s.append(arguments["time_s"])
        return "", []


def test_programs_of_one_name_on_two_connections_have_two_clocks() -> None:
    pipeline: Any = CourseKeeper()
    commands = Commands(pipeline, lambda *_: None, lambda _: "")
    for k in range(3):
        for connection, zero_s in (("1", 5000.0), ("2", 4000.0)):
            sent_s, now_s = zero_s + 0.1 * k, 200.0 + 0.1 * k
            command = motion(acceleration_m_s2=9.81, time_s=sent_s, sent_s=sent_s)
            assert commands.do(command, Requester(connection, may_command=True), now_s) == ""
            assert pipeline.times_s[-1] == pytest.approx([now_s])


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"acceleration_m_s2": [9.81, 9.81]}, "time_s: missing: 2 values of acceleration_m_s2"),
        ({"acceleration_m_s2": 9.81, "time_s": 5.0}, "sent_s: missing"),
        ({"acceleration_m_s2": 9.81, "sent_s": 5.0}, "time_s: missing"),
        (
            {"acceleration_m_s2": [9.81, 9.81], "time_s": [5.0], "sent_s": 5.0},
            "time_s: 1 instants for 2 values",
        ),
        (
            {"acceleration_m_s2": [9.81, 9.81], "time_s": [5.0, 4.5], "sent_s": 5.0},
            "time_s: an instant is before",
        ),
        ({"acceleration_m_s2": 9.81, "time_s": 3.5, "sent_s": 5.0}, "time_s: an instant is more than 1 s"),
        ({"acceleration_m_s2": 9.81, "time_s": 6.5, "sent_s": 5.0}, "time_s: an instant is more than 1 s"),
    ],
)
def test_what_is_no_course_is_refused_with_its_field(fields: dict[str, Any], says: str) -> None:
    senders = MotionSenders()
    reason, _ = senders.course(motion(**fields), ME, 200.0)
    assert reason.startswith(says)
    good = motion(acceleration_m_s2=9.81, time_s=5.0, sent_s=5.0)
    assert senders.course(good, ME, 200.0)[0] == ""


def test_a_command_that_comes_far_too_late_is_refused() -> None:
    senders = MotionSenders()
    for sent_s, now_s, says in ((5.0, 200.0, ""), (5.5, 201.0, ""), (6.0, 202.5, "sent_s: ")):
        command = motion(acceleration_m_s2=9.81, time_s=sent_s, sent_s=sent_s)
        reason, _ = senders.course(command, ME, now_s)
        assert reason.startswith(says)
        assert bool(reason) == bool(says)


def test_of_a_stream_one_command_in_ten_seconds_is_an_event() -> None:
    senders = MotionSenders()
    told = [senders.is_event(ME, ok=True, now_s=0.01 * k) for k in range(2001)]
    assert [k for k, is_told in enumerate(told) if is_told] == [0, 1000, 2000]
    assert EVENT_PERIOD_S == 0.01 * 1000
    assert senders.is_event(ME, ok=False, now_s=20.5)
    assert not senders.is_event(ME, ok=False, now_s=20.6)
    assert senders.is_event(("", "1", "other"), ok=True, now_s=20.6)

"""A log that cannot be flooded, and in which no condition hides another."""

import logging
import re

import pytest

from tactiled.limited_log import PERIOD_S, RateLimitedLog, limit_rate_of


def test_a_condition_is_logged_once_then_counted(caplog: pytest.LogCaptureFixture) -> None:
    log = RateLimitedLog(logging.getLogger("t"), "denied")
    log.add("a", 100.0)
    for k in range(500):
        log.add("a", 100.0 + k / 100)
    assert caplog.messages == ["denied: a"]
    log.add("b", 105.0)  # another condition does not wait
    log.write_counts(100.0 + PERIOD_S - 0.01)
    assert caplog.messages == ["denied: a", "denied: b"]
    log.write_counts(100.0 + PERIOD_S)
    assert caplog.messages[2:] == ["denied: a (500 times)"]
    log.write_counts(1000.0)
    assert len(caplog.messages) == 3
    assert log.count == 502
    log.add("a", 1001.0)  # it had stopped: new again
    assert caplog.messages[3:] == ["denied: a"]


def test_many_conditions_give_a_bounded_number_of_lines(caplog: pytest.LogCaptureFixture) -> None:
    log = RateLimitedLog(logging.getLogger("t"), "denied")
    for k in range(1000):
        log.add(str(k), 100.0)
    log.write_counts(100.0 + PERIOD_S)
    assert len(caplog.messages) == 9
    assert caplog.messages[-1] == "denied: and 992 more, for other reasons"


def test_the_last_line_is_the_last_condition(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        log = RateLimitedLog(logging.getLogger("t"))
        for k in range(100):
            log.add("stalled", k / 10)
            log.add("running", k / 10 + 0.05, logging.INFO)
        log.add("stalled", 9.99)
        log.write_counts(PERIOD_S)
    assert caplog.messages == ["stalled", "running", "running (99 times)", "stalled (100 times)"]
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO", "INFO", "WARNING"]


def test_measured_values_do_not_distinguish_conditions(caplog: pytest.LogCaptureFixture) -> None:
    log = RateLimitedLog(logging.getLogger("t"))
    for k in range(20):
        log.add(f"the clock was set by {k} s", 100.0, kind="clock")
    log.write_counts(100.0 + PERIOD_S)
    assert caplog.messages == ["the clock was set by 0 s", "the clock was set by 19 s (19 times)"]


def test_lines_of_a_library_are_limited_and_have_no_traceback(caplog: pytest.LogCaptureFixture) -> None:
    library, log = logging.getLogger("some.library"), RateLimitedLog(logging.getLogger("t"))

    def accept(number: int) -> None:
        raise OSError(24, f"x\ny{number}")

    def fail(number: int) -> None:
        try:
            accept(number)
        except OSError:
            library.exception("accept of %d failed\nmore", number)

    with limit_rate_of(("some.library",), log):
        for number in range(100):
            fail(number)
        library.info("said to nobody")
    (record,) = caplog.records
    place = rf"{__file__.rpartition('/')[2]}, line \d+"
    assert re.fullmatch(rf"accept of 0 failed: OSError: '.*x\\ny0' \({place}\)", record.getMessage())
    assert record.exc_info is None
    assert log.count == 100
    library.error("afterwards as before")
    assert caplog.messages[1:] == ["afterwards as before"]

"""A log that cannot be flooded, and in which nobody hides behind another."""

import logging

import pytest

from tactiled.daemon.complaints import PERIOD_S, Complaints


def test_the_first_is_said_at_once_and_the_others_when_it_is_time(caplog: pytest.LogCaptureFixture) -> None:
    complaints = Complaints(logging.getLogger("t"), "denied")
    complaints.add("a", 100.0)
    for k in range(500):
        complaints.add("a", 100.0 + k / 100)
    complaints.add("b", 105.0)
    complaints.tell(100.0 + PERIOD_S - 0.01)
    assert caplog.messages == ["denied: a"]
    complaints.tell(100.0 + PERIOD_S)
    assert caplog.messages[1:] == ["denied: a (500 times)", "denied: b"]
    complaints.tell(1000.0)
    assert len(caplog.messages) == 3
    assert complaints.count == 502


def test_however_many_reasons_there_are_the_lines_are_few(caplog: pytest.LogCaptureFixture) -> None:
    complaints = Complaints(logging.getLogger("t"), "denied")
    for k in range(1000):
        complaints.add(str(k), 100.0)
    complaints.tell(100.0 + PERIOD_S)
    assert len(caplog.messages) == 10
    assert caplog.messages[-1] == "denied: and 991 more, for other reasons"

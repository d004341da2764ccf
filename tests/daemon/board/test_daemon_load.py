"""Load of the host: the longest turn is said once, and a warning stays for ten seconds."""

from tactiled.daemon.board.load import HostLoad


def test_a_status_has_the_longest_turn_since_the_one_before() -> None:
    load = HostLoad()
    for turn_s in (0.001, 0.004, 0.002):
        load.turn(turn_s)
    assert load.status(0.1, 0) == 0.004
    assert load.status(0.2, 0) == 0.0
    assert load.warning() == ""


def test_a_long_turn_is_a_warning_that_ends() -> None:
    load = HostLoad()
    load.turn(0.21)
    load.status(5.0, 0)
    assert "could not react for up to 210 ms" in load.warning()
    load.status(14.0, 0)
    assert load.warning()
    load.status(15.1, 0)
    assert load.warning() == ""


def test_late_fits_are_a_warning_that_counts_the_last_ten_seconds() -> None:
    load = HostLoad()
    for tenth in range(100):
        load.status(tenth / 10, tenth // 20)
    assert load.warning().startswith("4 groove fits were not ready in time")
    for tenth in range(100, 150):
        load.status(tenth / 10, 4)
    assert load.warning().startswith("2 groove fits were not ready")
    load.status(60.0, 4)
    assert load.warning() == ""

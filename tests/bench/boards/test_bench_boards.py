"""The bench of many boards: frames are matched with messages, losses counted, and aims judged by both."""

from dataclasses import replace

import numpy as np
import pytest

from bench.boards.bench import AIMS, Load, matched


def test_frames_of_the_span_are_matched_with_the_messages_of_their_board() -> None:
    board = np.tile([0, 1], 100)
    time_s = 10.0 + np.arange(200) / 100
    time_s[57] = np.nan  # the line did not take frame 28 of board 1
    late_s = np.zeros(200)
    scans = [
        (b, index, 10.0 + (2 * index + b) / 100 + 0.002 * (b + 1))
        for b in (0, 1)
        for index in range(100)
        if (b, index) not in ((0, 30), (1, 28))
    ]
    latency_s, due, late = matched(board, time_s, late_s, np.array(scans), (10.5, 11.0))
    assert (due, len(late)) == (50, 50)
    assert len(latency_s) == 48
    assert sorted({round(1e3 * value, 6) for value in latency_s}) == [2.0, 4.0]


def load(n_boards: int, cpu_part: float, n_processes: int = 1) -> Load:
    latency_s = np.full(100, 0.003)
    return Load(
        n_boards, n_processes, cpu_part, 0.0, 70.0, 60.0 * n_processes, latency_s, 100, 1.0, 0.01, 0.0
    )


def verdicts(loads: list[Load]) -> list[str]:
    return [aim.measure(loads).verdict for aim in AIMS]


def test_aims_are_met_by_live_boards_whose_cost_is_in_proportion() -> None:
    good = [load(n, 0.02 + 0.04 * n) for n in (1, 4, 16)] + [load(16, 0.9, 16)]
    assert verdicts(good) == ["met", "met", "met"]
    bent = [load(n, 0.003 * n**2) for n in (1, 4, 16)] + [load(16, 0.9, 16)]
    assert verdicts(bent)[1] == "MISSED"
    late = [replace(one, due=101) for one in good]
    assert verdicts(late)[0] == "MISSED"
    assert late[0].lost == 1
    stale = [replace(one, valid_part=0.999) for one in good]
    assert verdicts(stale)[0] == "MISSED"
    dear = [*good[:3], load(16, 0.5, 16)]
    assert verdicts(dear)[2] == "MISSED"
    assert good[0].quantile_ms(0.5) == pytest.approx(3.0)

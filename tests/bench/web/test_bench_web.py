"""The web bench: its report judges what was measured."""

from dataclasses import replace

import numpy as np

from bench.web.bench import PageCost, aims, cost_table

COST = PageCost(
    kb_s=9.0, shift=0.01, page_part=0.1, browser_part=0.2, server_part=0.02, fresh_part=1.0,
    delay_s=np.full(98, 0.04), unseen=0,
)  # fmt: skip


def verdicts(*costs: PageCost) -> list[str]:
    return [aim.verdict for aim in aims(*costs)]


def test_every_aim_is_met_or_missed_by_its_own_number() -> None:
    assert verdicts(COST, COST, COST) == ["met"] * 6
    late = replace(COST, delay_s=np.full(4, 0.2))  # of 102 in all: more than one in a hundred
    bad = replace(COST, kb_s=26.0, shift=0.06, page_part=0.16, server_part=0.04)
    assert verdicts(bad, late, COST) == ["MISSED"] * 5 + ["met"]
    assert verdicts(COST, COST, replace(COST, fresh_part=0.9)) == ["met"] * 5 + ["MISSED"]


def test_verdicts_that_never_came_are_told() -> None:
    empty = replace(COST, delay_s=np.array([]), unseen=3)
    assert "0, 3 never shown" in cost_table({"demo": empty})
    assert verdicts(empty, empty, COST)[2] == "MISSED"
    assert verdicts(replace(COST, unseen=3), COST, COST)[2] == "MISSED"  # of 199: more than one in a hundred

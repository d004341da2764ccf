"""Tables, aims and JSON of a report, made by hand."""

import json
import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.__main__ import bench
from bench.report import (
    Aim,
    aims_table,
    as_json,
    at_most,
    counts_in_words,
    grouped,
    judge,
    never,
    ratio,
    rms,
    table,
)


@dataclass(frozen=True)
class Timing:
    """Measured values of a bench."""

    latency_ms: float
    missed: Sequence[bool] = ()


AIMS: tuple[Aim[Timing], ...] = (
    at_most("latency", 5, " ms", lambda t: t.latency_ms, ".1f"),
    never("misses", lambda t: t.missed),
    Aim("enough cases", "10", lambda t: judge(f"{len(t.missed)}", len(t.missed) >= 10, is_open=True)),
)


def test_aims_are_judged_for_every_column() -> None:
    measured = {"quick": Timing(4.96, (False, True)), "fine": Timing(float("nan"), (False,) * 10)}
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in aims_table(AIMS, measured).splitlines()
    ]
    assert rows[0] == ["aim", "limit", "quick", "fine"]
    assert rows[2] == ["latency", "at most 5 ms", "met: 5.0 ms", "MISSED: -"]
    assert rows[3] == ["misses", "none", "MISSED: 1 of 2", "met: 0 of 10"]
    assert rows[4] == ["enough cases", "10", "open: 2", "met: 10"]


def test_json_says_when_and_where() -> None:
    found = json.loads(as_json("clock", False, ["a", table([{"n": "1"}])]))
    assert (found["bench"], found["quick"]) == ("clock", False)
    assert found["sections"] == ["a", [{"n": "1"}]]
    assert datetime.fromisoformat(found["date"]).tzinfo is not None
    assert found["machine"]["processors"] == os.cpu_count()
    assert found["commit"].startswith(commit())


def commit() -> str:
    """Commit of this checkout; nothing where it is none."""
    git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    return subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()


def test_words_of_cells() -> None:
    assert ratio([True, False, True]) == "2 of 3"
    assert counts_in_words(["b", "a", "a"]) == "a 2, b 1"
    assert counts_in_words([]) == "-"
    assert rms([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms([]))
    assert grouped([3, 1, 5, 2], lambda n: n % 2) == {1: [3, 1, 5], 0: [2]}


def test_an_option_that_a_bench_does_not_have_is_refused() -> None:
    refused = CliRunner().invoke(bench, ["slip", "--data", "x"])
    assert refused.exit_code == 2
    assert "--data is for" in refused.output

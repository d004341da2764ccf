"""Tables, aims and JSON of a report, made by hand."""

import json
import os
import subprocess
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.__main__ import bench
from bench.report import (
    aim,
    aims_table,
    as_json,
    at_most,
    grouped,
    median_aim,
    never,
    ratio,
    rms,
    table,
)


def test_aims_are_judged() -> None:
    aims = [
        at_most("latency", 5, 4.96, ".1f", " ms"),
        at_most("latency", 5, float("nan"), ".1f", " ms"),
        median_aim("ratio", 2.0, [1.0, 4.0, 3.0], ".1f"),
        median_aim("ratio", 2.0, [1.0, 4.0, 3.0], ".1f", is_least=True),
        never("misses", [False, True]),
        never("misses", 0),
        never("misses", []),
        aim("enough cases", "10", "2", False, is_open=True),
    ]
    assert [list(row.values()) for row in aims_table(aims, "quick").rows] == [
        ["latency", "at most 5 ms", "met: 5.0 ms"],
        ["latency", "at most 5 ms", "MISSED: -"],
        ["ratio", "at most 2", "MISSED: 3.0 (1.0 to 4.0)"],
        ["ratio", "at least 2", "met: 3.0 (1.0 to 4.0)"],
        ["misses", "none", "MISSED: 1 of 2"],
        ["misses", "none", "met: 0"],
        ["misses", "none", "open: 0 of 0"],
        ["enough cases", "10", "open: 2"],
    ]
    assert aims_table(aims, "quick").splitlines()[0].split() == ["|", "aim", "|", "limit", "|", "quick", "|"]


def test_json_says_when_and_where() -> None:
    found = json.loads(as_json("./run bench clock", ["tactiled/samples"], ["a", table([{"n": "1"}])]))
    assert (found["command"], found["code"]) == ("./run bench clock", ["tactiled/samples"])
    assert found["sections"] == ["a", [{"n": "1"}]]
    assert datetime.fromisoformat(found["date"]).tzinfo is not None
    assert found["machine"]["processors"] == os.cpu_count()
    git = [
        "git",
        "-C",
        str(Path(__file__).parent),
        "rev-parse",
        "HEAD",
    ]  # says nothing where there is no checkout
    head = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    assert found["commit"].startswith(head)


def test_words_of_cells() -> None:
    assert ratio([True, False, True]) == "2 of 3"
    assert rms([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms([]))
    assert grouped([3, 1, 5, 2], lambda n: n % 2) == {1: [3, 1, 5], 0: [2]}


def test_an_option_that_a_bench_does_not_have_is_refused() -> None:
    refused = CliRunner().invoke(bench, ["slip", "--data", "x"])
    assert refused.exit_code == 2
    assert "--data is for" in refused.output

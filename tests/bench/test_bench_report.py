"""Tables, aims and JSON of a report, made by hand."""

import json
import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner

from bench.__main__ import bench
from bench.report import (
    Aim,
    BenchOptions,
    BenchReport,
    aims_table,
    at_most,
    counts_in_words,
    grouped,
    judge,
    never,
    plain,
    ratio,
    rms,
    spread,
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


def test_rows_become_a_table() -> None:
    assert table({"n": f"{n}", "square": f"{n * n}"} for n in (2, 12)) == (
        "| n  | square |\n|----|--------|\n| 2  | 4      |\n| 12 | 144    |"
    )
    assert table([]) == "(no rows)"


class Place(NamedTuple):
    """A measured value inside another."""

    row: int
    column: float


def test_json_has_no_nan_and_names_every_field() -> None:
    value = {
        "timing": Timing(float("inf"), [True]),
        3: (np.float64(1.5), float("nan"), np.int64(2)),
        "place": Place(1, np.nan),
        "bool": np.bool_(True),
        "array": np.array([[1.0, np.inf]]),
        "seeds": range(2),
    }
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "timing": {"latency_ms": None, "missed": [True]},
        "3": [1.5, None, 2],
        "place": {"row": 1, "column": None},
        "bool": True,
        "array": [[1.0, None]],
        "seeds": [0, 1],
    }


def test_json_that_is_asked_for_says_when_and_where(tmp_path: Path) -> None:
    report = BenchReport(["a", table([{"n": "1"}])], {"x": 1})
    assert report.text == "a\n\n| n |\n|---|\n| 1 |"
    report.write("clock", BenchOptions())
    assert list(tmp_path.iterdir()) == []
    report.write("clock", BenchOptions(json=tmp_path / "json"))
    found = json.loads((tmp_path / "json").read_text())
    assert (found["bench"], found["quick"]) == ("clock", False)
    assert (found["sections"], found["numbers"]) == (["a", [{"n": "1"}]], {"x": 1})
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
    assert spread([1.0, 3.0], 1) == "2.0 ± 1.0"
    assert spread([], 1) == "-"
    assert rms([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms([]))
    assert grouped([3, 1, 5, 2], lambda n: n % 2) == {1: [3, 1, 5], 0: [2]}


def test_an_option_that_a_bench_does_not_have_is_refused() -> None:
    refused = CliRunner().invoke(bench, ["clock", "--dask", "localhost:1"])
    assert refused.exit_code == 2
    assert "--dask is for" in refused.output

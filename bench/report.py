"""Tables and aims in one form for all benches, and the JSON that says when and where they were measured.

A bench is a function ``bench_NAME(progress, options)`` in the module that `bench.__main__` lists. It returns
paragraphs and Markdown tables in the order of printing. `table` makes a table from rows; a row maps each
heading to the words in its cell, so that both stand in one line of the code::

    table({"model": s.name, "cost (ms/s)": f"{s.cost_ms:.1f}"} for s in scores)

`aims_table` makes one of aims, each with its limit, what was measured, and whether that meets it::

    aims_table([
        at_most("processor time of a simulated second", 5.0, found.cost_ms, ".1f", " ms"),
        never("answers where there are no grooves", [t.is_ok for t in found.flat]),
        aim("direction within one stated standard deviation", "68 %", f"{100 * part:.0f} %", part >= 0.68),
    ])
"""

import json
import os
import platform
import subprocess
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from tactiled import compiled, plain_table
from tactiled.progress import ProgressBar

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
BENCH_WORKERS = 2  # processes of the long benches: measured times are of a two-core machine
NONE = "-"  # in a cell without a value


@dataclass(frozen=True)
class BenchOptions:
    """Options of ``./run bench NAME``."""

    quick: bool = False  # fewer seeds and cases
    data: Path | None = None  # folder with data of others
    parts: tuple[str, ...] = ()  # names of the parts to do; empty for all


def as_json(
    command: str,
    code: Sequence[str],
    sections: Sequence[str],
    answers: Mapping[str, Sequence[float]] | None = None,
) -> str:
    """Return the sections, tables as rows, with command, commit, date and machine of the measurement.

    `code` are the paths of what is measured: `tools.figures` marks pages where these have changed since.
    A test fails where `answers` have changed since.
    """
    models = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    document = {
        "command": command,
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": models[0] if models else platform.machine(),
            "processors": os.cpu_count(),
            "load_average": os.getloadavg()[0],
            "python": platform.python_version(),
            "path_of_a_scan": compiled.path_words(),
        },
        "note": None,
        "code": list(code),
        "answers": answers,
        "sections": [part.rows if isinstance(part, Table) else part for part in sections],
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def commit() -> str:
    """Commit of this checkout, with ``-dirty`` where files differ from it; nothing where it is none.

    Figures do not count: one bench after the other writes them.
    """
    root = Path(__file__).parents[1]

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    differs = git("diff", "--name-only", "HEAD", "--", ".", ":!docs/figures")
    return git("rev-parse", "HEAD") + ("-dirty" if differs else "")


def load_words() -> str:
    """``load average 0.5 on 2 processors``."""
    return f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"


class Aim(NamedTuple):
    """A limit in words, what was measured, and the verdict; open: too few data to decide."""

    name: str
    limit: str
    words: str
    verdict: Literal["met", "open", "MISSED"]


def aim(name: str, limit: str, words: str, is_met: bool, *, is_open: bool = False) -> Aim:
    """Aim that is met, else open, else missed."""
    return Aim(name, limit, words, "met" if is_met else "open" if is_open else "MISSED")


def at_most(name: str, limit: float, value: float, form: str, unit: str = "") -> Aim:
    """Aim that a number does not exceed a limit; one that is not finite misses it. A unit has its blank."""
    words = f"{value:{form}}{unit}" if np.isfinite(value) else NONE
    return aim(name, f"at most {limit:g}{unit}", words, bool(value <= limit))


def median_aim(
    name: str, limit: float, repeats: Sequence[float], form: str, *, is_least: bool = False
) -> Aim:
    """Aim that the median over repeats is at most, or at least, a limit; their range is said, too."""
    median = np.median(repeats)
    words, is_met = over_runs(repeats, form), bool(median >= limit if is_least else median <= limit)
    return aim(name, f"at {'least' if is_least else 'most'} {limit:g}", words, is_met)


def never(name: str, happened: int | Sequence[bool]) -> Aim:
    """Aim that something did not happen, as a count or in any of the cases; without cases it is open."""
    if isinstance(happened, int):
        return aim(name, "none", f"{happened}", happened == 0)
    is_met = len(happened) > 0 and not any(happened)
    return aim(name, "none", ratio(happened), is_met, is_open=not happened)


class Table(str):
    """Markdown table that keeps its rows, which map headings to cells."""

    rows: list[dict[str, str]]


def aims_table(aims: Iterable[Aim], measured: str = "measured") -> Table:
    """Table of aims, with the verdict before what was measured in a column of that name."""
    return table({"aim": a.name, "limit": a.limit, measured: f"{a.verdict}: {a.words}"} for a in aims)


def table(rows: Iterable[Mapping[str, str]]) -> Table:
    """Markdown table; all rows have the same headings in the same order."""
    known = [dict(row) for row in rows]
    made = Table(
        plain_table.table(list(known[0]), [list(row.values()) for row in known]) if known else "(no rows)"
    )
    made.rows = known
    return made


def grouped(records: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """Records by key, with keys and records in their first order."""
    groups: dict[K, list[T]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return groups


def counted(results: Iterable[T], progress: ProgressBar, name: str, seconds: float = 1.0) -> list[T]:
    """List results as they come, each of which advances the bar."""
    found = []
    for result in results:
        found.append(result)
        progress.advance(name, seconds)
    return found


def ratio(cases: Iterable[bool]) -> str:
    """``3 of 40``."""
    known = list(cases)
    return f"{sum(known)} of {len(known)}"


def seeds_in_words(number: int, first: int = 0) -> str:
    """``seeds 0..9``."""
    return f"seeds {first}..{first + number - 1}"


def over_runs(values: Sequence[float], form: str) -> str:
    """Median over repeats, with its range: ``4.5 (4.3 to 4.8)``."""
    return f"{np.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


CONFIDENCE = 0.95  # of the largest rate that is not excluded


def largest_rate(n: int, of: int) -> float:
    """Return the largest rate that n cases of some do not exclude (one-sided; Clopper and Pearson 1934)."""
    return float(special.betaincinv(n + 1, of - n, CONFIDENCE)) if of > n else 1.0


def rms(values: ArrayLike) -> float:
    """Root mean square; NaN where there are no values."""
    known = np.asarray(values, dtype=np.float64)
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")

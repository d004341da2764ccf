"""Aims of the bench of the page, on numbers made by hand."""

import os
import time
from dataclasses import replace

from bench.report import aims_table
from bench.web.bench import AIMS, PageMeasures, cpu_s

GOOD = PageMeasures(
    lamp_s=(0.05, 0.08), slip_s=(0.1,), server_part={1: 0.04, 10: 0.05, 50: 0.09}, page_part=0.2,
    tab_part=0.3, pictures_per_s=30.0, heap_mb=(5.0,) * 12, server_mb=(100.0,) * 12, watched_s=600.0,
)  # fmt: skip


def verdicts(measured: PageMeasures) -> list[str]:
    rows = aims_table(AIMS, {"measured": measured}).splitlines()[2:]
    return [row.split("|")[3].split(":")[0].strip() for row in rows]


def test_good_numbers_meet_every_aim() -> None:
    assert verdicts(GOOD) == ["met"] * len(AIMS)


def test_each_bad_number_misses_its_own_aim() -> None:
    bad = [
        replace(GOOD, lamp_s=(0.05, 0.6)),
        replace(GOOD, slip_s=(0.3,)),
        replace(GOOD, server_part={1: 0.06, 50: 0.1}),
        replace(GOOD, server_part={1: 0.04, 2: 0.1}),
        replace(GOOD, page_part=0.4),
        replace(GOOD, pictures_per_s=20.0),
        replace(GOOD, heap_mb=tuple(5.0 + 0.1 * n for n in range(12))),
        replace(GOOD, server_mb=tuple(100.0 + n for n in range(12))),
    ]
    for number, measured in enumerate(bad):
        found = verdicts(measured)
        assert found.pop(number) == "MISSED"
        assert set(found) == {"met"}


def test_nothing_measured_misses_and_a_short_time_says_nothing_on_growth() -> None:
    assert verdicts(replace(GOOD, lamp_s=(), slip_s=()))[:2] == ["MISSED", "MISSED"]
    short = replace(GOOD, heap_mb=tuple(5.0 + 0.1 * n for n in range(12)), watched_s=60.0)
    assert verdicts(short)[6] == "open"


def test_processor_time_of_this_process_grows() -> None:
    before_s = cpu_s(os.getpid())
    until_s = time.process_time() + 0.05
    while time.process_time() < until_s:
        pass
    assert cpu_s(os.getpid()) > before_s

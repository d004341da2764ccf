"""What is printed, drawn and written of cases made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tactiled.bench import slip_tables
from tactiled.bench.slip import plain
from tactiled.bench.slip_cost import Cost
from tactiled.bench.slip_latency import CURVE_PER_HOUR, Case, fastest_level
from tactiled.bench.slip_noise import Tail
from tactiled.bench.slip_picture import draw_slip
from tactiled.bench.slip_quiet import HELD, QUIET_NOISES_V, Alarms, Counted, count
from tactiled.bench.slip_rivals import Knobs, rivals
from tactiled.bench.slip_rules import LEVELS, RULES
from tactiled.bench.slip_scenes import NOISES_V, SPEEDS_MM_S, Announcement, announcements, play, speed_name
from tactiled.bench.slip_score import Found
from tactiled.cli import cli
from tactiled.emulator.families import QUIET

TAIL = Tail(5.0, 0.5, 1.0)
KNOBS = Knobs({(rule, level): TAIL for rule in RULES for level in LEVELS}, dict.fromkeys(NOISES_V, 2))
NAMES = list(rivals(KNOBS))
SAID = Found(0.02, 0.1, -0.01, 0.03, 0.01, 0.02, 0.03, 0.01, 3.0, 5.0, early=1, on_press=0)
_NAN = float("nan")
MISSED = Found(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, early=0, on_press=2)
ALARMS = Alarms(hours=2.0, false=6, gross=1, on_press=2, partial=3, told_false=6)


def case(seed: int, noise_v: float, found: Found) -> Case:
    """Level 2 is the fastest, the oracle takes 10 ms."""
    n = len(CURVE_PER_HOUR)
    rule_s = {key: np.full(n, 0.01 * (1 + abs(key[1] - 2))) for key in KNOBS.tails}
    return Case(
        "slide", seed, noise_v, dict.fromkeys(NAMES, found), np.full(n, 0.01), rule_s, becoming_s=0.12
    )


@pytest.fixture
def cases() -> list[Case]:
    found = (SAID, replace(SAID, first_s=0.04, to_gross_s=-0.01), MISSED)
    return [case(seed, noise, one) for noise in NOISES_V for seed, one in enumerate(found)]


@pytest.fixture
def counted() -> Counted:
    quiet = Counted()
    for noise in (0.3e-3, 3e-3):
        for name in NAMES:
            quiet["taps", noise, name] = ALARMS
            quiet["hold", noise, name] = replace(ALARMS, false=0, gross=0, told_false=0)
    return quiet


def cells(text: str, *starts: str) -> list[str]:
    """Of the first row that begins so."""
    for line in text.splitlines():
        row = [cell.strip() for cell in line.strip("|").split("|")]
        if row[: len(starts)] == list(starts):
            return row[len(starts) :]
    raise AssertionError(f"no row {starts} in\n{text}")


def test_latency_table(cases: list[Case]) -> None:
    text = slip_tables.latency_table(cases, NAMES)
    assert cells(text, "1 mV", "oracle")[:5] == ["10 ms", "10 ms", "0 of 3", "1.0", "1.0"]
    row = cells(text, "1 mV", NAMES[0])
    assert row[:4] == ["40 ms", "-", "1 of 3", "4.0"]  # of three, one missed: p95 is a miss
    assert row[5:] == ["33 %", "-10 ms / -10 ms (2)", "30 ms", "2", "2"]


def test_speeds_have_rows_of_their_own(cases: list[Case]) -> None:
    steady = [replace(one, family=speed_name(speed)) for speed in SPEEDS_MM_S for one in cases]
    text = slip_tables.speed_table(steady, NAMES)
    assert cells(text, "20 mm/s", "3 mV")[:2] == ["10 ms / 10 ms", "40 ms / -, 1 missed"]
    assert len(text.splitlines()) == 2 + len(SPEEDS_MM_S) * len(NOISES_V)


def test_a_missed_slip_comes_first_among_the_worst(cases: list[Case]) -> None:
    assert cells(slip_tables.worst_table(cases, NAMES, most=1), NAMES[0])[:4] == [
        "slide",
        "2",
        "0.3 mV",
        "missed",
    ]


def test_estimates(cases: list[Case]) -> None:
    row = cells(slip_tables.estimate_table(cases, NAMES), NAMES[0], "1 mV")
    assert row == ["3.0 deg", "3.0 deg", "100 %", "10 ms", "100 %", "30 ms", "0 %"]


def test_false_alarms_a_minute(counted: Counted) -> None:
    text = slip_tables.quiet_table(counted, NAMES)
    assert cells(text, "0.3 mV", "taps")[:2] == ["120.0 min", "0.050, 1 gross (+3 right)"]
    assert cells(text, "0.3 mV", "hold")[1] == "0.000 (+3 right)"
    holds = {(HELD, noise, NAMES[0]): ALARMS for noise in NOISES_V}
    assert (
        cells(slip_tables.hold_table(holds, {NAMES[0]: lambda _: 1.5}), NAMES[0])
        == ["4 of 3, 2 on the press"] * 4
    )
    counted["taps", 3e-3, NAMES[0]] = replace(ALARMS, told_false=2)
    counted["cable-tug", 3e-3, NAMES[0]] = replace(ALARMS, false=90)
    # Families count alike, but for what nobody could tell of.
    assert slip_tables.per_hour(counted, 3e-3, NAMES[0]) == (1.5, 0.5)


def test_alarms_add_up() -> None:
    told = replace(ALARMS, told_false=2)
    assert told + ALARMS == Alarms(4.0, 12, 2, 4, 6, 8)


def test_the_fastest_level_is_found(cases: list[Case]) -> None:
    assert fastest_level(cases, "any channel") == dict.fromkeys(NOISES_V, 2)


def test_numbers_are_json_without_nan_and_the_picture_is_drawn(
    cases: list[Case], counted: Counted, tmp_path: Path
) -> None:
    numbers = plain({"tune": [1]}, KNOBS, TAIL, cases, counted, {"some": Cost(30.0, 1e5)})
    read = json.loads(json.dumps(numbers, allow_nan=False))
    assert read["slips"][2]["found"][NAMES[0]]["first_s"] is None
    assert read["slips"][0]["found"][NAMES[0]]["first_s"] == 0.02
    assert read["quiet"][0]["false"] == 6
    draw_slip(tmp_path / "slip.png", cases, counted, KNOBS)
    assert (tmp_path / "slip.png").stat().st_size > 10_000


def test_scenes_without_slip_are_counted_for_every_detector() -> None:
    counted = count("taps", 1, 2, KNOBS, NAMES[:2])
    assert set(counted) == {("taps", noise, name) for noise in QUIET_NOISES_V for name in NAMES[:2]}
    played = play("taps", QUIET["taps"], 1)
    assert counted["taps", 3e-3, NAMES[0]].hours == pytest.approx(2 * played.duration_s / 3600)


@pytest.mark.parametrize(
    ("family", "kinds"), [("arm-acceleration", {"inhibit", "load-change"}), ("taps", {"load-change"})]
)
def test_only_what_a_controller_does_itself_is_announced(family: str, kinds: set[str]) -> None:
    scene = QUIET[family](1)
    said = announcements(scene)
    assert {one.kind for one in said} == kinds
    assert said[0] == Announcement("load-change", 0.0, scene.phases[0].duration_s)  # the press
    assert all(one.start_s < scene.duration_s for one in said)


@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_files_are_written_only_by_benches_that_have_them(option: str, tmp_path: Path) -> None:
    refused = CliRunner().invoke(cli, ["bench", "clock", option, str(tmp_path / "out")])
    assert refused.exit_code == 2
    assert f"{option} is for" in refused.output

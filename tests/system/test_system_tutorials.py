"""Tutorials do what they say: their commands run, and print what the page shows."""

import os
import re
import shutil
from pathlib import Path

import pytest
from tutorials import Reader, agrees

from bench.machine.board_in_qemu import PACKAGES
from bench.processes import need_programs
from tactiled import resources
from tactiled.errors import OperatorError

DOCS = Path(__file__).parents[2] / "docs"
ITS_GRIPPER = f"""
import sys
sys.path.append({str(DOCS.parent / "examples")!r})
from hold import EmulatedGripper
hold(EmulatedGripper("unix://gripper"))
"""
PRINTED = '{"topic": "slip", "kind": "gross", "direction_deg": 90.2, "valid": true, "seq": 3}'


@pytest.mark.system
@pytest.mark.alone  # emulated boards in real time
@pytest.mark.parametrize(
    ("page", "heading", "commands"),
    [("first-steps.md", "First slip", 3), ("your-sensor.md", "4. A live board", 2)],
)
def test_a_tutorial_prints_what_it_shows(page: str, heading: str, commands: int, tmp_path: Path) -> None:
    with Reader(tmp_path) as reader:
        reader.follow(DOCS / page, heading)
    assert len(reader.commands) == commands


@pytest.mark.system
@pytest.mark.alone
@pytest.mark.parametrize("program", ["examples/hold.py unix://gripper", "own.py"])
def test_the_tutorial_of_the_grip_holds_what_it_does_not_know(program: str, tmp_path: Path) -> None:
    text = (DOCS / "hold.md").read_text()
    if program == "own.py":  # the loop of the page, which prints nothing but what the gripper says at the end
        (loop,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        program = str(tmp_path / program)
        Path(program).write_text(f"{loop}\n{ITS_GRIPPER}")
        text = re.sub(r"    .* N \w+ [\d.]+\n", "", text.replace("examples/hold.py unix://gripper", program))
    page = tmp_path / "page.md"
    page.write_text(text)
    with Reader(tmp_path, tolerance=0.7, may_skip=True) as reader:  # the limits of the page follow
        reader.follow(page, "Try it")
        assert reader.commands == [f"python {program}"]
    least_n, most_n = map(float, re.findall(r"a force of (\S+) to (\S+) N", text)[0])
    assert least_n == pytest.approx(3.6 / (0.45 * 1.1), abs=0.05)  # load over friction, once it is filled
    assert most_n == pytest.approx(2.5 * least_n, abs=0.1)
    assert least_n < float(reader.last.removeprefix("held with ").removesuffix(" N")) < most_n


@pytest.mark.system
@pytest.mark.alone  # qemu in real time
def test_the_tutorial_of_the_board_brings_up_an_emulated_one(tmp_path: Path) -> None:
    try:
        need_programs({"cc": "gcc", **PACKAGES})
    except OperatorError as missing:
        if "TACTILED_CI" in os.environ:
            raise
        pytest.skip(str(missing))
    protocols = resources.shipped("protocols")
    shutil.copytree(protocols, tmp_path / "protocols")  # programs are compiled there
    with Reader(tmp_path, may_skip=True) as reader:
        reader.follow(protocols / "bring-up.md", "Try it without hardware")
        reader.follow(protocols / "bring-up.md", "Checks, in order")
    assert [command.split()[0] for command in reader.commands] == [
        "arm-none-eabi-gcc", "cc", "./vectors", "tactiled", "tactiled", "tactiled", "tactiled",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("shown", "printed", "is_shown"),
    [
        ('{"topic": "slip", "direction_deg": 95, ...}', PRINTED, True),
        ('{"topic": "slip", "direction_deg": 80, ...}', PRINTED, False),
        ('{"topic": "slip", "valid": false, ...}', PRINTED, False),
        ('{"topic": "slip", "speed_mm_s": 1, ...}', PRINTED, False),
        ("log.csv: 1309 scans", "log.csv: 1250 scans", True),
        ("log.csv: 1309 scans", "log.csv: 1000 scans", False),
        ("log.csv: 1309 scans", "log.csv: 1309 events", False),
        ("log.csv: ... scans", "log.csv: 12 good scans", True),
        ("log.csv: ... scans", "log.csv: 12 scans missing", False),
        ("scans: ... 1309 scans", "scans: scans", False),
    ],
)
def test_a_number_or_word_that_differs_is_found(shown: str, printed: str, is_shown: bool) -> None:
    assert agrees(shown, printed) is is_shown

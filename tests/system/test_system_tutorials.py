"""Tutorials do what they say: their commands run, and print what the page shows."""

from pathlib import Path

import pytest
from tutorials import Reader, agrees

DOCS = Path(__file__).parents[2] / "docs"
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
    ],
)
def test_a_number_or_word_that_differs_is_found(shown: str, printed: str, is_shown: bool) -> None:
    assert agrees(shown, printed) is is_shown

"""Ten states of the page, each of which says in words what it shows.

``TACTILED_STILLS=FOLDER ./run test tests/web/test_web_stills.py`` writes a picture of each, under a number
that tells nothing, and ``key.txt`` with what a person should find in them.
"""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from access import faults
from pages import Robot, robot, staged
from playwright.sync_api import Page, expect
from recordings import record, simulated_reads
from stage import Then

pytestmark = pytest.mark.system
NEAR_S, GROSS_S, PARTIAL_S, HOLDING_S = 11.75, 8.0, 6.3, 5.0  # of the scene demo


class Still(NamedTuple):
    """State of the page: boards by the end of their play, what a person should say, what the page says."""

    number: int
    plays: tuple[float, ...]
    answer: str
    sentence: str
    lamp: str = "fresh"
    then: Then = "hold"
    forces: bool = True


STILLS = {
    "holding": Still(4, (HOLDING_S,), "An object is held, and nothing is wrong.", "Holding$"),
    "near": Still(8, (NEAR_S,), "It is held, but near slipping: grip harder.",
                  "Holding near the friction limit"),
    "slipping": Still(2, (GROSS_S,), "It slips (towards +x): grip harder.", r"Slipping towards \+x"),
    "partial": Still(6, (PARTIAL_S,), "It begins to slip, a part of it: grip harder.", "Beginning to slip"),
    "stale": Still(10, (HOLDING_S,), "Old data: the daemon says nothing any more.", "No status", "stale"),
    "gap": Still(3, (HOLDING_S,), "It is held now; data are missing for a few seconds before.", "Holding$",
                 then="gap"),
    "uncalibrated": Still(9, (HOLDING_S,), "It is held; forces are not known, since nothing is calibrated.",
                          "Holding$", forces=False),
    "no board": Still(1, (HOLDING_S,), "No board is plugged in.", "Is the board plugged in", "none", "gone"),
    "two boards": Still(7, (HOLDING_S, GROSS_S), "Two boards: one holds, the other slips.", "Holding$"),
    "recording": Still(5, (), "A recording, not live: it slips at this instant.", "Slipping", "replay"),
}  # fmt: skip
SIGHTS: dict[str, Callable[[Page], None]] = {
    "gap": lambda page: expect(page.locator(".events .list")).to_contain_text("no scans for"),
    "uncalibrated": lambda page: expect(page.locator(".calibration")).to_contain_text("Not calibrated"),
    "holding": lambda page: expect(page.locator(".loads")).to_contain_text(re.compile(r"\d N")),
    "two boards": lambda page: see_the_other_board(page),
}
"""What else must be in the picture."""


def see_the_other_board(page: Page) -> None:
    """A board that slips is marked on its button, where only the other one is shown, too."""
    expect(page.locator(".lamp[data-level=gross]")).to_have_count(1)
    page.keyboard.press("1")
    expect(page.locator(".board:visible")).to_have_count(1)
    expect(page.locator("#chooser [data-level=gross]")).to_have_text("TS0002")
    expect(page.locator("#chooser [data-level=good]")).to_have_text("TS0001")
    page.keyboard.press("0")


@contextmanager
def shown(page: Page, made: Robot, still: Still) -> Iterator[None]:
    """Bring a page into a state."""
    if not still.plays:
        path = made.folder / "demo.mcap"
        record(path, simulated_reads(12.0, "demo"))
        page.goto(f"{made.serve('--file', str(path), events=False)}#at={GROSS_S}")
        yield
        return
    plays = [(f"TS000{n}", "demo", end_s) for n, end_s in enumerate(still.plays, 1)]
    with ExitStack() as stack:
        stack.enter_context(staged(page, made, *plays, forces=still.forces, then=still.then))
        expect(page.locator(".board")).to_have_count(len(plays))
        if still.lamp == "stale":
            expect(page.locator(".advice")).to_have_text("Holding")
            stack.close()
        yield


@pytest.mark.parametrize("name", STILLS)
def test_a_still_says_what_it_shows(page: Page, tmp_path: Path, name: str) -> None:
    still = STILLS[name]
    with robot(tmp_path) as made, shown(page, made, still):
        if name in SIGHTS:
            SIGHTS[name](page)
        advice = page.locator(".advice").filter(has_text=re.compile(still.sentence)).first
        expect(advice).to_be_visible()
        expect(page.locator(".lamp").first).to_have_attribute("data-state", still.lamp)
        if still.lamp in ("fresh", "replay"):  # what needs a hand says so; a recording needs none
            needs_hand = name in ("near", "slipping", "partial")
            assert advice.inner_text().endswith(": tighten") is needs_hand
        keep(page, still)
        assert faults(page) == []


def test_every_still_has_a_number_of_its_own() -> None:
    assert sorted(still.number for still in STILLS.values()) == list(range(1, 11))


def keep(page: Page, still: Still) -> None:
    """Write the picture and the key where the environment names a folder."""
    named = os.environ.get("TACTILED_STILLS")
    if named is None:
        return
    page.wait_for_timeout(1500)  # the curves are drawn ten times a second
    folder = Path(named)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{still.number:02d}.png").write_bytes(page.screenshot())
    lines = [
        f"{one.number:02d}.png: {one.answer}\n" for one in sorted(STILLS.values(), key=lambda one: one[0])
    ]
    (folder / "key.txt").write_text("".join(lines))

"""The timeline of the page: zoomed, paused, with other curves, marked, and saved as table and picture."""

import csv
import re
import struct
import time
from itertools import pairwise
from pathlib import Path

import pytest
from pages import robot, staged
from patience import PATIENCE_S
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.system
VALUES = re.compile(r"load (–|-?\d)")  # of a point, which has come by then
HELD = ("TS0001", "demo", 5.0)  # at its end it is held
HEAD = "epoch_s,load_V,shear_V,p_gross_100ms,utilisation,p_sliding,rate_hz"


def test_a_timeline_is_paused_zoomed_and_saved_with_its_gaps(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, staged(page, made, ("TS0001", "demo", 6.0)):
        expect(page.locator(".events")).to_contain_text("no scans for")
        page.wait_for_timeout(3500)  # it is held, and nothing that came before is still on its way
        page.get_by_role("button", name="Pause").click()
        expect(page.get_by_role("button", name="Continue")).to_be_visible()
        page.wait_for_timeout(500)
        plot = page.locator(".timeline .u-over")
        before = plot.screenshot()
        page.wait_for_timeout(1000)
        assert plot.screenshot() == before
        box = plot.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 50)
        expect(page.locator(".readout")).to_have_text(VALUES)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] - 5, box["y"] + 60)
        page.mouse.up()
        until_s = time.monotonic() + PATIENCE_S
        while plot.screenshot() == before:
            assert time.monotonic() < until_s, "the plot is not zoomed"
            page.wait_for_timeout(100)
        page.get_by_role("button", name="Continue").click()
        with page.expect_download() as download:
            page.get_by_role("button", name="CSV").click()
        head, *rows = download.value.path().read_text().splitlines()
    assert head == HEAD + ",mark"
    instants = [float(row.split(",")[0]) for row in rows]
    steps = [later - earlier for earlier, later in pairwise(instants)]
    assert max(steps) > 1.0  # the time without a board ...
    widest = steps.index(max(steps))
    assert ",,,,,,," in rows[widest] + rows[widest + 1]  # ... has a row without values


def point_at(page: Page, share: float) -> None:
    """Point at this share of the width of the timeline, and wait for the values there."""
    box = page.locator(".timeline .u-over").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + share * box["width"], box["y"] + 50)
    expect(page.locator(".readout")).to_have_text(VALUES)


def save(page: Page, button: str) -> Path:
    with page.expect_download() as download:
        page.get_by_role("button", name=button).click()
    return download.value.path()


def test_curves_are_chosen_and_stand_in_the_table(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, staged(page, made, HELD, then="hold"):
        expect(page.locator(".lamp[data-level=good]")).to_be_visible()
        page.locator(".curves summary").press("Enter")
        for name in ("load", "shear"):
            page.get_by_label(name, exact=True).uncheck()
        for name in ("sliding", "rate", "t0.R3"):
            page.get_by_label(name, exact=True).check()
        page.keyboard.press("Escape")
        expect(page.locator(".choices")).to_be_hidden()
        shown = ["in use", "sliding", "rate", "t0.R3"]
        assert page.locator(".keys .key").all_inner_texts() == shown
        box = page.locator(".timeline .u-over").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] - 3, box["y"] + 50)
        expect(page.locator(".readout")).to_contain_text("rate 100 Hz, t0.R3")
        assert "load" not in page.locator(".readout").inner_text()
        rows = list(csv.DictReader(save(page, "CSV").read_text().splitlines()))
        readings = [float(row["t0.R3_V"]) for row in rows if row["t0.R3_V"]]
        assert max(map(abs, readings)) > 0.1  # it is pressed
        assert rows[-1]["rate_hz"] == "100"  # the first ones came before any status
        page.reload()
        expect(page.locator(".keys .key")).to_have_text(shown[:-1])  # channels are of one look


def test_a_picture_of_the_timeline_has_its_size(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, staged(page, made, HELD, then="hold"):
        expect(page.locator(".lamp[data-level=good]")).to_be_visible()
        octets = save(page, "PNG").read_bytes()
        size = page.locator(".timeline canvas").evaluate("canvas => [canvas.width, canvas.height]")
    assert octets.startswith(b"\x89PNG")
    assert list(struct.unpack(">2I", octets[16:24])) == [size[0], size[1] + 44]


def test_marks_of_a_page_that_may_not_command_stay_in_it(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, staged(page, made, HELD, then="hold"):
        expect(page.locator(".lamp[data-level=good]")).to_be_visible()
        point_at(page, 0.5)
        page.mouse.move(0, 0)
        expect(page.locator(".readout")).to_contain_text("drag to zoom")
        page.keyboard.press("m")
        expect(page.locator(".events .list")).to_contain_text("mark 1, kept in this page only")
        page.get_by_role("button", name="Pause").click()
        point_at(page, 0.01)  # the first point is the nearest
        page.keyboard.press("m")
        rows = list(csv.DictReader(save(page, "CSV").read_text().splitlines()))
    marked = {row["mark"]: float(row["epoch_s"]) for row in rows if row["mark"]}
    assert list(marked) == ["mark 2", "mark 1"]  # the second one is of the instant under the pointer

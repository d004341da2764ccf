"""What a person sees of a page: it is still, in view and legible; from events that are computed before."""

import time
from pathlib import Path
from typing import Any

import pytest
from access import faults
from pages import robot, staged
from playwright.sync_api import Browser, Page, expect
from recordings import record, simulated_reads
from stage import stage

pytestmark = pytest.mark.system
MOST_SHIFT = 0.05  # of half a minute; web.dev calls 0.1 for 5 s good
WATCHED_S = 26.0  # the demo of 20 s, the pause without a board, and the beginning of the next
WATCH = """() => {
  window.shifts = [];
  new PerformanceObserver((list) => { for (const entry of list.getEntries()) shifts.push(entry.value); })
    .observe({ type: "layout-shift", buffered: true });
}"""
VIEWS: dict[str, dict[str, Any]] = {
    "desktop": {"viewport": {"width": 1280, "height": 800}},
    "phone": {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 2},
}
# Text and ground by the names of style.css, where axe-core sees none: on a canvas, and of a late lamp.
PAIRS = [
    ("muted", "card"), ("late-ink", "late"),
    *(("band-ink", f"band-{state}") for state in ("loading", "holding", "shearing", "sliding", "unknown")),
]  # fmt: skip


def test_a_round_of_the_demo_does_not_move_the_page(browser: Browser, tmp_path: Path) -> None:
    with robot(tmp_path) as made, stage(tmp_path, ("TS0001", "demo", 20.0)) as endpoint:
        made.endpoint = endpoint
        url = made.serve()
        pages = {}
        for name, view in VIEWS.items():
            page = pages[name] = browser.new_context(**view).new_page()
            page.add_init_script(f"({WATCH})()")
            page.goto(url)
            expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        for page in pages.values():
            page.evaluate("shifts.length = 0")
        sentences = set()
        until_s = time.monotonic() + WATCHED_S
        while time.monotonic() < until_s:
            page.wait_for_timeout(200)
            sentences.add(page.locator(".advice").inner_text().split(" for ")[0])
        moved = {name: sum(page.evaluate("shifts")) for name, page in pages.items()}
        for page in pages.values():
            page.context.close()
    gone = "Is the board plugged in? No such port."
    assert {"Holding", "Slipping towards +x", gone} <= sentences  # it went on
    assert max(moved.values()) < MOST_SHIFT, moved


def test_two_boards_are_in_view_and_one_can_be_chosen(page: Page, tmp_path: Path) -> None:
    plays = (("TS0001", "demo", 12.0), ("TS0002", "demo", 5.0))
    with robot(tmp_path) as made, staged(page, made, *plays, then="hold"):
        expect(page.locator(".board")).to_have_count(2)
        expect(page.locator(".lamp").nth(1)).to_have_attribute("data-state", "fresh")
        for place in (".advice", ".loads", ".margin", ".timeline canvas"):
            for board in range(2):
                box = page.locator(f".board >> nth={board} >> {place}").bounding_box()
                assert box is not None
                assert box["y"] + box["height"] <= 800, (place, board)
        page.get_by_role("button", name="TS0002").click()
        expect(page.locator(".board:visible .who .name")).to_have_text("TS0002")
        page.keyboard.press("0")
        expect(page.locator(".board:visible")).to_have_count(2)
        page.keyboard.press("1")
        expect(page.locator(".board:visible .who .name")).to_have_text("TS0001")
        page.set_viewport_size({"width": 320, "height": 640})  # WCAG 2.2, success criterion 1.4.10
        assert page.evaluate("document.documentElement.scrollWidth") <= 320


LUMINANCE = """([ink, ground]) => {
  const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const style = getComputedStyle(document.documentElement);
  const light = (name) => {
    probe.fillStyle = style.getPropertyValue(`--${name}`).trim() || name;
    probe.fillRect(0, 0, 1, 1);
    const [r, g, b] = [...probe.getImageData(0, 0, 1, 1).data].map((v) => v / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const [low, high] = [light(ink), light(ground)].sort((a, b) => a - b);
  return (high + 0.05) / (low + 0.05);
}"""


def test_text_has_the_contrast_of_wcag_aa(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made:
        page.goto(made.serve())
        for theme in ("light", "dark"):
            page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
            poor = {pair: page.evaluate(LUMINANCE, list(pair)) for pair in PAIRS}
            assert {pair: ratio for pair, ratio in poor.items() if ratio < 4.5} == {}, theme


def test_curves_and_recordings_to_choose_are_accessible(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, stage(tmp_path, ("TS0001", "demo", 5.0), then="hold") as made.endpoint:
        record(tmp_path / "demo.mcap", simulated_reads(2.0, "demo"))
        page.goto(made.serve("--recordings", str(tmp_path)))
        expect(page.locator(".lamp[data-level=good]")).to_be_visible()
        page.locator("summary", has_text="Curves").press("Enter")
        assert faults(page) == []
        page.keyboard.press("r")
        expect(page.get_by_role("link", name="Open demo.mcap")).to_be_visible()
        assert faults(page) == []


MIN_CONTROL_PX = 44  # Apple's guidelines; WCAG 2.2, success criterion 2.5.5
LOW_CONTROLS = """(least) => [...document.querySelectorAll("a, button, select, input, summary")]
  .filter((e) => e.checkVisibility() && e.getBoundingClientRect().height < least).map((e) => e.outerHTML)"""


def test_the_page_is_accessible_in_every_state(browser: Browser, tmp_path: Path) -> None:
    pages = {device: browser.new_context(**view).new_page() for device, view in VIEWS.items()}
    with robot(tmp_path) as made:
        made.run()
        url = made.serve("--allow-commands")
        made.plug("demo")  # which the server hears from its beginning
        for device, page in pages.items():
            page.goto(url)
            expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
            expect(page.locator(".commands")).to_be_visible()
            page.locator(".readings summary").click()
            expect(page.locator(".events .event").nth(9)).to_be_attached()  # the list can be scrolled
            assert faults(page) == []
            page.keyboard.press("?")
            assert faults(page) == []
            if device == "phone":
                assert page.evaluate(LOW_CONTROLS, MIN_CONTROL_PX) == []
            page.keyboard.press("Escape")
        for process, state in (("board", "none"), ("daemon", "stale")):
            made.stop(process)
            for page in pages.values():
                expect(page.locator(".lamp")).to_have_attribute("data-state", state)
                assert faults(page) == []
    for page in pages.values():
        page.context.close()

"""The page on a desktop and on a phone, in light and in dark, beside the demo scene; screenshots of it.

The pictures in the documents are made by this test: ``TACTILED_PICTURES=docs ./run test
tests/web/test_web_pictures.py``.
"""

import itertools
import re
from pathlib import Path
from typing import Literal

import pytest
from pages import robot, staged
from playwright.sync_api import Browser, Page, ViewportSize, expect
from stage import stage

pytestmark = pytest.mark.system
SIZES = {"desktop": (1280, 860, 1), "phone": (390, 844, 2)}
NAMES = {
    ("desktop", "light"): "web.png",
    ("desktop", "dark"): "web-dark.png",
    ("phone", "light"): "web-phone-light.png",
    ("phone", "dark"): "web-phone.png",
}
GROSS_S, LIFTS_S = 6.3, 12.0  # of the scene demo: all of the contact slides, until it is lifted


def test_the_page_fits_desktop_and_phone(browser: Browser, tmp_path: Path, pictures: Path | None) -> None:
    play = ("TS0001", "demo", 12.0 if pictures is None else 20.0)  # a picture shows the grooves, too
    with robot(tmp_path) as made, stage(tmp_path, play, forces=True) as made.endpoint:
        url = made.serve()
        schemes: tuple[Literal["light", "dark"], ...] = ("light", "dark")
        for (device, (width, height, scale)), scheme in itertools.product(SIZES.items(), schemes):
            viewport: ViewportSize = {"width": width, "height": height}
            # One page at a time: several slow a small host so much that they show STALE.
            context = browser.new_context(viewport=viewport, device_scale_factor=scale, color_scheme=scheme)
            page = context.new_page()
            page.goto(url)
            expect(page.locator("canvas.array")).to_have_attribute("aria-label", re.compile("TS0001"))
            expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
            overflow = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
            assert overflow <= 0, (device, scheme)
            for element in (".lamp .word", "canvas.array", ".timeline canvas", ".strip"):
                assert page.locator(element).first.is_visible(), element
            if pictures is not None:
                seen = page.locator(".board:has(.lamp[data-level=gross][data-state=fresh])")
                expect(seen.locator(".grooves .texture")).to_contain_text("normal at", timeout=120_000)
                (pictures / NAMES[device, scheme]).write_bytes(page.screenshot())
            context.close()


def test_the_picture_of_a_slip_agrees_with_itself(page: Page, tmp_path: Path, pictures: Path | None) -> None:
    """The first slip of the scene demo, of which `tactiled demo` draws the beginning."""
    page.set_viewport_size({"width": 1280, "height": 650})
    with robot(tmp_path) as made, staged(page, made, ("TS0001", "demo", 11.0), live_s=11.0, forces=True):
        page.locator(".timeline .span").select_option("10")
        board = page.locator(".board:has(.lamp[data-level=gross][data-state=fresh])")
        sentence = re.compile(r"^Slipping towards \+x for ([\d.]+)\ss: tighten$")
        expect(board.locator(".advice")).to_have_text(sentence)
        said = sentence.match(board.locator(".advice").inner_text())
        assert said is not None
        assert float(said[1]) < LIFTS_S - GROSS_S
        slips = page.locator(".events .list li[data-topic=slip]")
        expect(slips.nth(0)).to_contain_text("gross slip towards +x")
        expect(slips.nth(1)).to_contain_text("incipient slip towards +x")
        assert int(re.findall(r"\d+", page.locator(".used").inner_text())[0]) >= 90
        if pictures is not None:
            page.wait_for_timeout(1500)  # a while of the slide
            (pictures / "web-slip.png").write_bytes(page.screenshot())

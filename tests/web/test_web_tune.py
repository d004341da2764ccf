"""`tactiled tune` in the page: a person is guided through a hold and a motion, and sees the verdict."""

import re
from pathlib import Path

import pytest
from access import faults
from held_scene import HELD
from pages import Robot, open_with_commands
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.system
LOW = """() => [...document.querySelectorAll(".tune :is(button, input, summary)")]
  .filter((e) => e.checkVisibility() && e.getBoundingClientRect().height < 44).map((e) => e.outerHTML)"""


@pytest.fixture(scope="module")
def held(shared: Robot) -> Robot:
    """A daemon whose skin is held still all the time."""
    scene = shared.folder / "held.toml"
    scene.write_text(HELD)
    shared.run()
    shared.plug(str(scene))
    return shared


STEP_S = 8  # of hold and motion: long enough to be seen on a busy host, which the page is asked once a second
FOUND = """async (unit) => {
  const { guideTuning } = await import("/static/tune.js");
  const per_hour = { low: 0, high: 1 }, told = { incipient: 0, gross: 0, contact_s: 5 };
  const of = { motion: told, quiet: told, per_hour, incipient_p: 0.7, gross_p: 0.3 };
  const proposed = { setting: "fast", is_accepted: true, friction: 0.62, friction_log_sd: 0.1 };
  const found = { ...of, proposed, accepted_per_hour: 10, toml: "", settings: { fast: of } };
  const post = async () => new Response(JSON.stringify({ ok: true, found }) + "\\n");
  const board = { info: null, geometry: { unit } };
  guideTuning({ root: document.querySelector(".board"), board }, post, () => {});
  document.querySelector(".tune .start").click();
}"""


def open_guide(page: Page, made: Robot) -> None:
    """Open the guide with the keyboard, with short times."""
    open_with_commands(page, made)
    page.locator(".tune > summary").press("Enter")
    for field in (".quiet-s", ".motion-s"):
        page.locator(f".tune {field}").fill(str(STEP_S))


def test_a_person_is_guided_to_a_setting_and_uses_it(held: Robot, page: Page, pictures: Path | None) -> None:
    open_guide(page, held)
    step = page.locator(".tune .step")
    page.locator(".tune .start").press("Enter")
    expect(step).to_have_text(f"Grip an object firmly and hold it still for {STEP_S} s after contact.")
    expect(page.locator(".tune .seconds")).to_have_text(re.compile(r"\d s"))
    expect(step).to_contain_text("Now move arm and gripper")
    expect(page.locator(".tune .verdict")).to_be_visible()
    expect(step).to_have_text("Proposed: fast")
    expect(page.locator(".tune .how-sure")).to_contain_text(f"0 slips reported in {STEP_S} s of motion")
    assert page.locator(".tune tbody td:first-child").all_inner_texts() == ["fast", "balanced", "quiet"]
    assert page.locator(".tune .toml").inner_text().startswith('[detect]\nsetting = "fast"')
    page.locator(".tune details summary").press("Enter")
    expect(page.locator(".tune .said")).to_contain_text("the rule of three")
    assert faults(page) == []
    if pictures is not None:
        (pictures / "web-tune.png").write_bytes(page.locator(".tune").screenshot())
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate(LOW) == []
    page.locator(".tune .use").press("Enter")
    expect(page.locator(".reply")).to_have_text("✓ Use fast now: done")
    expect(page.locator(".commands .setting")).to_have_value("0.7 0.3")


def test_a_run_is_cancelled_and_another_begins(held: Robot, page: Page) -> None:
    open_guide(page, held)
    start, cancel, step = (page.locator(f".tune .{name}") for name in ("start", "cancel", "step"))
    start.press("Enter")
    expect(step).to_contain_text("hold it still")
    expect(cancel).to_be_focused()
    page.keyboard.press("Enter")
    expect(step).to_contain_text("Cancelled")
    expect(start).to_be_focused()
    page.locator(".tune .motion-s").fill("1")
    start.press("Enter")
    expect(step).to_contain_text("--motion-s")  # the reason, in the words of the verb
    page.locator(".tune .motion-s").fill("5")
    expect(start).to_be_enabled()
    start.press("Enter")
    expect(step).to_contain_text("hold it still")


def test_friction_is_one_of_readings_for_arrays_of_another_unit_alone(held: Robot, page: Page) -> None:
    open_guide(page, held)
    for unit, words in (("V", "(shear over load, both as readings)"), ("N", "(shear over load)")):
        page.evaluate(FOUND, unit)
        expect(page.locator(".tune .how-sure")).to_contain_text(f"of this object: 0.62 {words}, ± 10 %.")

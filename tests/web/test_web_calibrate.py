"""`tactiled calibrate` in the page: a guided recording, the record of a force sensor, a calibration file."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from access import faults
from pages import Robot, open_with_commands
from playwright.sync_api import Page, expect

from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.force.calibration import load_calibration

pytestmark = pytest.mark.system
FORCES_N = (6, 14, 20, 9, 17, 11, 19, 8, 13, 20, 7, 16)
RECORD_S = 22
LOW = """() => [...document.querySelectorAll(".calibrate :is(button, input, summary)")]
  .filter((e) => e.checkVisibility() && e.getBoundingClientRect().height < 44).map((e) => e.outerHTML)"""


@pytest.fixture(scope="module")
def pressed(shared: Robot) -> Robot:
    """A daemon whose skin is pressed again and again, with other forces and at other speeds."""
    phases = ['{ kind = "rest", duration_s = 3.0 }']
    for k, force_n in enumerate(FORCES_N):
        phases += [
            f'{{ kind = "press", duration_s = {0.5 + 0.15 * (k % 5)}, force_n = {force_n}.0 }}',
            f'{{ kind = "hold", duration_s = {0.6 + 0.1 * (k % 3)} }}',
            '{ kind = "lift", duration_s = 0.4 }',
            f'{{ kind = "rest", duration_s = {0.7 + 0.2 * (k % 4)} }}',
        ]
    scene = shared.folder / "presses.toml"
    scene.write_text(f'name = "presses"\ncontact = "signal"\nphases = [{", ".join(phases)}]\n')
    shared.run()
    shared.plug(str(scene))
    return shared


def open_guide(page: Page, made: Robot) -> None:
    open_with_commands(page, made)
    page.locator(".calibrate > summary").press("Enter")


def force_sensor(made: Robot, path: Path) -> Path:
    """Record of a force sensor under the skin since the scene began, at 200 Hz, as the scene has it."""
    began_s = made.line("board", "scene")["t0_s"]
    now_s = time.monotonic()
    time_s = np.arange(began_s, now_s, 0.005)
    load_n = SceneMotion(load_scene(str(made.folder / "presses.toml"))).at(time_s - began_s).load_n
    rows = zip((time_s - now_s + time.time()).tolist(), load_n.tolist(), strict=True)
    path.write_text("time_s,fz_n\n" + "".join(f"{t:.4f},{n:.4f}\n" for t, n in rows))
    return path


def test_a_person_is_guided_to_a_calibration(pressed: Robot, page: Page, pictures: Path | None) -> None:
    open_guide(page, pressed)
    step, fit = page.locator(".calibrate .step"), page.locator(".calibrate .fit")
    page.locator(".calibrate .guide-s").fill(str(RECORD_S))
    page.locator(".calibrate .start").press("Enter")
    expect(step).to_have_text(re.compile(r"\d s\s+press.*now \d+ %"))
    expect(step).to_have_text(re.compile(r"\d{4} scans in \d\d s. The record lacks: .*Now choose the record"))
    expect(fit).to_be_disabled()
    page.locator(".calibrate .reference").set_input_files(force_sensor(pressed, pressed.folder / "ft.csv"))
    page.locator(".calibrate .name").fill("../mine")
    expect(fit).to_be_disabled()
    page.locator(".calibrate .name").fill("pad-3")
    page.locator(".calibrate .name").press("Tab")
    fit.press("Enter")
    expect(page.locator(".calibrate .verdict")).to_be_visible()
    expect(step).to_have_text("Calibration pad-3 of wang2019-3x3")
    known = page.locator(".calibrate .known li").all_inner_texts()
    assert any(words.startswith("normal force to ") for words in known)
    assert "shear x is not known: the reference has no fx_n" in known
    assert page.locator(".calibrate tbody td:first-child").all_inner_texts() == ["fz"]
    assert 'calibration = "pad-3.toml"' in page.locator(".calibrate .toml").inner_text()
    assert faults(page) == []
    if pictures is not None:
        (pictures / "web-calibrate.png").write_bytes(page.locator(".calibrate").screenshot())
    with page.expect_download() as started:
        page.locator(".calibrate .file").click()
    assert started.value.suggested_filename == "pad-3.toml"
    started.value.save_as(pressed.folder / "pad-3.toml")
    assert load_calibration(str(pressed.folder / "pad-3.toml")).array == "wang2019-3x3"
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate(LOW) == []


def test_a_record_that_does_not_fit_is_refused_with_the_reason(pressed: Robot, page: Page) -> None:
    open_guide(page, pressed)
    step = page.locator(".calibrate .step")
    page.locator(".calibrate .guide-s").fill("5")
    page.locator(".calibrate .start").press("Enter")
    expect(step).to_contain_text("Now choose the record")
    wrong = pressed.folder / "wrong.csv"
    wrong.write_text("t,force\n0,1\n")
    page.locator(".calibrate .reference").set_input_files(wrong)
    page.locator(".calibrate .fit").press("Enter")
    expect(step).to_contain_text("result: reference.csv: the header needs at least one of fx_n")
    expect(page.locator(".calibrate .verdict")).to_be_hidden()
    expect(page.locator(".calibrate .fit")).to_be_enabled()

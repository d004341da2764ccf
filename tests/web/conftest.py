"""One browser for the tests of a module: it takes seconds to start."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from pages import CHROMIUM, CHROMIUM_ARGUMENTS, NO_CHROMIUM, Robot, robot
from playwright.sync_api import Browser, Page, expect, sync_playwright

expect.set_options(timeout=60_000)  # a loaded machine takes that long to start a daemon


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip(NO_CHROMIUM)
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of 1280x800 in which every error of a script fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light")
    errors: list[str] = []
    opened = context.new_page()
    opened.set_default_timeout(60_000)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.on("console", lambda line: errors.append(line.text) if "Security Policy" in line.text else None)
    yield opened
    context.close()
    assert not errors


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with robot(tmp_path_factory.mktemp("robot")) as made:
        yield made


@pytest.fixture
def live(shared: Robot) -> Robot:
    """A daemon with an emulated board at rest, the same for all tests of a module that leave them so."""
    if not shared.is_running("daemon"):
        shared.run()
    if not shared.is_running("board"):
        shared.plug()
    return shared


@pytest.fixture(scope="module")
def pictures() -> Path | None:
    """Folder in which screenshots are kept, from TACTILED_PICTURES; None where nobody wants them."""
    named = os.environ.get("TACTILED_PICTURES")
    return None if named is None else Path(named)

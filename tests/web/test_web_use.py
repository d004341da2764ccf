"""Commands, other origins and recordings in a real browser."""

import csv
import functools
import http.server
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from commands import call
from pages import CONFIG, Robot, robot
from patience import PATIENCE_S
from playwright.sync_api import Page, expect
from recordings import record, simulated_reads

from tactiled.client import Commander, Message, Subscription

pytestmark = pytest.mark.system
TOKEN = "0123456789abcdef"


def commanding(live: Robot) -> str:
    """Serve a page that may give commands; return its address without the token."""
    token = live.folder / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    url = live.serve("--allow-commands", "--token-file", str(token))
    assert "token" not in url
    return url


def commands_of(subscription: Subscription, within_s: float, n: int = 1) -> list[dict[str, Any]]:
    """Commands that are heard within a time, or the first `n`."""
    until_s = time.monotonic() + within_s
    found: list[dict[str, Any]] = []
    while len(found) < n and (item := subscription.next_item(until_s)) is not None:
        if isinstance(item, Message) and item.topic == "command":
            found.append(item.data)
    return found


def test_buttons_show_the_acknowledgement_or_the_reason(live: Robot, page: Page) -> None:
    url = commanding(live)
    with Subscription(live.endpoint, topics=("command",)) as subscription:
        page.goto(f"{url}#token={TOKEN}")
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        assert TOKEN not in page.url  # not in the history, nor in a link that is copied
        page.locator(".mark-text").fill("first touch")
        page.get_by_role("button", name="Mark with note").click()
        expect(page.locator(".reply")).to_have_attribute("data-ok", "true")
        expect(page.locator(".events .list")).to_contain_text("mark: first touch")
        page.get_by_role("button", name="Inhibit").click()
        expect(page.locator(".reply")).to_contain_text("Inhibit 0.5 s: done")
        page.locator("input.speed").fill("5000")
        page.get_by_role("button", name="Speed").press("Enter")
        expect(page.locator(".reply")).to_contain_text("refused")
        expect(page.locator(".reply")).to_contain_text("1000")  # the limit, in the words of the daemon
        given = commands_of(subscription, PATIENCE_S, 2)
    assert [(row["command"], row["ok"]) for row in given] == [("mark", True), ("inhibit", True)]
    assert all(row["who"] == "web page" for row in given)


def test_buttons_show_the_state_of_the_daemon_after_a_reload(page: Page, tmp_path: Path) -> None:
    config = CONFIG.replace("[record]", '[record]\ndirectory = "{folder}/recordings"')
    with robot(tmp_path, config) as live:
        live.run()
        live.plug()
        page.goto(f"{commanding(live)}#token={TOKEN}")
        expect(page.locator(".commands .setting")).to_have_value("0.9 0.4")
        until_s = time.monotonic() + PATIENCE_S
        while page.locator(".reply").inner_text() != "✓ Set zero: done":  # half a second of scans is needed
            assert time.monotonic() < until_s
            with page.expect_response("**/api/command"):  # or a late reply would hide the next one
                page.get_by_role("button", name="Set zero").click()
            page.wait_for_timeout(500)
        page.locator(".commands .speed").fill("2.5")
        page.get_by_role("button", name="Speed").click()
        expect(page.locator(".reply")).to_have_text("✓ Speed: done")
        page.locator(".commands .setting").select_option("quiet")
        page.locator("[data-do=thresholds]").click()
        expect(page.locator(".reply")).to_have_text("✓ Set: done")
        page.reload()
        expect(page.locator(".commands .speed")).to_have_value("2.5")
        expect(page.locator(".commands .setting")).to_have_value("0.98 0.55")
        expect(page.get_by_role("button", name="Set zero")).to_have_attribute("aria-pressed", "true")
        with Commander(live.endpoint, "another client") as daemon:
            assert daemon.send("speed", timeout_s=PATIENCE_S, speed_mm_s=7.0).ok
            expect(page.locator(".commands .speed")).to_have_value("7")
            assert daemon.send("record", timeout_s=PATIENCE_S, on=True).ok
            expect(page.get_by_role("button", name="Stop recording")).to_be_visible()
        page.get_by_role("button", name="Stop recording").click()
        expect(page.get_by_role("button", name="Record", exact=True)).to_be_visible()


def test_a_mark_of_a_page_that_may_command_is_in_the_stream(live: Robot, page: Page) -> None:
    url = commanding(live)
    with Subscription(live.endpoint, topics=("command",)) as subscription:
        page.goto(f"{url}#token={TOKEN}")
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        page.locator(".mark-text").fill("=first, touch")
        page.locator("h1").click()
        page.keyboard.press("m")
        expect(page.locator(".events .list")).to_contain_text("mark: =first, touch")
        (given,) = commands_of(subscription, PATIENCE_S)
        assert given["command"] == "mark"
        page.wait_for_timeout(200)
        with page.expect_download() as download:
            page.get_by_role("button", name="CSV").click()
        rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    assert [row["mark"] for row in rows if row["mark"]] == ["'=first, touch"]  # no formula


@pytest.mark.parametrize("fragment", ["", "#token=0123456789abcdeX"])
def test_without_the_token_there_are_no_buttons(live: Robot, page: Page, fragment: str) -> None:
    page.goto(commanding(live) + fragment)
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
    assert not page.locator(".commands").is_visible()
    status = page.evaluate(
        "fetch('/api/command', {method: 'POST', headers: {'Content-Type': 'application/json'},"
        " body: JSON.stringify({do: 'mark', fields: {text: 'x'}})}).then(r => r.status)"
    )
    assert status == 403


@contextmanager
def other_origin(folder: Path) -> Iterator[str]:
    """A server of somebody else on the same host."""
    (folder / "index.html").write_text("<!doctype html><title>other</title>")
    handler = functools.partial(QuietHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


ATTACKS = """async ([url, token]) => {
  const body = JSON.stringify({do: 'mark', fields: {text: 'from elsewhere'}}), results = [];
  const tries = [
    {method: 'POST', body},
    {method: 'POST', body, mode: 'no-cors'},
    {method: 'POST', body, headers: {'Content-Type': 'application/json', Authorization: `Bearer ${token}`}},
    {method: 'POST', body, headers: {'Content-Type': 'application/json'}, credentials: 'include'},
  ];
  for (const options of tries) {
    try { results.push((await fetch(url + 'api/command', options)).status); }
    catch { results.push('blocked'); }
  }
  results.push(await new Promise((done) => {
    const socket = new WebSocket(url.replace('http', 'ws') + 'api/live');
    socket.onmessage = () => done('read');
    socket.onerror = () => done('blocked');
  }));
  return results;
}"""


def test_a_page_of_another_origin_cannot_command_or_read_even_with_the_token(
    live: Robot, page: Page, tmp_path: Path
) -> None:
    url = commanding(live)
    (tmp_path / "other").mkdir()
    with (
        Subscription(live.endpoint, topics=("command",)) as subscription,
        other_origin(tmp_path / "other") as other,
    ):
        page.goto(f"{url}#token={TOKEN}")
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        page.goto(other)
        assert page.evaluate(ATTACKS, [url, TOKEN]) == ["blocked"] * 5
        assert commands_of(subscription, 1.0) == []


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "demo.mcap"
    record(path, simulated_reads(12.0, "demo"))
    return path


def test_a_recording_plays_seeks_and_has_links_to_instants(
    recording: Path, page: Page, tmp_path: Path
) -> None:
    with robot(tmp_path) as made:
        url = made.serve("--file", str(recording), events=False)
        page.goto(url)
        expect(page.locator(".lamp")).to_have_attribute("data-state", "replay")
        assert page.locator(".lamp .word").inner_text() == "REPLAY"
        page.locator("#speed").select_option("10")
        page.locator("#play").click()
        expect(page.locator("li[data-topic=slip]").first).to_be_visible()
        expect(page.locator("#play")).to_have_attribute("aria-label", "Play")  # it has ended
        page.locator("body").press("Home")
        expect(page.locator("li[data-topic=slip]")).to_have_count(0)
        page.locator("body").press("ArrowRight")
        expect(page.locator("#clock")).to_contain_text("1.00 /")
        page.locator("#copy").click()
        expect(page.locator("#copy")).not_to_have_text("Copy link")
        assert page.url.endswith("#at=1.000")
        page.goto(f"{url}#at=2.5")
        expect(page.locator("#clock")).to_contain_text("2.50 /")
        page.locator(".events .list").focus()
        page.keyboard.press("End")  # scrolls the list, and leaves the recording where it is
        expect(page.locator("#clock")).to_contain_text("2.50 /")
        assert page.evaluate("fetch('/api/replay?from=0&to=1e9').then(r => r.status)") == 400


DELAYED = """const prompt = window.fetch;
window.fetch = async (url, ...options) => {
  if (String(url).startsWith("/api/replay")) await new Promise((done) => setTimeout(done, 1500));
  return prompt(url, ...options);
};"""


def test_playback_waits_for_what_a_slow_server_has_not_sent(
    recording: Path, page: Page, tmp_path: Path
) -> None:
    page.add_init_script(DELAYED)
    with robot(tmp_path) as made:
        page.goto(made.serve("--file", str(recording), events=False))
        expect(page.locator(".lamp")).to_have_attribute("data-state", "replay")
        page.locator("#speed").select_option("10")
        page.locator("#play").click()
        expect(page.locator("#play")).to_have_attribute("aria-label", "Pause")
        expect(page.locator("#play")).to_have_attribute("aria-label", "Play")  # it has ended
        expect(page.locator("li[data-topic=slip]").first).to_be_visible(timeout=1000)


def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    assert call("web", "--file", str(tmp_path / "no.mcap"), "--port", "0") == 2
    said = capsys.readouterr().err
    assert said.splitlines()[-1].startswith("tactiled: ")
    assert "Traceback" not in said

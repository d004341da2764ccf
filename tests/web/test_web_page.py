"""The page in a real browser, with a real daemon and an emulated board."""

import json
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import Robot, robot
from patience import PATIENCE_S
from playwright.sync_api import Page, WebSocketRoute, expect
from slow_link import slow_link
from stage import stage

from tactiled.client import Message, Subscription

pytestmark = pytest.mark.system


def open_page(page: Page, url: str) -> None:
    page.goto(url)
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")


def until_unknown(page: Page, numbers: str) -> None:
    """Wait until none of these has a number; the lamp may be drawn before them."""
    n = page.locator(numbers).count()
    assert n > 0
    expect(page.locator(numbers)).to_have_text(["–"] * n)


def messages(subscription: Subscription, topic: str, until_s: float) -> list[dict[str, Any]]:
    """Messages of a topic that have arrived or arrive until then."""
    found = []
    while (item := subscription.next_item(until_s)) is not None:
        if isinstance(item, Message) and item.topic == topic:
            found.append(item.data)
    return found


def test_the_lamp_follows_the_board(live: Robot, page: Page) -> None:
    open_page(page, live.serve())
    expect(page.locator(".lamp[data-state=fresh] .word")).to_have_text("FRESH")  # a busy host makes it late
    live.stop("board")
    expect(page.locator(".lamp")).to_have_attribute("data-state", "none")
    expect(page.locator(".lamp .advice")).to_contain_text("no such port", ignore_case=True)
    until_unknown(page, ".loads dd")
    live.plug()
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")


def test_the_page_counts_the_frames_it_took_and_follows_an_upgrade(
    live: Robot, page: Page, tmp_path: Path
) -> None:
    with stage(tmp_path, ("TS0001", "demo", 5.0), then="hold") as endpoint:
        answers, ways = list[str | bytes](), list[WebSocketRoute]()

        def meet(way: WebSocketRoute) -> None:
            server = way.connect_to_server()
            ways.append(way)
            answers.clear()

            def to_server(message: str | bytes) -> None:
                answers.append(message)
                server.send(message)

            way.on_message(to_server)

        page.route_web_socket("**/api/live", meet)
        page.goto(live.serve("--events", endpoint, events=False))
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        while len(answers) < 8:
            page.wait_for_timeout(50)
        assert answers[:8] == [str(2 * n) for n in range(8)]  # the history, a frame too, is not counted
        page.evaluate("window.before = true")
        ways[-1].close()  # the same page: it connects again and counts anew
        while len(ways) < 2 or len(answers) < 2:
            page.wait_for_timeout(50)
        assert answers[:2] == ["0", "2"]
        assert page.evaluate("window.before") is True
        session = json.loads(page.request.get(page.url + "api/session").text())
        page.route("**/api/session*", lambda route: route.fulfill(json={**session, "page": "another"}))
        with page.expect_event("load"):
            ways[-1].close()
        assert page.evaluate("window.before") is None
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")


def test_silence_is_stale_and_a_new_daemon_is_found_again(live: Robot, page: Page) -> None:
    open_page(page, live.serve())
    live.stop("daemon")
    expect(page.locator(".lamp")).to_have_attribute("data-state", "stale")
    expect(page.locator(".lamp .advice")).to_contain_text("is tactiled running")
    until_unknown(page, ".loads dd, .margin dd, .used")
    expect(page.locator(".grooves .texture")).to_have_text("Unknown.")
    age_s = page.locator(".lamp .age").inner_text()
    expect(page.locator(".lamp .age")).not_to_have_text(age_s)  # the age grows without any message
    live.run()
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
    expect(page.locator(".events .list")).to_contain_text("the daemon was restarted")


def test_a_page_finds_its_server_again(live: Robot, page: Page) -> None:
    url = live.serve("--array", "wang2019-3x3")
    open_page(page, url)
    live.stop("web")
    expect(page.locator(".lamp")).to_have_attribute("data-state", "stale")
    expect(page.locator(".lamp .advice")).to_contain_text("No connection")
    live.start("web", "web", "--port", url.rstrip("/").rsplit(":", 1)[1], "--events", live.endpoint)
    expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")


def test_numbers_on_the_page_equal_the_messages(live: Robot, page: Page) -> None:
    open_page(page, live.serve())
    page.locator(".readings summary").click()
    expect(page.locator(".readings tbody tr")).to_have_count(36)
    with Subscription(live.endpoint) as subscription:
        heard: dict[str, list[dict[str, Any]]] = {"scan": [], "status": []}

        def until_heard(topic: str, key: str, number: int) -> None:
            until_s = time.monotonic() + PATIENCE_S
            while not any(row[key] >= number for row in heard[topic]):
                item = subscription.next_item(until_s)
                assert item is not None, f"no {topic} {number}"
                if isinstance(item, Message) and item.topic in heard:
                    heard[item.topic].append(item.data)

        until_heard("scan", "index", 0)
        until_heard("status", "seq", 0)
        first = heard["scan"][0]["index"], heard["status"][0]["seq"]
        page.wait_for_function(  # what it shows was heard, too
            "([scan, status]) => Number(document.querySelector('.readings table').dataset.index) > scan"
            " && Number(document.querySelector('.strip').dataset.seq) > status",
            arg=first,
        )
        table = page.evaluate("({...document.querySelector('.readings table').dataset})")
        cells = page.locator(".readings tbody tr td:nth-child(2)").all_inner_texts()
        sequence, strip = page.evaluate(
            "[Number(document.querySelector('.strip').dataset.seq),"
            " [...document.querySelectorAll('.fact')].map(f => [f.dataset.key, f.dataset.value])]"
        )
        until_heard("scan", "index", int(table["index"]))
        until_heard("status", "seq", sequence)
        scans, statuses = heard["scan"], heard["status"]
    (scan,) = [row for row in scans if row["index"] == int(table["index"])]
    assert json.loads(table["values"]) == np.float32(scan["volts"]).tolist()
    assert len(cells) == len(scan["volts"])
    (status,) = [row for row in statuses if row["seq"] == sequence]
    shown = dict(strip)
    assert float(shown["rate_hz"]) == status["rate_hz"]
    assert int(shown["frames_corrupt"]) == status["frames_corrupt"]


def test_every_slip_message_is_on_the_page(live: Robot, page: Page) -> None:
    open_page(page, live.serve())
    live.stop("board")
    with Subscription(live.endpoint, topics=("slip",)) as subscription:
        live.plug("prescribed")
        expect(page.locator("li[data-topic=slip]").first).to_be_visible()
        page.wait_for_timeout(3000)  # for those that may follow
        shown = page.locator("li[data-topic=slip]").evaluate_all(
            "rows => rows.map(r => Number(r.dataset.seq))"
        )
        published = [row["seq"] for row in messages(subscription, "slip", time.monotonic() + 2.0)]
    live.stop("board")  # the next one is at rest
    assert set(shown) <= set(published)
    assert set(published[:1]) <= set(shown)


@pytest.mark.alone
def test_a_slow_link_shows_fresh_data(page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, ExitStack() as stack:
        made.endpoint = f"ipc://{tmp_path}/stage.ipc"
        slow = stack.enter_context(slow_link(made.serve(), bytes_s=50_000))
        page.goto(slow.url)
        expect(page.locator("#link-words")).to_have_text("page connected")
        # From now on, not from before the server and the page were there: its pause is of no board.
        stack.enter_context(stage(tmp_path, ("TS0001", "demo", 12.0)))
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        page.wait_for_timeout(3000)  # its first seconds have come
        received, began_s = slow.received, time.monotonic()
        states = []
        while time.monotonic() < began_s + 5.0:
            page.wait_for_timeout(200)
            states.append(page.locator(".lamp").get_attribute("data-state"))
        kb_s = (slow.received - received) / (time.monotonic() - began_s) / 1e3
        assert 1.0 < kb_s < 25.0
        assert states.count("fresh") > 0.8 * len(states)  # this host may be loaded
        page.goto("about:blank")

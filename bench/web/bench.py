"""Cost of the live page in a real browser, and how late its sentence is.

Real processes: an emulated board, the daemon, `tactiled web`, and Chromium without a graphics card. The
demo is played as `tactiled demo --web` plays it, with its pauses without a board; then `stick-slip`, for more
verdicts in a minute; at last the demo over a slow link. A thread of this process subscribes to the daemon as
the server does, so that the delay of a verdict is from the arrival of its message at a subscriber to the
first picture of the browser that has its words.
"""

import contextlib
import json
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from bench.processes import START_S, TACTILED, cpu_s, daemon_config, next_line, running, wait_for_path
from bench.report import Aim, BenchOptions, aim, aims_table, at_most, load_words, table
from bench.web.link import Link, link
from tactiled.array import FloatArray
from tactiled.client import Message, Subscription
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

CHROMIUM = shutil.which("chromium")
CHROMIUM_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SLOW_BYTES_S = 50_000
_PLAY_S, _QUICK_PLAY_S = 60.0, 15.0
_REST_S = 8.0  # without a board between two plays, as `tactiled demo --web`
_SETTLE_S = 5.0  # after the start of the page: its history has come and its scripts are compiled
# The page itself notes what is watched, five times a second and for each new row: questions from outside
# would take a tenth of what the page takes.
_WATCH = """
  window.shifts = []; window.shown = {}; window.lamps = [];
  new PerformanceObserver((list) => { for (const entry of list.getEntries()) shifts.push(entry.value); })
    .observe({ type: "layout-shift", buffered: true });
  setInterval(() => { lamps.push(document.querySelector(".lamp")?.dataset.state); }, 200);
  const look = (changes) => {
    for (const { addedNodes } of changes) for (const { dataset } of addedNodes) {
      const key = dataset?.seq === undefined ? undefined : `${dataset.topic}/${dataset.seq}`;
      if (key === undefined || key in shown) continue;
      shown[key] = 0;
      requestAnimationFrame(() => { shown[key] = Date.now() / 1000; }); // the picture with it is made
    }
  };
  document.addEventListener("DOMContentLoaded", () => new MutationObserver(look)
    .observe(document, { subtree: true, childList: true }));
"""


@dataclass(frozen=True)
class PageCost:
    """Bytes, movement, delay and processor time of one page while a scene was played."""

    kb_s: float  # bytes that the browser received, 10^3 in a second
    shift: float  # cumulative layout shift
    # page_part, browser_part, server_part: processor time over time: of the renderer process of the page, of
    # all processes of the browser, and of `tactiled web`
    page_part: float
    browser_part: float
    server_part: float
    fresh_part: float  # part of the looks at the lamp at which it was FRESH, of those with a board
    delay_s: FloatArray  # (verdicts,): from the message of a contact or a slip to the picture with its words
    unseen: int  # messages of contacts and slips that never were on the page

    def quantile_ms(self, q: float) -> float:
        """Quantile of the delay in milliseconds."""
        return 1e3 * float(np.quantile(self.delay_s, q)) if self.delay_s.size else float("nan")


def bench_web(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Measure the page in Chromium."""
    if CHROMIUM is None:
        raise OperatorError("bench web needs chromium: sudo apt install chromium")
    seconds = _QUICK_PLAY_S if options.quick else _PLAY_S
    parts = {"demo": ("demo", float("inf")), "stick-slip": ("stick-slip", float("inf")),
             f"demo, link of {SLOW_BYTES_S / 1e3:g} kB/s": ("demo", SLOW_BYTES_S)}  # fmt: skip
    found: dict[str, PageCost] = {}
    with sync_playwright() as playwright:
        for n, (name, (scene, bytes_s)) in enumerate(parts.items()):
            progress.reach(n / len(parts))
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_ARGUMENTS)
            found[name] = watch_scene(browser, scene, seconds, bytes_s)
            browser.close()
    text = (
        f"{seconds:g} s of each; 36 channels at 100 Hz; {load_words()}, all processes of "
        f"the measurement included; Chromium {browser.version} without a graphics card, 1280 x 800."
    )
    return [text, cost_table(found), aims_table(aims(*found.values()))]


def watch_scene(browser: Browser, scene: str, seconds: float, bytes_s: float) -> PageCost:
    """Play a scene again and again, and watch it in the page for some seconds."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tactiled-web-")))
        endpoint = f"ipc://{folder}/events.ipc"
        config = daemon_config(folder / "tactiled.toml", folder / "board", endpoint)
        stack.enter_context(_beside(partial(_play, folder / "board", scene)))
        wait_for_path(folder / "board")
        stack.enter_context(running(*TACTILED, "run", "--config", config))
        server = stack.enter_context(running(*TACTILED, "web", "--port", "0", "--events", endpoint))
        heard: dict[str, float] = {}
        stack.enter_context(_beside(partial(_hear, endpoint, heard)))
        way = stack.enter_context(link(json.loads(next_line(server))["url"], bytes_s))
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.add_init_script(_WATCH)
        page.goto(way.url)
        page.locator(".lamp[data-state=fresh]").wait_for(timeout=1e3 * START_S)
        page.wait_for_timeout(1e3 * _SETTLE_S)
        return _watch(browser, page, way, server.pid, heard, seconds)


def _watch(
    browser: Browser, page: Page, way: Link, server: int, heard: Mapping[str, float], seconds: float
) -> PageCost:
    page.evaluate("shifts.length = lamps.length = 0")
    received, began_s, before = way.received, time.time(), _cpu(browser, server)
    page.wait_for_timeout(1e3 * seconds)
    lasted_s = time.time() - began_s
    parts = {name: (used - before[name]) / lasted_s for name, used in _cpu(browser, server).items()}
    kb_s = (way.received - received) / lasted_s / 1e3
    due = {key: at_s for key, at_s in heard.items() if began_s < at_s < began_s + lasted_s - 1.0}
    shown: dict[str, float] = page.evaluate("shown")
    with_board = [state for state in page.evaluate("lamps") if state != "none"]
    return PageCost(
        kb_s=kb_s, shift=sum(page.evaluate("shifts")), page_part=parts["page"],
        browser_part=parts["browser"], server_part=parts["server"],
        fresh_part=with_board.count("fresh") / max(1, len(with_board)),
        delay_s=np.array([shown[key] - at_s for key, at_s in due.items() if key in shown]),
        unseen=sum(key not in shown for key in due),
    )  # fmt: skip


def _cpu(browser: Browser, server: int) -> dict[str, float]:
    """Processor time in seconds."""
    session = browser.new_browser_cdp_session()
    processes: list[dict[str, Any]] = session.send("SystemInfo.getProcessInfo")["processInfo"]
    session.detach()
    page_s = sum(one["cpuTime"] for one in processes if one["type"] == "renderer")
    return {"page": page_s, "browser": sum(one["cpuTime"] for one in processes), "server": cpu_s(server)}


@contextmanager
def _beside(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run a function in a thread; at the end of the block its event is set."""
    ended = threading.Event()
    thread = threading.Thread(target=work, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _play(link_path: Path, scene: str, ended: threading.Event) -> None:
    """Play a scene again and again, with pauses without a board."""
    while not ended.is_set():
        link_path.unlink(missing_ok=True)
        with running(*TACTILED, "emulate", "--scene", scene, "--link", link_path):
            with contextlib.suppress(OperatorError):  # the next one may do better
                wait_for_path(link_path)
            ended.wait(load_scene(scene).duration_s)
        ended.wait(_REST_S)


def _hear(endpoint: str, heard: dict[str, float], ended: threading.Event) -> None:
    """Note when the messages of contacts and slips arrive, epoch seconds by topic and number."""
    with Subscription(endpoint, topics=("contact", "slip")) as subscription:
        while not ended.is_set():
            item = subscription.next_item(time.monotonic() + 0.2)
            if isinstance(item, Message):
                heard[f"{item.topic}/{item.data['seq']}"] = time.time()


def cost_table(costs: Mapping[str, PageCost]) -> str:
    """Table with a row for each part."""
    return table(
        {
            "scene": name,
            "to the browser": f"{cost.kb_s:.1f} kB/s",
            "layout shift": f"{cost.shift:.3f}",
            "page": f"{100 * cost.page_part:.1f} %",
            "all of Chromium": f"{100 * cost.browser_part:.1f} %",
            "server": f"{100 * cost.server_part:.1f} %",
            "lamp FRESH": f"{100 * cost.fresh_part:.0f} %",
            "verdict p50 / p99": f"{cost.quantile_ms(0.5):.0f} / {cost.quantile_ms(0.99):.0f} ms",
            "verdicts": f"{cost.delay_s.size}, {cost.unseen} never shown",
        }
        for name, cost in costs.items()
    )


def aims(demo: PageCost, verdicts: PageCost, slow: PageCost) -> list[Aim]:
    """Judge what was measured in the demo, in a scene of many verdicts, and over a slow link."""
    never_s = np.full(demo.unseen + verdicts.unseen, np.inf)
    delay_s = np.concatenate([demo.delay_s, verdicts.delay_s, never_s])
    # Not interpolated: between a number and infinity there is none.
    delay_ms = 1e3 * float(np.quantile(delay_s, 0.99, method="higher")) if delay_s.size else float("nan")
    fresh = f"{100 * slow.fresh_part:.0f} %"
    return [
        at_most("bytes to one browser, demo", 25.0, demo.kb_s, ".1f", " kB/s"),
        at_most("cumulative layout shift, demo", 0.05, demo.shift, ".3f"),
        at_most("verdict after its message, 99 %", 100.0, delay_ms, ".0f", " ms"),
        at_most("processor of the page, demo", 15.0, 100 * demo.page_part, ".1f", " %"),
        at_most("processor of the server, demo", 3.0, 100 * demo.server_part, ".1f", " %"),
        aim("lamp FRESH over a slow link", "at least 95 %", fresh, slow.fresh_part >= 0.95),
    ]

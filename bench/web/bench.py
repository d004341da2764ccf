"""Delays of the live page in a browser, and what server and page cost.

Real processes: an emulated board, the daemon, `tactiled web`, and Chromium without a graphics card. Every
instant is of one clock: the page notes `Date.now()` when the lamp or an event changes, and this host's wall
clock says when the board was unplugged or the slip published.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.report import Aim, BenchOptions, BenchReport, Reading, aims_table, at_most, judge, table
from tactiled.client import Message, Subscription
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

SCENE = "stick-slip"  # slips again and again
_START_S = 60.0
_TICKS_HZ = os.sysconf("SC_CLK_TCK")
_CLIENTS = (1, 10, 50)
_GROWTH_MB_HOUR = 2.0  # "no growth" within what a garbage collector leaves to chance in ten minutes
_GROWTH = f"at most {_GROWTH_MB_HOUR:g} MB an hour"
_LEAST_WATCHED_S = 300.0  # a shorter time says nothing on growth
_CHROMIUM = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-precise-memory-info", "--js-flags=--expose-gc",
]  # fmt: skip
_CONFIG = """\
[port]
url = "{folder}/board"
[publish]
endpoints = ["ipc://{folder}/events.ipc"]
"""
# Notes in the page: when the lamp changed, and when each slip event appeared.
_WATCH = """
() => {
  window.noted = {lamp: [], slips: {}};
  new MutationObserver((changes) => { for (const c of changes)
    noted.lamp.push([Date.now() / 1000, c.target.dataset.state]); })
    .observe(document.querySelector('.lamp'), {attributes: true, attributeFilter: ['data-state']});
  new MutationObserver(() => { for (const row of document.querySelectorAll('li[data-topic=slip]'))
    noted.slips[row.dataset.seq] ??= Date.now() / 1000; })
    .observe(document.querySelector('.events .list'), {childList: true});
}
"""


@dataclass(frozen=True)
class PageMeasures:
    """Measurements of one run.

    Attributes
    ----------
    lamp_s : sequence of float
        From the unplug to the lamp that is not FRESH.
    slip_s : sequence of float
        From the publication of a slip to its line on the page.
    server_part : dict of int to float
        Processor time of the server over time, by number of clients.
    page_part, tab_part : float
        Processor time over time: of the page's process, and of all processes of the browser.
    heap_mb : sequence of float
        Memory of the page's scripts after garbage collection, at equal intervals.
    server_mb : sequence of float
        Resident memory of the server at the same instants.
    watched_s : float
        Time over which memory was watched.
    """

    lamp_s: Sequence[float]
    slip_s: Sequence[float]
    server_part: dict[int, float]
    page_part: float
    tab_part: float
    pictures_per_s: float
    heap_mb: Sequence[float]
    server_mb: Sequence[float]
    watched_s: float

    @property
    def lamp_ms(self) -> float:
        """Longest time from an unplug to the lamp, milliseconds."""
        return 1e3 * max(self.lamp_s, default=float("inf"))

    @property
    def slip_ms(self) -> float:
        """Longest time from a slip message to its line on the page, milliseconds."""
        return 1e3 * max(self.slip_s, default=float("inf"))

    @property
    def per_client(self) -> float:
        """Processor time of the server that one more client costs, over time."""
        least, most = min(self.server_part), max(self.server_part)
        return (self.server_part[most] - self.server_part[least]) / (most - least)

    def growth(self, values_mb: Sequence[float]) -> Reading:
        """Judge the slope of a memory, without the first third, in which the minute of history fills."""
        kept = np.array(values_mb[len(values_mb) // 3 :])
        hours = np.linspace(0.0, self.watched_s / 3600 * len(kept) / len(values_mb), len(kept))
        slope = float(np.polyfit(hours, kept, 1)[0])
        words = f"{slope:.1f} MB an hour ({kept[0]:.1f} to {kept[-1]:.1f} MB)"
        return judge(words, slope <= _GROWTH_MB_HOUR, is_open=self.watched_s < _LEAST_WATCHED_S)


AIMS: tuple[Aim[PageMeasures], ...] = (
    at_most("lamp after an unplug, largest", 500.0, " ms", lambda m: m.lamp_ms, ".0f"),
    at_most("slip on the page after its message, largest", 200.0, " ms", lambda m: m.slip_ms, ".0f"),
    at_most("server, one client", 5.0, " % of a core", lambda m: 100 * m.server_part[1], ".1f"),
    at_most("server, each further client", 5.0, " % of a core", lambda m: 100 * m.per_client, ".2f"),
    at_most("page (its renderer process)", 33.3, " % of a core", lambda m: 100 * m.page_part, ".0f"),
    at_most("interval of pictures", 1000 / 29, " ms", lambda m: 1e3 / m.pictures_per_s, ".1f"),
    Aim("growth of the page", _GROWTH, lambda m: m.growth(m.heap_mb)),
    Aim("growth of the server", _GROWTH, lambda m: m.growth(m.server_mb)),
)  # fmt: skip


class _Programs:
    """Processes of tactiled in one folder."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.endpoint = f"ipc://{folder}/events.ipc"
        self._stack = stack
        (folder / "tactiled.toml").write_text(_CONFIG.format(folder=folder))

    def start(self, name: str, *arguments: str) -> "subprocess.Popen[bytes]":
        with (
            (self.folder / f"{name}.out").open("wb") as out,
            (self.folder / f"{name}.err").open("wb") as words,
        ):
            process = subprocess.Popen(
                [sys.executable, "-m", "tactiled", *arguments], stdout=out, stderr=words
            )
        self._stack.callback(_end, process)
        return process

    def run(self) -> None:
        self.start("daemon", "run", "--config", str(self.folder / "tactiled.toml"))

    def plug(self) -> "subprocess.Popen[bytes]":
        (self.folder / "board").unlink(missing_ok=True)
        return self.start("board", "emulate", "--scene", SCENE, "--link", str(self.folder / "board"))

    def serve(self) -> tuple["subprocess.Popen[bytes]", str]:
        server = self.start("web", "web", "--port", "0", "--events", self.endpoint)
        until_s = time.monotonic() + _START_S
        while time.monotonic() < until_s:
            with suppress(ValueError, IndexError):
                return server, str(json.loads((self.folder / "web.out").read_text().splitlines()[0])["url"])
            time.sleep(0.1)
        raise OperatorError(f"tactiled web did not start: {(self.folder / 'web.err').read_text()}")


def _end(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(5)
    if process.poll() is None:
        process.kill()
        process.wait()


def cpu_s(pid: int) -> float:
    """Processor time of a process so far, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_HZ


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _browser_processes(profile: str) -> dict[int, str]:
    """Processes of the browser with this profile: number and kind."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().decode(errors="replace").replace("\0", " ")
            if profile in words:
                kind = next((word[7:] for word in words.split() if word.startswith("--type=")), "browser")
                found[int(path.parent.name)] = kind
    return found


def bench_web(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Measure the page; `quick` takes fewer unplugs and watches memory for a minute instead of ten."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise OperatorError("bench web drives a browser: sudo apt install chromium")
    unplugs, watched_s = (2, 60.0) if options.quick else (8, 600.0)
    progress.begin(unplugs + len(_CLIENTS) + 12)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tactiled-web-")))
        measured = _measure(_Programs(folder, stack), stack, chromium, unplugs, watched_s, progress)
    rows = [
        {"clients": f"{n}", "server (% of a core)": f"{100 * part:.1f}"}
        for n, part in measured.server_part.items()
    ]
    about = (
        f"Scene {SCENE}, 36 channels at 100 Hz, grip messages on. {len(measured.lamp_s)} unplugs, "
        f"{len(measured.slip_s)} slips; memory watched for {measured.watched_s:.0f} s. All processes of "
        f"Chromium, which draws without a graphics card: {100 * measured.tab_part:.0f} % of a core. Load of "
        f"this host at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors."
    )
    return BenchReport((about, table(rows), aims_table(AIMS, {"measured": measured})), measured)


def _measure(
    programs: _Programs,
    stack: ExitStack,
    chromium: str,
    unplugs: int,
    watched_s: float,
    progress: ProgressBar,
) -> PageMeasures:
    from playwright.sync_api import sync_playwright

    programs.run()
    board = programs.plug()
    server, url = programs.serve()
    server_part = {}
    for n in _CLIENTS:
        with _clients(url, n):
            server_part[n] = _part([server.pid], 8.0)
        progress.advance(f"{n} clients")
    profile = str(programs.folder / "profile")
    playwright = stack.enter_context(sync_playwright())
    context = playwright.chromium.launch_persistent_context(
        profile, executable_path=chromium, args=_CHROMIUM, viewport={"width": 1280, "height": 800}
    )
    stack.callback(context.close)
    page = context.pages[0]
    page.goto(url)
    page.wait_for_selector('.lamp[data-state="fresh"]', timeout=1000 * _START_S)
    page.evaluate(_WATCH)
    published: dict[int, float] = {}
    with Subscription(programs.endpoint, topics=("slip",)) as subscription:

        def wait(seconds: float) -> None:
            """Note when slips are received here, which is when the server receives them."""
            until_s = time.monotonic() + seconds
            while (item := subscription.next_item(until_s)) is not None:
                if isinstance(item, Message) and item.topic == "slip":
                    published[item.seq] = time.time() - (time.monotonic() - item.received_s)

        wait(5.0)
        processes = _browser_processes(profile)
        renderers = [pid for pid, kind in processes.items() if kind == "renderer"]
        began = {pid: cpu_s(pid) for pid in processes}
        heap_mb, server_mb, began_s = [], [], time.monotonic()
        for _ in range(12):
            wait(watched_s / 12)
            heap_mb.append(page.evaluate("(window.gc && gc(), performance.memory.usedJSHeapSize / 1e6)"))
            server_mb.append(_resident_mb(server.pid))
            progress.advance("memory")
        took_s = time.monotonic() - began_s
        used = {pid: (cpu_s(pid) - began[pid]) / took_s for pid in processes if Path(f"/proc/{pid}").exists()}
        pictures_per_s = float(page.evaluate("document.documentElement.dataset.fps"))
        lamp_s = []
        for _ in range(unplugs):
            at_s = time.time()
            _end(board)
            page.wait_for_selector('.lamp:not([data-state="fresh"])', timeout=1000 * _START_S)
            page.wait_for_timeout(50)
            changes = page.evaluate("noted.lamp")
            lamp_s.append(min(t for t, state in changes if t > at_s and state != "fresh") - at_s)
            board = programs.plug()
            page.wait_for_selector('.lamp[data-state="fresh"]', timeout=1000 * _START_S)
            progress.advance("unplug")
        wait(3.0)
        seen: dict[str, float] = page.evaluate("noted.slips")
    slip_s = [at_s - published[int(seq)] for seq, at_s in seen.items() if int(seq) in published]
    return PageMeasures(
        lamp_s=lamp_s,
        slip_s=slip_s,
        server_part=server_part,
        page_part=max((used[pid] for pid in renderers if pid in used), default=float("nan")),
        tab_part=sum(used.values()),
        pictures_per_s=pictures_per_s,
        heap_mb=heap_mb,
        server_mb=server_mb,
        watched_s=watched_s,
    )


def _part(pids: Sequence[int], seconds: float) -> float:
    """Processor time of processes over time, measured for so long."""
    before, began_s = sum(map(cpu_s, pids)), time.monotonic()
    time.sleep(seconds)
    return (sum(map(cpu_s, pids)) - before) / (time.monotonic() - began_s)


@contextmanager
def _clients(url: str, number: int) -> Iterator[None]:
    """So many clients in a process of their own, which read every frame."""
    script = Path(__file__).with_name("visitors.py")
    with subprocess.Popen([sys.executable, str(script), url, str(number)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None  # asked for above
        process.stdout.readline()
        try:
            yield
        finally:
            process.kill()

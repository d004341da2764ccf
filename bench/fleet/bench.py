"""Losses, delays and bytes of a fleet that is read through two routers of zenoh on one machine.

Real processes: a daemon of many simulated boards (its sockets, store and requests are the real ones), the
bridge `tactiled zenoh`, a subscriber through zenoh and one directly over ZeroMQ. The routers run in this
process, and the line between them can be cut in two ways: its connections are closed, or they stay and carry
nothing.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.boards.writer import serial_of
from bench.fleet.routers import TwoRouters, two_routers
from bench.report import Aim, BenchOptions, BenchReport, Reading, aims_table, at_most, judge, table
from tactiled.array import FloatArray
from tactiled.client.over_zenoh import states
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

_BOARDS, _QUICK_BOARDS = 100, 20
_CUTS_S, _QUICK_CUTS_S = (1.0, 5.0, 20.0, 60.0), (1.0, 5.0)
_SLIPS_HZ = 0.5  # onsets and ends of each board: a slip every four seconds
_DELAY_S, _QUICK_DELAY_S = 20.0, 6.0
_BYTES_S, _QUICK_BYTES_S = 10.0, 4.0
_SCANNING = 4  # boards of which every scan crosses the line; more would measure the processor
_SETTLE_S = 3.0
_RECOVERY_S = 6.0  # from the mending of the line to the next cut
_HOST = "bench"
_REAL = 2  # boards whose frames a daemon of its own decodes; more would measure the processor


@dataclass(frozen=True)
class Cut:
    """A cut of the line between the routers, and what became of the slips of its time.

    Attributes
    ----------
    how : str
        ``closed`` or ``silent``.
    sent, recovered, lost : int
        Slip messages of all boards from 1 s before the cut to the next one.
    fresh_after_s, complete_after_s : float
        From the mending to `Fresh`, and to the last recovered message.
    """

    how: str
    duration_s: float
    sent: int
    recovered: int
    lost: int
    fresh_after_s: float
    complete_after_s: float


@dataclass(frozen=True)
class Profile:
    """Bytes between the routers in one second for each board."""

    name: str
    bytes_per_s: float
    n_boards: int


@dataclass(frozen=True)
class FleetFigures:
    """All that was measured.

    Attributes
    ----------
    delay_s : (slips,) float64
        Receipt through zenoh after that over ZeroMQ.
    bridge_part : float
        Processor time of the bridge over time.
    real : (int, int)
        Messages of info and recording that came from the real boards over all cuts, and those that did not.
    """

    n_boards: int
    delay_s: FloatArray
    bridge_part: float
    cuts: Sequence[Cut]
    lost_in_all: int
    real: tuple[int, int]
    profiles: Sequence[Profile]


def bench_fleet(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Cut the line between two routers, then count bytes at three settings of the bridge."""
    n_boards = _QUICK_BOARDS if options.quick else _BOARDS
    cuts_s = _QUICK_CUTS_S if options.quick else _CUTS_S
    with tempfile.TemporaryDirectory(prefix="tactiled-fleet-") as name, two_routers() as routers:
        folder = Path(name)
        found = _cut(
            folder, routers, n_boards, cuts_s, _QUICK_DELAY_S if options.quick else _DELAY_S, progress
        )
        window_s = _QUICK_BYTES_S if options.quick else _BYTES_S
        profiles = [
            _bytes(
                folder,
                routers,
                window_s,
                "events and status",
                20,
                0.0,
                ("--rate", "0"),
                "slip,contact,texture",
            ),
            _bytes(
                folder, routers, window_s, "and scan, grip at 20 Hz", _SCANNING, 100.0, ("--rate", "20"), ""
            ),
            _bytes(folder, routers, window_s, "and every scan, grip (100 Hz)", _SCANNING, 100.0, (), ""),
            _list_bytes(folder, routers, n_boards),
        ]
    figures = FleetFigures(n_boards, *found, profiles)
    machine_load, _, _ = os.getloadavg()
    text = (
        f"{n_boards} simulated boards of one daemon, {_SLIPS_HZ:g} slip messages a second each, through one "
        f"bridge, {_REAL} real ones through another, and two routers on loopback; {os.cpu_count()} "
        f"processors, load average {machine_load:.1f}."
    )
    return BenchReport(
        [text, _cut_table(figures.cuts), _profile_table(profiles), aims_table(AIMS, {"measured": figures})]
    )


def _cut(
    folder: Path,
    routers: TwoRouters,
    n_boards: int,
    cuts_s: Sequence[float],
    delay_window_s: float,
    progress: ProgressBar,
) -> tuple[FloatArray, float, list[Cut], int, tuple[int, int]]:
    """Measure the delay, then cut the line.

    Returns
    -------
    delays, cost of the bridge, cuts, losses in all, and of the real boards messages received and lost.
    """
    endpoint = f"ipc://{folder}/events.ipc"
    total_s = delay_window_s + 2 * sum(cut_s + _RECOVERY_S for cut_s in cuts_s)
    logs = {"zenoh": folder / "zenoh.json", "direct": folder / "direct.json"}
    through = f"zenoh://127.0.0.1:{routers.readers_port}/{_HOST}"
    real_log = folder / "real.json"
    spans: list[tuple[str, float, float, float]] = []
    with _process("bench.fleet.simulated", endpoint, n_boards, _SLIPS_HZ, 0.0) as daemon:
        with (
            _real_boards(folder, routers) as real,
            _process("bench.fleet.listen", real, "info,recording", real_log) as real_reader,
            _bridge(routers, endpoint) as bridge,
            _process("bench.fleet.listen", endpoint, "slip", logs["direct"]) as direct,
            _process("bench.fleet.listen", through, "slip", logs["zenoh"]) as reader,
        ):
            time.sleep(_SETTLE_S)
            begin_s, cpu_s = time.monotonic(), _cpu_s(bridge.pid)
            time.sleep(delay_window_s)
            end_s = time.monotonic()
            bridge_part = (_cpu_s(bridge.pid) - cpu_s) / (end_s - begin_s)
            done_s = delay_window_s
            for cut_s in cuts_s:
                for how, cut in (("closed", routers.line.close), ("silent", routers.line.silence)):
                    cut_at_s = time.monotonic()
                    cut()
                    time.sleep(cut_s)
                    mended_s = time.monotonic()
                    routers.line.mend()
                    time.sleep(_RECOVERY_S)
                    spans.append((how, cut_s, cut_at_s, mended_s))
                    done_s += cut_s + _RECOVERY_S
                    progress.reach(0.9 * done_s / total_s)
            daemon.send_signal(signal.SIGUSR1)
            time.sleep(2.0)
            for process in (direct, reader, real_reader):
                process.terminate()
                process.wait(30)
        daemon.terminate()
        assert daemon.stdout is not None  # asked for
        sent: dict[str, int] = json.loads(daemon.stdout.readline())
    heard = {name: json.loads(log.read_text()) for name, log in logs.items()}
    at_s = {name: {(b, seq): t for b, seq, t, old in rows["messages"]} for name, rows in heard.items()}
    delays = [
        at_s["zenoh"][key] - t
        for key, t in at_s["direct"].items()
        if begin_s <= t < end_s and key in at_s["zenoh"]
    ]
    first: dict[str, int] = {}
    for board, seq in at_s["zenoh"]:
        first[board] = min(seq, first.get(board, seq))
    names = {f"slip/{board}": n for board, n in sent.items()}
    due = {(name, seq) for name, n in names.items() for seq in range(first.get(name, 0), n)}
    lost = due - at_s["zenoh"].keys()
    cuts = _judged(spans, heard["zenoh"], at_s, lost)
    return np.array(delays), bridge_part, cuts, len(lost), _completeness(json.loads(real_log.read_text()))


def _judged(
    spans: Sequence[tuple[str, float, float, float]],
    reader: Mapping[str, Any],
    at_s: dict[str, dict[tuple[str, int], float]],
    lost: set[tuple[str, int]],
) -> list[Cut]:
    """Count for each cut what was sent meanwhile, by the times of the direct subscriber."""
    cuts = []
    for number, (how, cut_s, cut_at_s, mended_s) in enumerate(spans):
        until_s = spans[number + 1][2] - 1.0 if number + 1 < len(spans) else np.inf
        inside = {key for key, t in at_s["direct"].items() if cut_at_s - 1.0 <= t < until_s}
        recovered = [t for b, seq, t, old in reader["messages"] if old and (b, seq) in inside]
        fresh = [float(t) for t in reader["fresh"] if mended_s <= t < until_s]
        cuts.append(
            Cut(
                how,
                cut_s,
                len(inside),
                len(recovered),
                len(inside & lost),
                fresh[0] - mended_s if fresh else 0.0,
                max(recovered) - mended_s if recovered else 0.0,
            )
        )
    return cuts


def _bytes(
    folder: Path,
    routers: TwoRouters,
    window_s: float,
    name: str,
    n_boards: int,
    scans_hz: float,
    options: Sequence[str],
    topics: str,
) -> Profile:
    """Count the bytes between the routers for a bridge with some options."""
    endpoint = f"ipc://{folder}/bytes.ipc"
    through = f"zenoh://127.0.0.1:{routers.readers_port}/{_HOST}"
    topics = topics or "slip,contact,texture,scan,grip,info,recording"
    with (
        _process("bench.fleet.simulated", endpoint, n_boards, _SLIPS_HZ, scans_hz),
        _bridge(routers, endpoint, *options),
        _process("bench.fleet.listen", through, topics, folder / "bytes.json"),
    ):
        time.sleep(_SETTLE_S)
        begin_s, n_bytes = time.monotonic(), routers.line.n_bytes
        time.sleep(window_s)
        rate = (routers.line.n_bytes - n_bytes) / (time.monotonic() - begin_s)
    return Profile(name, rate / n_boards, n_boards)


def _list_bytes(folder: Path, routers: TwoRouters, n_boards: int) -> Profile:
    """Count the bytes of one request of `tactiled fleet`."""
    endpoint = f"ipc://{folder}/list.ipc"
    with _process("bench.fleet.simulated", endpoint, n_boards, 1.0, 0.0), _bridge(routers, endpoint):
        time.sleep(_SETTLE_S)
        n_bytes = routers.line.n_bytes
        states(f"zenoh://127.0.0.1:{routers.readers_port}/*", None, 5.0)
        time.sleep(0.5)
        return Profile("one list of `tactiled fleet`", (routers.line.n_bytes - n_bytes) / n_boards, n_boards)


@contextmanager
def _real_boards(folder: Path, routers: TwoRouters) -> Iterator[str]:
    """Emulated boards on ptys, read by `tactiled run`, with a bridge; yields the endpoint for a reader."""
    endpoint = f"ipc://{folder}/real.ipc"
    words: list[str] = []
    for number in range(_REAL):
        file = folder / f"{serial_of(number)}.toml"
        file.write_text(
            f'[port]\nurl = "{folder}/{serial_of(number)}"\n[session]\nboard_serial = "{serial_of(number)}"\n'
            f'[samples]\ntransfer = "none"\n[publish]\nendpoints = ["{endpoint}"]\n'
        )
        words += ["--config", str(file)]
    with (
        _process("bench.boards.writer", folder, _REAL, 100.0, folder / "written.npz") as writer,
        _process("tactiled", "run", *words, ready=""),
        _bridge(routers, endpoint, "--rate", "0", host="real"),
    ):
        assert writer.stdout is not None  # asked for
        if "all started" not in writer.stdout.readline():
            raise OperatorError("the emulated boards were not started")
        yield f"zenoh://127.0.0.1:{routers.readers_port}/real"


def _completeness(log: Mapping[str, Any]) -> tuple[int, int]:
    """Number of messages that came, and of holes in the numbers of their topics."""
    numbers: dict[str, set[int]] = {}
    for name, seq, _, _ in log["messages"]:
        numbers.setdefault(name, set()).add(seq)
    holes = sum(max(seqs) - min(seqs) + 1 - len(seqs) for seqs in numbers.values())
    return sum(map(len, numbers.values())), holes


@contextmanager
def _bridge(
    routers: TwoRouters, endpoint: str, *options: str, host: str = _HOST
) -> Iterator["subprocess.Popen[str]"]:
    """The bridge, connected to the router of the robots."""
    locator = f"tcp/127.0.0.1:{routers.robots_port}"
    words = ("zenoh", "--events", endpoint, "--connect", locator, "--host", host, *options)
    with _process("tactiled", *words, ready="bridge") as process:
        yield process


@contextmanager
def _process(module: str, *words: object, ready: str = "ready") -> Iterator["subprocess.Popen[str]"]:
    """Python module as a process, ended at the end of the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert process.stdout is not None  # asked for above
    try:
        if ready and ready not in (line := process.stdout.readline()):
            raise OperatorError(f"{module} did not start: {line!r}")
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def _cpu_s(pid: int) -> float:
    """Processor time of a process with all its threads (proc(5): utime and stime)."""
    values = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def _cut_table(cuts: Sequence[Cut]) -> str:
    return table(
        {
            "cut": f"{cut.duration_s:g} s, {cut.how}",
            "slip messages sent": f"{cut.sent}",
            "recovered": f"{cut.recovered}",
            "lost": f"{cut.lost}",
            "fresh after (s)": f"{cut.fresh_after_s:.1f}",
            "complete after (s)": f"{cut.complete_after_s:.1f}",
        }
        for cut in cuts
    )


def _profile_table(profiles: Sequence[Profile]) -> str:
    return table(
        {
            "what crosses the line": profile.name,
            "boards": f"{profile.n_boards}",
            "kB a board": f"{profile.bytes_per_s / 1e3:.2f}"
            + ("" if "list" in profile.name else " a second"),
        }
        for profile in profiles
    )


def _real_lossless(figures: FleetFigures) -> Reading:
    came, lost = figures.real
    return judge(f"{lost} lost of {came + lost}", lost == 0 and came > 0)


def _lossless(figures: FleetFigures) -> Reading:
    total = sum(cut.sent for cut in figures.cuts)
    return judge(f"{figures.lost_in_all} lost of {total}", figures.lost_in_all == 0)


def _delay(figures: FleetFigures) -> Reading:
    p50, p99 = (1e3 * float(np.quantile(figures.delay_s, q)) for q in (0.5, 0.99))
    words = f"{p50:.2f} ms median, {p99:.1f} ms p99, {len(figures.delay_s)} slips"
    return judge(words, p50 <= _MOST_DELAY_MS)


def _bridge_percent(figures: FleetFigures) -> float:
    return 100 * figures.bridge_part / figures.n_boards


_MOST_DELAY_MS = 5.0  # half a scan of 100 Hz
AIMS = (
    Aim[FleetFigures]("slip messages lost over all cuts", "none", _lossless),
    Aim[FleetFigures](f"messages lost of {_REAL} real boards (info, recording)", "none", _real_lossless),
    Aim[FleetFigures](
        "delay over the direct path", f"median at most {_MOST_DELAY_MS:g} ms (half a scan)", _delay
    ),
    at_most(
        "processor time of the bridge for each board",
        1.0,
        " % of a core",
        _bridge_percent,
        ".2f",
    ),
)

"""Cost, memory and latency of many boards in one process, by their number.

Real processes: one that writes frames to as many ptys as there are boards (`writer`), the daemon, and one
subscriber of all boards (`listen`). The daemon is bound to one processor, the other two to the others, where
there are any. The frames are encoded beforehand, so that the boards cost little. Beside that, the same boards
with a daemon process for each.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench.boards.writer import serial_of
from bench.report import Aim, BenchOptions, BenchReport, Reading, aims_table, judge, table
from tactiled.array import FloatArray
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

RATE_HZ = 100.0
NUMBERS, _QUICK_NUMBERS = (1, 2, 4, 8, 16, 32, 64), (1, 4, 16)
_BESIDE = 16  # boards with a process each
_WINDOW_S, _QUICK_WINDOW_S = 15.0, 6.0
_SETTLE_S = 3.0  # from the last start of a board to the window: caches, clock fits
_LATE_S = 1.0  # from the end of the window until a scan counts as lost
_START_S = 90.0  # for all processes and handshakes; a process takes 1.5 s of one core
_TICKS_HZ = os.sysconf("SC_CLK_TCK")
_LIVE = 16
_SATURATED = 0.97  # of the core's time used or waited for: beyond this, the cost cannot grow
_NOISE = 0.1  # of the cost, from run to run on a shared machine
_CONFIG = """
[port]
url = "{folder}/{serial}"
[session]
board_serial = "{serial}"
[samples]
transfer = "none"
[publish]
endpoints = ["ipc://{folder}/{endpoint}"]
"""


@dataclass(frozen=True)
class Load:
    """Cost of some boards, and delay and completeness of their scans.

    Attributes
    ----------
    cpu_part, waited_part : float
        Processor time of the daemon over time, and time that it waited for its processor over time.
    rss_mb, pss_mb : float
        Resident memory of all processes, and the same with shared pages divided among those that share them.
    latency_s : (scans,) float64
        From writing a frame to its receipt by the subscriber.
    due : int
        Scans that the boards wrote in the window.
    valid_part : float
        Share of the statuses that called the data fresh.
    loop_lag_s : float
        Longest turn of an event loop.
    writer_late_s : float
        99 % quantile of how late the frames were written: what the measurement itself adds to no latency.
    """

    n_boards: int
    n_processes: int
    cpu_part: float
    waited_part: float
    rss_mb: float
    pss_mb: float
    latency_s: FloatArray
    due: int
    valid_part: float
    loop_lag_s: float
    writer_late_s: float

    @property
    def lost(self) -> int:
        """Number of scans that no message answers."""
        return self.due - len(self.latency_s)

    @property
    def is_live(self) -> bool:
        """True where all boards were read completely and were always fresh."""
        return self.lost == 0 and self.valid_part == 1.0

    def quantile_ms(self, q: float) -> float:
        """Quantile of the latency in milliseconds; NaN without any scan."""
        return 1e3 * float(np.quantile(self.latency_s, q)) if len(self.latency_s) else float("nan")


def bench_boards(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Measure one process with more and more boards, then a process for each board."""
    numbers = _QUICK_NUMBERS if options.quick else NUMBERS
    window_s = _QUICK_WINDOW_S if options.quick else _WINDOW_S
    cases = [(n, 1) for n in numbers] + [(_BESIDE, _BESIDE)]
    loads = []
    for done, (n_boards, n_processes) in enumerate(cases):
        progress.reach(done / len(cases))
        with tempfile.TemporaryDirectory(prefix="tactiled-boards-") as folder:
            loads.append(measure(Path(folder), n_boards, n_processes, window_s))
    machine_load, _, _ = os.getloadavg()
    text = (
        f"Boards at {RATE_HZ:g} Hz, untouched, 36 channels; {window_s:g} s each; the daemon bound to one "
        f"processor of {os.cpu_count()}, load average {machine_load:.1f}."
    )
    return BenchReport([text, _table(loads), aims_table(AIMS, {"measured": loads})])


def measure(folder: Path, n_boards: int, n_processes: int, window_s: float) -> Load:
    """Run boards, daemons and the subscriber once.

    Parameters
    ----------
    folder : Path
        Empty; for ptys, sockets and logs.
    n_processes : int
        1, or as many as boards.
    window_s : float
        Time over which is measured, in seconds.
    """
    configs = []
    for number in range(n_boards):
        group = number if n_processes > 1 else 0
        path = folder / f"{serial_of(number)}.toml"
        path.write_text(
            _CONFIG.format(folder=folder, serial=serial_of(number), endpoint=f"events{group}.ipc")
        )
        configs.append(path)
    groups = [[path] for path in configs] if n_processes > 1 else [configs]
    endpoints = [f"ipc://{folder}/events{group}.ipc" for group in range(len(groups))]
    first, *others = sorted(os.sched_getaffinity(0))
    written, heard = folder / "written.npz", folder / "heard.npz"
    with ExitStack() as stack:
        beside = {*others} or {first}
        listener = stack.enter_context(_process(beside, "bench.boards.listen", heard, n_boards, *endpoints))
        writer = stack.enter_context(
            _process(beside, "bench.boards.writer", folder, n_boards, RATE_HZ, written)
        )
        daemons = [
            stack.enter_context(
                _process(
                    {first}, "tactiled", "run", *(word for path in group for word in ("--config", path)),
                    is_ready=False,
                )
            )
            for group in groups
        ]  # fmt: skip
        _await_start(writer)
        time.sleep(_SETTLE_S)
        pids = [daemon.pid for daemon in daemons]
        begin_s, cpu_s, waited_s = time.monotonic(), _cpu_s(pids), _waited_s(pids)
        time.sleep(window_s)
        end_s, cpu_s, waited_s = time.monotonic(), _cpu_s(pids) - cpu_s, _waited_s(pids) - waited_s
        rss_mb, pss_mb = _memory_mb(pids, "Rss"), _memory_mb(pids, "Pss")
        time.sleep(_LATE_S)
        for process in (writer, listener):
            process.terminate()
            process.wait(60)
    with np.load(written) as w, np.load(heard) as h:
        latency_s, due, late_s = matched(w["board"], w["time_s"], w["late_s"], h["scans"], (begin_s, end_s))
        statuses = h["statuses"]
    inside = (statuses[:, 1] >= begin_s) & (statuses[:, 1] < end_s)
    return Load(
        n_boards, n_processes, cpu_s / (end_s - begin_s), waited_s / (end_s - begin_s), rss_mb, pss_mb,
        latency_s, due, float(np.mean(statuses[inside, 2])), float(np.max(statuses[inside, 3])),
        float(np.quantile(late_s, 0.99)),
    )  # fmt: skip


def matched(
    board: FloatArray, time_s: FloatArray, late_s: FloatArray, scans: FloatArray, span: tuple[float, float]
) -> tuple[FloatArray, int, FloatArray]:
    """Match the frames that were written in a span with the messages that answer them.

    Parameters
    ----------
    board, time_s, late_s : (frames,) arrays
        Frames in the order of writing; the time is NaN for a frame that the line did not take.
    scans : (messages, 3) array
        Board, index and time of receipt of each scan message.
    span : (float, float)
        Begin and end, monotonic seconds.

    Returns
    -------
    latency_s : (answered,) float64
    due : int
        Number of frames of the span.
    late_s : (frames of the span,) float64
    """
    received = {(int(b), int(index)): at_s for b, index, at_s in scans}
    latency, due, late = [], 0, []
    for number in np.unique(board):
        chosen = board == number
        times = time_s[chosen]
        # A frame that was not written has the time of its predecessor, so that it counts as due.
        known = np.maximum.accumulate(np.nan_to_num(times, nan=-np.inf))
        for index in np.flatnonzero((known >= span[0]) & (known < span[1])):
            due += 1
            late.append(late_s[chosen][index])
            if (at_s := received.get((int(number), int(index)))) is not None:
                latency.append(at_s - times[index])
    return np.array(latency), due, np.array(late)


@contextmanager
def _process(
    processors: set[int], module: str, *words: object, is_ready: bool = True
) -> Iterator[subprocess.Popen[str]]:
    """Python module as a process on some processors, ended at the end of the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    os.sched_setaffinity(process.pid, processors)
    assert process.stdout is not None  # asked for above
    try:
        if is_ready and "ready" not in (line := process.stdout.readline()):
            raise OperatorError(f"{module} did not start: {line!r}")
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def _await_start(writer: "subprocess.Popen[str]") -> None:
    """Wait until all boards were started; a daemon that is overloaded may never do so."""
    assert writer.stdout is not None
    os.set_blocking(writer.stdout.fileno(), False)
    until_s = time.monotonic() + _START_S
    while time.monotonic() < until_s:
        if "all started" in (writer.stdout.readline() or ""):
            return
        time.sleep(0.1)


def _cpu_s(pids: Sequence[int]) -> float:
    """Processor time of processes with all their threads (proc(5): utime and stime)."""
    total = 0
    for pid in pids:
        values = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        total += int(values[11]) + int(values[12])
    return total / _TICKS_HZ


def _waited_s(pids: Sequence[int]) -> float:
    """Time that the main threads of processes were ready and waited for a processor (schedstat)."""
    return sum(int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9 for pid in pids)


def _memory_mb(pids: Sequence[int], what: str) -> float:
    total = 0
    for pid in pids:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith(f"{what}:"):
                total += int(line.split()[1])
    return total * 1024 / 1e6


def _table(loads: Sequence[Load]) -> str:
    return table(
        {
            "boards": f"{load.n_boards}" + (" (a process each)" if load.n_processes > 1 else ""),
            "cost (% of a core)": f"{100 * load.cpu_part:.0f}",
            "for each board": f"{100 * load.cpu_part / load.n_boards:.1f}",
            "waited for the core (%)": f"{100 * load.waited_part:.0f}",
            "RSS / PSS (MB)": f"{load.rss_mb:.0f} / {load.pss_mb:.0f}",
            "latency p50 / p99 / max (ms)": " / ".join(
                f"{load.quantile_ms(q):.1f}" for q in (0.5, 0.99, 1.0)
            ),
            "scans lost": f"{load.lost} of {load.due}",
            "fresh (% of statuses)": f"{100 * load.valid_part:.1f}",
            "longest turn (ms)": f"{1e3 * load.loop_lag_s:.0f}",
            "frames written late, p99 (ms)": f"{1e3 * load.writer_late_s:.1f}",
        }
        for load in loads
    )


def _in_one(loads: Sequence[Load]) -> list[Load]:
    return [load for load in loads if load.n_processes == 1]


def _live(loads: Sequence[Load]) -> Reading:
    [load] = [load for load in _in_one(loads) if load.n_boards == _LIVE]
    most = max((load.n_boards for load in _in_one(loads) if load.is_live), default=0)
    return judge(
        f"{100 * load.cpu_part:.0f} % of a core, {load.lost} lost, {100 * load.valid_part:.1f} % fresh, "
        f"{most} boards live",
        load.is_live,
    )


def _proportional(loads: Sequence[Load]) -> Reading:
    """Growth of the cost of one board with their number, while there is processor time left."""
    spare = [load for load in _in_one(loads) if load.cpu_part + load.waited_part < _SATURATED]
    if len(spare) < 2:
        return judge(f"only {len(spare)} numbers of boards leave processor time", False, is_open=True)
    cost = [load.cpu_part / load.n_boards for load in spare]
    worst = max(more / fewer for fewer, more in pairwise(cost))
    words = (
        f"{100 * cost[0]:.1f} % for each of {spare[0].n_boards}, {100 * cost[-1]:.1f} % for each of "
        f"{spare[-1].n_boards}; at worst {worst:.2f} times in proportion"
    )
    return judge(words, worst <= 1 + _NOISE)


def _cheaper(loads: Sequence[Load]) -> Reading:
    [together] = [load for load in _in_one(loads) if load.n_boards == _BESIDE]
    [apart] = [load for load in loads if load.n_processes > 1]
    words = (
        f"{100 * together.cpu_part:.0f} % and {together.pss_mb:.0f} MB, apart {100 * apart.cpu_part:.0f} % "
        f"and {apart.pss_mb:.0f} MB"
    )
    return judge(words, together.pss_mb < apart.pss_mb and together.cpu_part <= apart.cpu_part)


AIMS = tuple(
    Aim[Sequence[Load]](name, limit, measured)
    for name, limit, measured in (
        (f"{_LIVE} boards live on one core", "no scan lost, every status fresh", _live),
        ("cost over the number of boards", "at most in proportion", _proportional),
        (f"{_BESIDE} boards beside a process each", "less memory, no more processor time", _cheaper),
    )
)

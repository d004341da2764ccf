"""Throughput of the daemon and of files.

A flood through a pty is read by the daemon and, after it, by the C program of `bench.latency`: how long the
board waits until each has taken the scans. Files are detected by one processor. All of this is repeated in
turn, and ratios are within a repeat.
"""

import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgpack
import numpy as np
import zmq

from bench.latency.bench import REFERENCE
from bench.processes import (
    PYTHON,
    TACTILED,
    compile_program,
    daemon_config,
    free_port,
    next_line,
    running,
)
from bench.report import BenchOptions, aims_table, load_words, median_aim, over_runs, table
from bench.scenes import record_scene
from tactiled import compiled
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

# Words for each scene, and the aim for times real time
SCENES = {"rest": ("detect, rest", 1000.0), "slide": ("detect, sliding over grooves", 200.0)}
_HERE = Path(__file__).parent
_SCANS, _REFERENCE_SCANS = 30_000, 500_000
_REPEATS, _QUICK_REPEATS = 3, 1
_QUICK_PART = 5  # so many times fewer scans and seconds
_LONGEST_S = 120.0
_DRAIN_S = 3.0


def bench_throughput(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Measure floods and files."""
    part = _QUICK_PART if options.quick else 1
    repeats = _QUICK_REPEATS if options.quick else _REPEATS
    times_real: dict[str, list[float]] = {scene: [] for scene in SCENES}
    c_per_s, daemon_per_s, lost = [], [], 0
    with tempfile.TemporaryDirectory(prefix="tactiled-throughput-") as name:
        folder = Path(name)
        program = compile_program(folder, REFERENCE)
        duration_s = {}
        for name in SCENES:
            played = load_scene(str(_HERE / f"{name}.toml"))
            duration_s[name] = played.duration_s / part
            record_scene(folder / f"{name}.mcap", played, duration_s[name])
        for repeat in range(repeats):
            progress.reach(0.1 + 0.9 * repeat / repeats)
            for scene in SCENES:
                times_real[scene].append(duration_s[scene] / _cpu_of_detect(folder / f"{scene}.mcap"))
            c_per_s.append(_flood_reference(folder, program, _REFERENCE_SCANS // part))
            speed, n_lost = _flood_daemon(folder, _SCANS // part)
            daemon_per_s.append(speed)
            lost += n_lost
    over_c = (np.array(daemon_per_s) / c_per_s).tolist()
    floods = ("C", c_per_s, [1.0], "not counted"), ("tactiled", daemon_per_s, over_c, f"{lost}")
    return [
        f"{repeats} repeats (median and range); {load_words()}. Path of a scan: {compiled.path_words()}.",
        table(
            {
                "flood through a pty": name,
                "scans/s": over_runs(scans_per_s, ",.0f"),
                "over C": over_runs(ratios, ".3f"),
                "scans lost": n_lost,
            }
            for name, scans_per_s, ratios, n_lost in floods
        ),
        table(
            {"file": words, "times real time": over_runs(times_real[scene], ".0f")}
            for scene, (words, _) in SCENES.items()
        ),
        aims_table(
            [
                median_aim("flood through a pty, over C", 0.25, over_c, ".3f", is_least=True),
                *(
                    median_aim(
                        f"`detect` of a file, {scene}, times real time",
                        limit,
                        times_real[scene],
                        ".0f",
                        is_least=True,
                    )
                    for scene, (_, limit) in SCENES.items()
                ),
            ]
        ),
    ]


def _cpu_of_detect(path: Path) -> float:
    command = [*PYTHON, "bench.throughput.files", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.splitlines()[-1])


@contextmanager
def _flooding(folder: Path, n_scans: int, *options: str) -> Iterator[tuple[Path, "subprocess.Popen[str]"]]:
    """Board that floods a pty, and the name of the pty."""
    link = folder / "flood"
    link.unlink(missing_ok=True)
    flood = "bench.throughput.flood", str(link), str(n_scans)
    with running(*PYTHON, *flood, *options, ready="ready") as board:
        yield link, board


def _flood_reference(folder: Path, program: Path, n_scans: int) -> float:
    """Return the scans a second that the C program takes."""
    with _flooding(folder, n_scans) as (link, board), running(program, link, str(free_port())):
        return n_scans / float(next_line(board))


def _flood_daemon(folder: Path, n_scans: int) -> tuple[float, int]:
    """Return the scans a second that the daemon takes, and the scans that it did not decode."""
    endpoint = f"ipc://{folder}/events"
    with _flooding(folder, n_scans, "--ask") as (link, board):
        config = daemon_config(folder / "tactiled.toml", link, endpoint)
        with running(*TACTILED, "run", "--config", config):
            n_decoded = _count_scans(endpoint, board)
            return n_scans / float(next_line(board)), n_scans - n_decoded


def _count_scans(endpoint: str, board: "subprocess.Popen[str]") -> int:
    """Subscribe to every message until the daemon has taken the flood; the scans that it decoded."""
    with zmq.Context() as context, context.socket(zmq.SUB) as events:
        events.setsockopt(zmq.LINGER, 0)
        events.subscribe("")
        events.connect(endpoint)
        until_s, last_s, n_scans = time.monotonic() + _LONGEST_S, time.monotonic(), 0
        while time.monotonic() - last_s < _DRAIN_S or not n_scans:
            if time.monotonic() > until_s or board.poll() is not None:
                raise OperatorError("the daemon did not take the flood: is this machine too busy?")
            if not events.poll(100):
                continue
            topic, payload = events.recv_multipart()
            if topic.endswith(b"/status"):
                counted = msgpack.unpackb(payload)["scans"]
                last_s = time.monotonic() if counted != n_scans else last_s
                n_scans = counted
        return n_scans

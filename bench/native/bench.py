"""Latency of scans at the client of C++ beside a bare `zmq_recv`, and the cost of a scan.

Two processes of `receive.cpp` have a publisher each, which send scans in turn, 5 ms apart, so that the
programs do not compete for the processors. The client has read the scan into its structure when it notes the
time; the other program has its bytes. Latency is from before the send to that instant, wake-up included.
"""

import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zmq

from bench.native.node import node_sections
from bench.native.publish import BOARD, RUN, Publisher, latencies_us, publish_in_turn
from bench.processes import compile_program
from bench.report import (
    Aim,
    BenchOptions,
    aims_table,
    at_most,
    load_words,
    median_aim,
    over_runs,
    table,
)
from tactiled.array import FloatArray
from tactiled.errors import OperatorError
from tactiled.events.codec import encode
from tactiled.events.types import ScanEvent
from tactiled.progress import ProgressBar

PROGRAMS = "client", "bare"
_REPEATS, _SCANS = 5, 2000
_QUICK_REPEATS, _QUICK_SCANS = 1, 500
_COST_SCANS = 100_000
_HERE = Path(__file__).parent
_HEADERS = _HERE.parents[1] / "protocols" / "cpp"
_SCAN = ScanEvent(
    time_s=0.0, index=1, volts=tuple(1.0 + 0.01 * k for k in range(36)), valid=(True,) * 36, time_sd_s=2e-5,
    age_s=0.004, late=False,
)  # fmt: skip


@dataclass(frozen=True)
class NativeRun:
    """One run of both programs."""

    latency_us: dict[str, FloatArray]  # (scans,): by program
    processor_us: dict[str, float]  # processor time of the process over its scans

    def ratio(self, q: float) -> float:
        """Quantile of the client's latency over that of the bare receiver."""
        client, bare = (float(np.quantile(self.latency_us[name], q)) for name in PROGRAMS)
        return client / bare


@dataclass(frozen=True)
class NativeCost:
    """Cost of a scan in the inbox and its reading into the structure, in a loop without sockets."""

    scan_us: float
    """Processor time."""
    allocations: float


def bench_native(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Measure the client of C++."""
    repeats, n_scans = (_QUICK_REPEATS, _QUICK_SCANS) if options.quick else (_REPEATS, _SCANS)
    runs = []
    with tempfile.TemporaryDirectory(prefix="tactiled-native-") as name:
        receive = compile_receiver(Path(name))
        for repeat in range(repeats):
            progress.reach(repeat / repeats)
            folder = Path(name) / str(repeat)
            folder.mkdir()
            runs.append(run_once(folder, receive, n_scans))
        cost = measure_cost(Path(name), receive)
        of_node = node_sections(Path(name), receive, repeats, n_scans)
    text = (
        f"{repeats} runs of {n_scans} scans at 100 Hz over ipc; {load_words()}. Latency is counted from "
        "before the send until the scan is in its structure (tactiled.hpp), or its bytes are there "
        "(zmq_recv). Ratios are those of two programs in the same run: median and range over the runs."
    )
    cost_text = (
        f"In a loop without sockets, {_COST_SCANS} scans of 36 channels: {cost.scan_us:.1f} us of processor "
        "time a scan, through the inbox and into its structure. "
        f"{cost.allocations:.2f} allocations."
    )
    return [text, _latency_table(runs), cost_text, aims_table(aims(runs, cost)), *of_node]


def compile_receiver(folder: Path) -> Path:
    """Compile both programs, which are one."""
    if not Path("/usr/include/zmq.hpp").exists():
        raise OperatorError("bench native needs sudo apt install g++ cppzmq-dev libzmq3-dev")
    flags = "-std=c++17", "-Wl,--wrap=malloc", f"-I{_HEADERS}", "-lzmq"
    return compile_program(folder, _HERE / "receive.cpp", *flags)


def run_once(folder: Path, receive: Path, n_scans: int) -> NativeRun:
    """Publish to both programs until they have their scans."""
    endpoints = {name: f"ipc://{folder}/{name}-events" for name in PROGRAMS}
    with ExitStack() as stack:
        context = stack.enter_context(zmq.Context())
        publishers = [Publisher(context, endpoint, lambda _: _SCAN) for endpoint in endpoints.values()]
        programs = []
        for name, endpoint in endpoints.items():
            command = [str(receive), name, endpoint, str(n_scans)]
            programs.append(stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)))
            stack.callback(programs[-1].kill)
        for publisher in publishers:
            stack.callback(publisher.close)
        publish_in_turn(publishers, programs)
        printed = [program.communicate()[0] for program in programs]
    latency_us, processor_us = {}, {}
    for name, publisher, text in zip(PROGRAMS, publishers, printed, strict=True):
        _, *lines, used_us = text.splitlines()  # the first line says "ready"
        latency_us[name] = latencies_us(lines, publisher.sent_ns)
        processor_us[name] = float(used_us) / len(lines)
    return NativeRun(latency_us, processor_us)


def measure_cost(folder: Path, receive: Path) -> NativeCost:
    """Play scans through the inbox in a loop."""
    with (folder / "scans").open("wb") as out:
        for seq in range(_COST_SCANS):
            _, payload = encode(_SCAN, seq=seq, board=BOARD, unix_offset_s=1.7e9, run=RUN)
            out.write(b"%d\n" % len(payload) + payload)
    done = subprocess.run([receive, "cost", folder / "scans"], capture_output=True, text=True, check=True)
    scan_us, with_new, with_malloc = map(float, done.stdout.split())
    return NativeCost(scan_us, with_new + with_malloc)


def _latency_table(runs: Sequence[NativeRun]) -> str:
    rows = []
    for name, label in zip(PROGRAMS, ("tactiled.hpp", "zmq_recv"), strict=True):
        latencies = [run.latency_us[name] for run in runs]
        row = {"program": label}
        for words, q in (("p50", 0.5), ("p99", 0.99)):
            values = [float(np.quantile(one, q)) for one in latencies]
            row[f"latency {words} (us)"] = over_runs(values, ".0f")
        row["processor (us a scan)"] = over_runs([run.processor_us[name] for run in runs], ".0f")
        rows.append(row)
    return table(rows)


def aims(runs: Sequence[NativeRun], cost: NativeCost) -> list[Aim]:
    """Judge the runs, and the cost in a loop."""
    added_us = [run.processor_us["client"] - run.processor_us["bare"] for run in runs]
    return [
        median_aim("p50 of the client over zmq_recv", 1.1, [run.ratio(0.5) for run in runs], ".2f"),
        median_aim("p99 of the client over zmq_recv", 1.5, [run.ratio(0.99) for run in runs], ".2f"),
        at_most("a scan in a loop", 20.0, cost.scan_us, ".1f", " us"),
        at_most("processor time of a scan beyond zmq_recv", 20.0, float(np.median(added_us)), ".1f", " us"),
        at_most("allocations of a scan", 0.0, cost.allocations, ".2f"),
    ]

"""Latency of scans from the last byte to a subscriber, beside a C program that gets the same frames.

Real processes: an emulated board, a relay that notes when it wrote each frame (`relay`), the daemon on one
pty and the C program (`reference.c`) on another, and one subscriber of both (`listen`). The phases of the
scene (untouched, held, sliding over grooves whose speed is not given) are compared in one run, because
machines differ; the spread over repeats shows what the comparison is worth.
"""

import functools
import itertools
import json
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.processes import (
    PYTHON,
    TACTILED,
    compile_program,
    cpu_s,
    daemon_config,
    free_port,
    rss_mb,
    running,
    wait_for_path,
)
from bench.report import (
    Aim,
    BenchOptions,
    aim,
    aims_table,
    at_most,
    load_words,
    median_aim,
    never,
    over_runs,
    table,
)
from tactiled.array import FloatArray
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Scan
from tactiled.wire.layout import load_layout

SCENE = str(Path(__file__).with_name("scene.toml"))
REFERENCE = Path(__file__).with_name("reference.c")
PROGRAMS = {"daemon": "tactiled", "reference": "C"}
_PHASES = {"rest": "rest", "hold": "contact", "slide": "sliding"}
_REPEATS, _QUICK_REPEATS = 3, 1
# Left out at the beginning of each phase: the start of the processes, and the time until the first fit.
_SETTLE_S = 4.0
_LAYOUT = load_layout("board-v1")
_ADC_VOLTS = 3.0 / 4096  # of the emulated board


@dataclass(frozen=True)
class PhaseLatency:
    """Latency, losses and processor time of one program in one phase of one run."""

    latency_s: FloatArray  # (scans,): from writing the frame to the subscriber's receipt
    lost: int  # frames that no message answers
    cpu_part: float  # processor time over time

    def quantile_ms(self, q: float) -> float:
        """Quantile of the latency in milliseconds."""
        return 1e3 * float(np.quantile(self.latency_s, q))


@dataclass(frozen=True)
class Run:
    """One run: both programs by phase, and the daemon's own account."""

    daemon: Mapping[str, PhaseLatency]
    reference: Mapping[str, PhaseLatency]
    loop_lag_s: Mapping[str, float]
    fits_late: int
    memory_mb: float
    """Resident memory of the daemon at the end, 10^6 bytes."""

    def ratio(self, phase: str, q: float) -> float:
        """Quantile of the daemon's latency over that of the reference."""
        return self.daemon[phase].quantile_ms(q) / self.reference[phase].quantile_ms(q)

    def cpu_ratio(self, phase: str) -> float:
        """Processor time of the daemon over that of the reference."""
        return self.daemon[phase].cpu_part / max(self.reference[phase].cpu_part, 1e-9)


def bench_latency(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Measure the latency of both programs."""
    repeats = _QUICK_REPEATS if options.quick else _REPEATS
    runs = []
    with tempfile.TemporaryDirectory(prefix="tactiled-latency-") as name:
        reference = compile_program(Path(name), REFERENCE)
        for repeat in range(repeats):
            progress.reach(repeat / repeats)
            folder = Path(name) / str(repeat)
            folder.mkdir()
            runs.append(play_scene(folder, reference))
    text = (
        f"{repeats} runs; {load_words()}. Ratios are those of two programs in the same run: median and range "
        f"over the runs. The first {_SETTLE_S:g} s of each phase are left out: until then, processes start, "
        "and a slide has no groove fit."
    )
    return [text, _latency_table(runs), aims_table(_aims(runs))]


def play_scene(folder: Path, reference: Path) -> Run:
    """Play the scene once through both programs."""
    board, daemon_link, reference_link = folder / "board", folder / "daemon", folder / "reference"
    endpoint, port = f"ipc://{folder}/events", free_port()
    config = daemon_config(folder / "tactiled.toml", daemon_link, endpoint)
    relayed, heard = folder / "relayed", folder / "heard"
    cpu: dict[str, list[tuple[float, float]]] = {"daemon": [], "reference": []}
    end_s = max(end_s for _, end_s in spans_of_phases().values())
    with ExitStack() as stack:
        listen = (*PYTHON, "bench.latency.listen", endpoint, str(port), heard)
        stack.enter_context(running(*listen, ready="ready"))
        emulator = stack.enter_context(running(*TACTILED, "emulate", "--scene", SCENE, "--link", board))
        wait_for_path(board)
        pass_on = (*PYTHON, "bench.latency.relay", board, daemon_link, reference_link, relayed)
        relay = stack.enter_context(running(*pass_on, ready="ready"))
        programs = {
            "reference": stack.enter_context(running(reference, reference_link, str(port), ready="ready")),
            "daemon": stack.enter_context(running(*TACTILED, "run", "--config", config)),
        }
        start_s = _scene_start_s(emulator)
        while time.monotonic() < start_s + end_s:
            time.sleep(0.2)
            for name, process in programs.items():
                cpu[name].append((time.monotonic() - start_s, cpu_s(process.pid)))
        memory_mb = rss_mb(programs["daemon"].pid)
        emulator.terminate()
        relay.wait(10)
    return matched(relayed, heard, start_s, cpu, memory_mb)


def _scene_start_s(emulator: subprocess.Popen[str]) -> float:
    """Time at which the emulated board began to play, host monotonic seconds."""
    assert emulator.stdout is not None
    for line in emulator.stdout:
        if (said := json.loads(line))["what"] == "scene":
            return float(said["t0_s"])
    raise OperatorError("the emulated board ended before its scene began: was the daemon able to start it?")


@functools.cache
def spans_of_phases() -> dict[str, tuple[float, float]]:
    """Begin and end of each phase to be measured, in the scene's time."""
    phases = load_scene(SCENE).phases
    ends_s = itertools.accumulate(phase.duration_s for phase in phases)
    return {
        _PHASES[phase.kind]: (end_s - phase.duration_s + _SETTLE_S, end_s)
        for phase, end_s in zip(phases, ends_s, strict=True)
        if phase.kind in _PHASES
    }


def matched(
    relayed: Path,
    heard: Path,
    start_s: float,
    cpu: Mapping[str, Sequence[tuple[float, float]]],
    memory_mb: float = float("nan"),
) -> Run:
    """Match frames and messages of a run, by the sequence number, which no scene is long enough to wrap."""
    decoder, counts = Decoder(_LAYOUT), dict[int, bytes]()
    written_s: dict[str, dict[int, float]] = {name: {} for name in PROGRAMS}
    for line in relayed.read_text().splitlines():
        *both_s, octets = json.loads(line)
        for frame in decoder.feed(bytes.fromhex(octets)):
            if isinstance(frame, Scan):
                counts[frame.sequence] = frame.counts.tobytes()
                for name, at_s in zip(PROGRAMS, both_s, strict=True):
                    written_s[name][frame.sequence] = at_s
    # Readings of an untouched skin repeat, so only the others tell which index the first frame has.
    repeats = Counter(counts.values())
    by_counts = {octets: sequence for sequence, octets in counts.items() if repeats[octets] == 1}
    offsets, scan_times, answered = Counter[int](), dict[int, float](), dict[int, float]()
    lags, fits_late = [], 0
    for line in heard.read_text().splitlines():
        time_s, said = json.loads(line)
        if said["topic"] == "reference":
            answered[said["sequence"]] = time_s
        elif said["topic"] == "scan":
            octets = np.rint(np.array(said["volts"]) / _ADC_VOLTS).astype(np.int64).tobytes()
            scan_times[said["index"]] = time_s
            if octets in by_counts:
                offsets[by_counts[octets] - said["index"]] += 1
        elif said["topic"] == "status":
            lags.append((time_s - start_s, said["loop_lag_s"]))
            fits_late = max(fits_late, said["fits_late"])
    [(offset, _)] = offsets.most_common(1)
    came_s = {
        "daemon": {index + offset: time_s for index, time_s in scan_times.items()},
        "reference": answered,
    }
    found: dict[str, dict[str, PhaseLatency]] = {name: {} for name in PROGRAMS}
    longest_lag_s = {}
    for phase, (begin_s, end_s) in spans_of_phases().items():
        for name in PROGRAMS:
            chosen = {n: at_s for n, at_s in written_s[name].items() if begin_s <= at_s - start_s < end_s}
            came = came_s[name]
            latencies = [came[n] - at_s for n, at_s in chosen.items() if n in came]
            used_s = np.diff(np.interp([begin_s, end_s], *np.array(cpu[name]).T))[0]
            found[name][phase] = PhaseLatency(
                np.array(latencies), len(chosen) - len(latencies), float(used_s) / (end_s - begin_s)
            )
        longest_lag_s[phase] = max((lag_s for at_s, lag_s in lags if begin_s <= at_s < end_s), default=0.0)
    return Run(found["daemon"], found["reference"], longest_lag_s, fits_late, memory_mb)


def _latency_table(runs: Sequence[Run]) -> str:
    rows = []
    for phase in spans_of_phases():
        row = {"phase": phase}
        for name, label in PROGRAMS.items():
            each: list[PhaseLatency] = [getattr(run, name)[phase] for run in runs]
            p50, p99, most = (
                float(np.median([one.quantile_ms(q) for one in each])) for q in (0.5, 0.99, 1.0)
            )
            row[f"{label}: p50 / p99 / max"] = f"{p50:.2f} / {p99:.2f} / {most:.1f} ms"
            row[f"{label}: processor"] = f"{100 * np.median([one.cpu_part for one in each]):.1f} %"
            row[f"{label}: lost"] = str(sum(one.lost for one in each))
        row["ratio of p50"] = over_runs([run.ratio(phase, 0.5) for run in runs], ".1f")
        row["ratio of p99"] = over_runs([run.ratio(phase, 0.99) for run in runs], ".1f")
        row["longest turn of the loop"] = f"{_longest_turn_ms(runs, phase):.1f} ms"
        rows.append(row)
    return table(rows)


def _longest_turn_ms(runs: Sequence[Run], phase: str) -> float:
    return 1e3 * max(run.loop_lag_s[phase] for run in runs)


def _aims(runs: Sequence[Run]) -> list[Aim]:
    turn_ms, rest_ms = (_longest_turn_ms(runs, phase) for phase in ("sliding", "rest"))
    over_rest = f"{turn_ms / max(rest_ms, 1e-6):.1f} times {rest_ms:.1f} ms"
    memory_mb = float(np.median([run.memory_mb for run in runs]))

    def over_c(words: str, limit: float, phase: str, ratios: Sequence[float]) -> Aim:
        return median_aim(f"{words} of tactiled over C, {phase}", limit, ratios, ".1f")

    return [
        *(
            over_c(f"p{percent}", limit, phase, [run.ratio(phase, percent / 100) for run in runs])
            for percent, limit in ((50, 2.5), (99, 3.0))
            for phase in spans_of_phases()
        ),
        at_most("longest turn of the loop while sliding, on a quiet machine", 5.0, turn_ms, ".1f", " ms"),
        aim("the same, on any machine", "at most 3 times that at rest", over_rest, turn_ms <= 3 * rest_ms),
        never("scans lost", sum(one.lost for run in runs for one in run.daemon.values())),
        never("groove fits late", sum(run.fits_late for run in runs)),
        at_most("memory of the daemon after the slide (RSS)", 110.0, memory_mb, ".0f", " MB"),
        *(
            over_c("processor", limit, phase, [run.cpu_ratio(phase) for run in runs])
            for phase, limit in (("rest", 10.0), ("sliding", 15.0))
        ),
    ]

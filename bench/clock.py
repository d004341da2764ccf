"""``./run bench clock``: errors of the instants that scans carry.

The emulated board scans by its own crystal, its line delays, bunches and stalls; the bytes go through the
same pipeline as live ones. Truth is the emulator's record of when each scan began. Each line is
timed twice: with the daemon's pings, which the board answers, and without.
"""

from dataclasses import dataclass

import numpy as np

from bench.report import BenchOptions, rms, seeds_in_words, table
from tactiled.array import FloatArray, load_array
from tactiled.daemon.board.asking import Pinging
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import load_scene
from tactiled.pipeline import Pipeline
from tactiled.progress import ProgressBar
from tactiled.samples.block import ScanRun, TimedScan
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import load_layout

_ORIGIN_S = 1000.0
_BOARD = EmulatedBoardParams()  # that answers pings within its usual times
_SETTLED_S = 10.0  # errors count from here on, as the target is stated
_DURATION_S = 60.0


@dataclass(frozen=True)
class LineConditions:
    """A line, the crystal and rate of the board behind it, and the mean delay of a busy host's wake-ups."""

    name: str
    drift_ppm: float
    faults: FaultParams
    rate_hz: float = 100.0
    wake_s: float = 0.0


_STALLS = FaultParams(bunch_s=0.016, stall_per_s=0.1)
_ADAPTER = FaultParams(bunch_s=0.016, stall_per_s=0.1, adapter_ppm=20.0)
_LINES = (
    LineConditions("16 ms bunches, 100 ppm, 0.5 s stalls", 100.0, _STALLS),
    LineConditions("the same, -100 ppm", -100.0, _STALLS),
    LineConditions("the same, adapter +20 ppm", -100.0, _ADAPTER),
    LineConditions("16 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.016)),
    LineConditions("16 ms bunches, 5 ppm, 50 Hz", 5.0, FaultParams(bunch_s=0.016), rate_hz=50.0),
    LineConditions("10 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.010)),
    LineConditions("1 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.001)),
    LineConditions("no bunches, 100 ppm, 0.5 s stalls", 100.0, FaultParams(stall_per_s=0.1)),
    LineConditions(
        "16 ms bunches, 50 ppm, host wakes 5 ms late", 50.0, FaultParams(bunch_s=0.016), wake_s=0.005
    ),
    LineConditions("the same, clock 1 % slow", -10_000.0, FaultParams(bunch_s=0.016), wake_s=0.005),
)


def bench_clock(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Table of timing errors over several lines."""
    progress.begin(len(_LINES))
    seeds, rows = 2 if options.quick else 10, []
    for line in _LINES:
        row, settled = {"line": line.name}, round(_SETTLED_S * line.rate_hz)
        for before, pings in (("", False), ("with ping: ", True)):
            runs = [timing(line, seed, _DURATION_S, pings=pings) for seed in range(seeds)]
            error_s = np.concatenate([error_s[settled:] for error_s, _ in runs])
            sd_s = np.concatenate([sd_s[settled:] for _, sd_s in runs])
            runs_ms = [1e3 * rms(error_s[settled:]) for error_s, _ in runs]
            row |= {
                f"{before}rms (ms)": f"{1e3 * rms(error_s):.3f}",
                f"{before}largest rms of a run": f"{max(runs_ms):.3f}",
                f"{before}largest": f"{1e3 * np.max(np.abs(error_s)):.2f}",
                f"{before}stated sd": f"{1e3 * rms(sd_s):.3f}",
                f"{before}error / stated sd": f"{rms(error_s / sd_s):.1f}",
            }
        progress.advance(line.name)
        rows.append(row)
    title = (
        f"Errors of the times of scans, from {_SETTLED_S:g} s after the start on, in {seeds} runs "
        f"({seeds_in_words(seeds)}) of {_DURATION_S:g} s for each line, without and with pings. The board "
        f"answers a ping within {1e3 * _BOARD.answer_least_s:g} to {1e3 * _BOARD.answer_most_s:g} ms."
    )
    return [title, table(rows)]


def answers() -> dict[str, list[float]]:
    """Return errors and stated deviations (ms) of the last scan of short runs: see `bench.report.as_json`."""
    found = {}
    for line in _LINES:
        for pings in (False, True):
            errors_s, sds_s = timing(line, 1000, _SETTLED_S, pings=pings)  # no seed of a result
            found[f"{line.name}, {pings}"] = [
                round(1e3 * float(last), 9) for last in (errors_s[-1], sds_s[-1])
            ]
    return found


def timing(
    line: LineConditions, seed: int, duration_s: float, *, pings: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Error and stated sigma (n,) of every scan's instant; the board is pinged as the daemon does."""
    layout = load_layout("board-v1")
    # The board starts on a hand-over of the adapter, so only what follows sets the phase of scans against
    # bunches: steps of the multiplexer that differ by up to 36 x 140 us cover any lattice.
    rng = np.random.default_rng(seed)
    step_s = float(rng.uniform(60e-6, 200e-6))
    scans: list[ScanTruth] = []
    board = EmulatedBoardParams(
        drift_ppm=line.drift_ppm, channel_step_s=step_s, rate_hz=line.rate_hz, boot_count=seed + 1
    )
    port = EmulatedPort(
        load_scene("rest"), layout, power_up_s=_ORIGIN_S, board=board, faults=line.faults, seed=seed,
        on_scan=scans.append,
    )  # fmt: skip
    encoder, pipeline, pinging = Encoder(layout), Pipeline(layout, load_array("wang2019-3x3")), Pinging(pings)
    timed: list[TimedScan] = []
    token, now_s, end_s = 1, _ORIGIN_S, _ORIGIN_S + duration_s
    while (due_s := max(min(port.next_deadline_s(), pinging.due_s), now_s)) <= end_s:
        now_s = due_s + float(rng.exponential(line.wake_s))
        for arrival in port.advance(now_s):
            if not port.board.running:
                port.receive(encoder.encode(Command("start", 0)), now_s)
                pinging.reset(now_s)
            for item in pipeline.receive(arrival.data, now_s).items:
                timed += item.scans if isinstance(item, ScanRun) else []
        if now_s >= pinging.due_s:
            pinging.sent(now_s)
            pipeline.command("ping", {"token": token}, now_s)
            port.receive(encoder.encode(Command("ping", token)), now_s)
            token += 1
    error_s = np.array([scan.time_s - scans[scan.number].began_s for scan in timed])
    return error_s, np.array([scan.time_sd_s for scan in timed])

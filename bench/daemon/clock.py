"""``./run bench clock``: how true are the instants that scans carry?

The emulated board scans by its own crystal, its line delays, bunches and stalls; the bytes go through the
same decoder and assembler as live ones. Truth is the emulator's record of when each scan began.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.emulator.board.identity import BoardParams
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.simulate import Simulation
from tactiled.plain_table import table
from tactiled.progress import ProgressBar
from tactiled.samples.assembler import Assembler
from tactiled.samples.block import ScanBlock
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Hello, Scan
from tactiled.wire.layout import load_layout

FloatArray = NDArray[np.float64]
SETTLED_S = 10.0  # errors count from here on, as the target is stated


@dataclass(frozen=True)
class Line:
    """A line to be timed over."""

    name: str
    drift_ppm: float
    faults: FaultParams
    rate_hz: float = 100.0


LINES = (
    Line("16 ms bunches, 100 ppm, 0.5 s stalls", 100.0, FaultParams(bunch_s=0.016, stall_per_s=0.1)),
    Line("the same, -100 ppm", -100.0, FaultParams(bunch_s=0.016, stall_per_s=0.1)),
    Line("the same, adapter +20 ppm", -100.0, FaultParams(bunch_s=0.016, stall_per_s=0.1, adapter_ppm=20.0)),
    Line("16 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.016)),
    Line("16 ms bunches, 5 ppm, 50 Hz", 5.0, FaultParams(bunch_s=0.016), rate_hz=50.0),
    Line("10 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.010)),
    Line("1 ms bunches, 5 ppm", 5.0, FaultParams(bunch_s=0.001)),
    Line("no bunches, 100 ppm, 0.5 s stalls", 100.0, FaultParams(stall_per_s=0.1)),
)


def timing(line: Line, seed: int, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Error and stated sigma of every scan's instant.

    Returns
    -------
    error_s, time_sd_s : (n,) float64
    """
    layout = load_layout("board-v1")
    # The board starts on a hand-over of the adapter, so only what follows sets the phase of scans against
    # bunches: steps of the multiplexer that differ by up to 36 x 140 us cover any lattice.
    step_s = float(np.random.default_rng(seed).uniform(60e-6, 200e-6))
    simulation = Simulation(
        load_scene("rest"),
        layout,
        board=BoardParams(drift_ppm=line.drift_ppm, channel_step_s=step_s, rate_hz=line.rate_hz),
        faults=line.faults,
        seed=seed,
        duration_s=duration_s,
    )
    decoder, assembler = Decoder(layout), Assembler(layout)
    blocks: list[ScanBlock] = []
    for arrival_s, data in simulation:
        assembler.read(arrival_s, decoder.bytes_pending)
        for frame in decoder.feed(data):
            if isinstance(frame, Hello):
                assembler.board(frame, arrival_s)
            elif isinstance(frame, Scan):
                assembler.scan(frame, arrival_s)
        blocks += [item for item in assembler.flush() if isinstance(item, ScanBlock)]
    began_s = np.array([scan.began_s for scan in simulation.scans])
    index = np.concatenate([block.index for block in blocks])
    time_s = np.concatenate([block.time_s for block in blocks])
    return time_s - began_s[index], np.concatenate([block.time_sd_s for block in blocks])


def bench_clock(progress: ProgressBar, *, quick: bool) -> str:
    """Table of timing errors over several lines."""
    progress.begin(len(LINES))
    seeds, duration_s = (2 if quick else 10), 60.0
    rows = []
    for line in LINES:
        errors, sigmas = [], []
        for seed in range(seeds):
            error_s, sd_s = timing(line, seed, duration_s)
            errors.append(error_s[int(SETTLED_S * line.rate_hz) :])
            sigmas.append(sd_s[int(SETTLED_S * line.rate_hz) :])
        progress.advance(line.name)
        runs_ms = [1e3 * float(np.sqrt(np.mean(error**2))) for error in errors]
        error_s, sd_s = np.concatenate(errors), np.concatenate(sigmas)
        rows.append(
            [
                line.name,
                f"{1e3 * np.sqrt(np.mean(error_s**2)):.3f}",
                f"{max(runs_ms):.3f}",
                f"{1e3 * np.max(np.abs(error_s)):.2f}",
                f"{1e3 * np.sqrt(np.mean(sd_s**2)):.3f}",
                f"{100 * np.mean(np.abs(error_s) < 2 * sd_s):.0f} %",
                f"{np.sqrt(np.mean((error_s / sd_s) ** 2)):.1f}",
            ]
        )
    head = [
        "line",
        "rms (ms)",
        "worst run's rms",
        "largest error",
        "stated sigma (rms)",
        "within 2 sigma",
        "error / sigma (rms)",
    ]
    title = (
        f"Error of scan instants from {SETTLED_S:g} s on; {seeds} runs (seeds 0..{seeds - 1}) "
        f"of {duration_s:g} s for each line"
    )
    return f"{title}\n\n{table(head, rows)}"

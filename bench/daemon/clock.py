"""``./run bench clock``: how true are the instants that scans carry?

The emulated board scans by its own crystal, its line delays, bunches and stalls; the bytes go through the
same decoder and assembler as live ones. Truth is the emulator's record of when each scan began. Each line is
timed twice: with the daemon's pings, which the board answers, and without.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.daemon.board.pinging import Pinging
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import load_scene
from tactiled.plain_table import table
from tactiled.progress import ProgressBar
from tactiled.samples.assembler import Assembler
from tactiled.samples.block import ScanBlock
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Hello, Scan
from tactiled.wire.layout import load_layout

FloatArray = NDArray[np.float64]
ORIGIN_S = 1000.0
ANSWER_S = (1e-4, 1e-3)  # the emulated board's own
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


def timing(
    line: Line, seed: int, duration_s: float, *, pings: bool = False, answer_s: tuple[float, float] = ANSWER_S
) -> tuple[FloatArray, FloatArray]:
    """Error and stated sigma of every scan's instant.

    Parameters
    ----------
    line : Line
    seed : int
    duration_s : float
    pings : bool
        Ping the board as the daemon does.
    answer_s : tuple of float
        How long the board takes to answer: least and most.

    Returns
    -------
    error_s, time_sd_s : (n,) float64
    """
    layout = load_layout("board-v1")
    # The board starts on a hand-over of the adapter, so only what follows sets the phase of scans against
    # bunches: steps of the multiplexer that differ by up to 36 x 140 us cover any lattice.
    step_s = float(np.random.default_rng(seed).uniform(60e-6, 200e-6))
    scans: list[ScanTruth] = []
    board = EmulatedBoardParams(
        drift_ppm=line.drift_ppm,
        channel_step_s=step_s,
        rate_hz=line.rate_hz,
        boot_count=seed + 1,
        answer_least_s=answer_s[0],
        answer_most_s=answer_s[1],
    )
    port = EmulatedPort(
        load_scene("rest"), layout, power_up_s=ORIGIN_S, board=board, faults=line.faults, seed=seed,
        on_scan=scans.append,
    )  # fmt: skip
    decoder, encoder, assembler = Decoder(layout), Encoder(layout), Assembler(layout)
    pinging = Pinging(pings)
    blocks: list[ScanBlock] = []
    token, end_s = 1, ORIGIN_S + duration_s
    while (now_s := min(port.next_deadline_s(), pinging.due_s)) <= end_s:
        for arrival in port.advance(now_s):
            if not port.board.running:
                port.receive(encoder.encode(Command("start", 0)), now_s)
                pinging.reset(now_s)
            assembler.read(now_s, decoder.bytes_pending)
            for frame in decoder.feed(arrival.data):
                if isinstance(frame, Hello):
                    assembler.board(frame, now_s)
                    assembler.other("hello")
                elif isinstance(frame, Acknowledge):
                    assembler.answered(frame, now_s)
                elif isinstance(frame, Scan):
                    assembler.scan(frame, now_s)
            blocks += [item for item in assembler.flush() if isinstance(item, ScanBlock)]
        if now_s >= pinging.due_s:
            pinging.sent(now_s)
            assembler.pinged(token, now_s)
            port.receive(encoder.encode(Command("ping", token)), now_s)
            token += 1
    began_s = np.array([scan.began_s for scan in scans])
    index = np.concatenate([block.index for block in blocks])
    time_s = np.concatenate([block.time_s for block in blocks])
    return time_s - began_s[index], np.concatenate([block.time_sd_s for block in blocks])


def bench_clock(progress: ProgressBar, *, quick: bool) -> str:
    """Table of timing errors over several lines."""
    progress.begin(len(LINES))
    seeds, duration_s = (2 if quick else 10), 60.0
    rows = []
    for line in LINES:
        row = [line.name]
        for pings in (False, True):
            errors, sigmas = [], []
            for seed in range(seeds):
                error_s, sd_s = timing(line, seed, duration_s, pings=pings)
                errors.append(error_s[int(SETTLED_S * line.rate_hz) :])
                sigmas.append(sd_s[int(SETTLED_S * line.rate_hz) :])
            runs_ms = [1e3 * float(np.sqrt(np.mean(error**2))) for error in errors]
            error_s, sd_s = np.concatenate(errors), np.concatenate(sigmas)
            row += [
                f"{1e3 * np.sqrt(np.mean(error_s**2)):.3f}",
                f"{max(runs_ms):.3f}",
                f"{1e3 * np.max(np.abs(error_s)):.2f}",
                f"{1e3 * np.sqrt(np.mean(sd_s**2)):.3f}",
                f"{np.sqrt(np.mean((error_s / sd_s) ** 2)):.1f}",
            ]
        progress.advance(line.name)
        rows.append(row)
    columns = ["rms (ms)", "worst run", "largest", "sigma", "error / sigma"]
    head = ["line", *columns, *(f"with ping: {column}" for column in columns)]
    title = (
        f"Error of scan instants from {SETTLED_S:g} s on; {seeds} runs (seeds 0..{seeds - 1}) "
        f"of {duration_s:g} s for each line, without and with pings; a board that answers a ping within "
        f"{1e3 * ANSWER_S[0]:g} to {1e3 * ANSWER_S[1]:g} ms"
    )
    return f"{title}\n\n{table(head, rows)}"

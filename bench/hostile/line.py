"""The line and the host behind it: noise, damage, stalls, clocks that are wrong, counters that go on."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.daemon.clock import LineConditions, timing
from bench.daemon.rig import SimulatedLink
from bench.hostile.attack import Attack, Outcome
from tactiled.array import load_array
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.scene.description import load_scene
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Acknowledge, Command, Hello, Scan
from tactiled.wire.layout import load_layout

LAYOUT, ARRAY = load_layout("board-v1"), load_array("wang2019-3x3")
_BACKLOG = 40  # scans that the queue of a port keeps of a stall


def _noise(_folder: Path, scale: float) -> Outcome:
    pipeline, rng, n = Pipeline(LAYOUT, ARRAY), np.random.default_rng(1), round(10.5e6 * scale)
    for k in range(n // 4096 + 1):
        pipeline.receive_data(rng.bytes(4096), 100.0 + 0.4 * k)
    health = pipeline.health()
    counted = health.bytes_framed + health.bytes_discarded + health.bytes_pending
    seen = f"{health.bytes_in} bytes, {health.bytes_in - counted} not accounted for, {health.scans} scans"
    return Outcome(seen, held=health.bytes_in == counted and health.scans == 0)


def _damage(_folder: Path, scale: float) -> Outcome:
    sent, link = _link(FaultParams(flip_per_byte=2e-4), seed=3)
    link.run_until(1000.0 + 120.0 * scale)
    status = link.status()
    lost = len(sent) - status.scans - status.scans_missing  # the last may be on the line, or damaged
    delivered, missing = status.scans, status.scans_missing
    seen = f"{len(sent)} sent, {delivered} delivered, {missing} missing, {status.restarts} restarts"
    return Outcome(seen, held=0 <= lost <= 3 and status.frames_corrupt > 0 and status.restarts == 0)


def _link(faults: FaultParams, seed: int) -> tuple[list[ScanTruth], SimulatedLink]:
    """Scans that the board took, and a link to it in simulated time."""
    sent: list[ScanTruth] = []
    return sent, SimulatedLink(
        load_scene("rest"),
        LAYOUT,
        ARRAY,
        faults=faults,
        seed=seed,
        publish=lambda _: None,
        on_scan=sent.append,
    )


def _stall(away_s: float) -> Outcome:
    """A host that stands still: the queue keeps the first scans, then come a hello, an answer, new scans."""
    encode, away_ticks = Encoder(LAYOUT).encode, round(away_s * 1e6)
    pipeline, hello = Pipeline(LAYOUT, ARRAY), _hello()
    counts = np.full(LAYOUT.n_channels, 1000)

    def scans(first: int, n: int, tick: int) -> bytes:
        return b"".join(
            encode(Scan((first + k) % 65536, counts, (tick + 10_000 * k) % 2**32)) for k in range(n)
        )

    pipeline.receive_data(encode(hello), 100.0)
    for k in range(500):
        pipeline.receive_data(scans(k, 1, 10_000 * k), 100.015 + 0.01 * k)
    back_s = 105.0 + away_s
    pipeline.receive_data(scans(500, _BACKLOG, 5_000_000), back_s)
    pipeline.command("ping", {"token": 1}, back_s + 0.001)
    answer = Acknowledge(1, "ping", "ok", ticks=5_004_000 + away_ticks)
    behind = encode(replace(hello, ticks=5_002_000 + away_ticks)) + encode(answer)
    pipeline.receive_data(behind, back_s + 0.005)
    first = 500 + round(100 * away_s) + 1
    pipeline.receive_data(scans(first, 1, 5_010_000 + away_ticks), back_s + 0.025)
    health = pipeline.health()
    n_lost = first - 500 - _BACKLOG
    seen = f"{health.restarts} restarts, {health.scans_missing} of {n_lost} lost scans counted"
    return Outcome(seen, held=health.restarts == 0 and health.scans_missing == n_lost)


def _hello() -> Hello:
    return Hello(
        board_serial="TS0001",
        array_id="wang2019-3x3",
        rate_hz=100.0,
        adc_bits=12,
        adc_reference_v=3.0,
        channel_offset_s=(0.0,) * LAYOUT.n_channels,
        protocol_version=1,
        firmware_version="test",
        boot_count=1,
        streaming=True,
        ticks=0,
    )


def _clock(_folder: Path, scale: float) -> Outcome:
    line = LineConditions("busy host", -10_000.0, FaultParams(bunch_s=0.016), wake_s=0.005)
    runs = [timing(line, seed, 40.0, pings=True) for seed in range(max(1, round(5 * scale)))]
    errors = np.concatenate([np.abs(error_s / sd_s)[1000:] for error_s, sd_s in runs])
    largest_s = max(float(np.max(np.abs(error_s[1000:]))) for error_s, _ in runs)
    beyond = float(np.mean(errors > 5.0))
    seen = f"{100 * beyond:.1f} % of {len(errors)} scans beyond 5 sd, largest error {1e3 * largest_s:.2f} ms"
    return Outcome(seen, held=beyond == 0.0)


def _commands(_folder: Path, scale: float) -> Outcome:
    """Frames that only the host sends, from the board: they are counted, and change nothing."""
    encode, rng, events = Encoder(LAYOUT).encode, np.random.default_rng(2), list[Event]()
    _, link = _link(FaultParams(), seed=1)
    link.run_until(1003.0)
    before, n = link.status(), round(100_000 * scale)
    names = ("identify", "start", "stop", "ping")
    for k in range(n):
        name = names[int(rng.integers(len(names)))]
        link.link.received(encode(Command(name, k % 256)), link.now_s, events.append)
    after = link.status()
    seen = f"{n} commands, {after.restarts - before.restarts} restarts, board {after.state}"
    return Outcome(seen, held=(after.state, after.restarts, after.scans) == ("running", 0, before.scans))


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "line: noise", "10.5 MB of random bytes", "every byte accounted for; no scan", _noise, short=0.005
    ),
    Attack(
        "line: damaged frames",
        "2 bits in 10,000 bytes flipped, 120 s",
        "sent = delivered + missing; no restart",
        _damage,
        short=0.1,
    ),
    Attack(
        "line: commands from the board",
        "100,000 host commands arrive as if the board sent them",
        "the board runs on; no restart",
        _commands,
        short=0.005,
    ),
    Attack(
        "host: stall of 483 ms",
        "the queue keeps 0.4 s; a hello and an answer to a ping lie behind",
        "no restart; lost scans counted",
        lambda _folder, _scale: _stall(0.483),
    ),
    Attack(
        "host: SIGSTOP of 100 s",
        "the queue keeps 0.4 s; a hello and an answer to a ping lie behind",
        "no restart; lost scans counted",
        lambda _folder, _scale: _stall(100.0),
    ),
    Attack(
        "clock: 1 % fast, busy host",
        "16 ms bunches, read 5 ms late on average, with pings",
        "no scan beyond 5 standard deviations",
        _clock,
        short=0.2,
    ),
)

"""Faults of cables and boards that can be caused in a `DaemonOnPty`."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np
from daemon_on_pty import LAYOUT, RATE_HZ, STALL_S, BoardInThread, DaemonOnPty, Damage
from uart import received_at

from tactiled.emulator.board.firmware import BOOT_S
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultKind
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Corrupt, Hello, Scan

CALM_S = 0.3
_SETTLED_S = 1.2  # the next fault begins when the one before has passed
_LASTING_S = 1.2  # of noise and of a wrong baud rate: the daemon reports a cause after 1 s
_MISSED_SCANS = 30  # a third of a second, much longer than a stall
_SEQUENCE_JUMP = 20_000  # of 65536: far from 0 and from a whole turn
_TICK_JUMP = 1 << 31  # of 2^32 microseconds: half an hour


@dataclass(frozen=True)
class FaultSpan:
    """First and last instant of a fault, on the host's monotonic clock."""

    begin_s: float
    end_s: float


FaultPlay = Callable[[DaemonOnPty], Awaitable[FaultSpan]]


@dataclass(frozen=True)
class FaultCase:
    """A fault, and what the daemon must count of it.

    Attributes
    ----------
    restarts : int
        Number of times that the board counts from 0 again.
    overruns : int
        Scans that the board misses itself and flags; the daemon must count exactly these as such.
    calm_s : float
        Time without fault before it.
    """

    name: str
    play: FaultPlay
    restarts: int = 0
    overruns: int = 0
    calm_s: float = CALM_S


def _brief(kind: FaultKind, lasts_s: float = 0.0) -> FaultPlay:
    async def play(daemon: DaemonOnPty) -> FaultSpan:
        now_s = time.monotonic()
        daemon.board.emulator.inflict(kind)
        if kind == "stall":
            await daemon.until_status("stalled")
        return FaultSpan(now_s, now_s + lasts_s)

    return play


async def _miss_scans(daemon: DaemonOnPty) -> FaultSpan:
    """Let the board miss scans, as firmware or a host that is too slow."""
    now_s = time.monotonic()
    for _ in range(_MISSED_SCANS):
        daemon.board.emulator.inflict("overrun")
    return FaultSpan(now_s, now_s + _MISSED_SCANS / RATE_HZ)


_stall = _brief("stall", STALL_S)


async def _unplug(daemon: DaemonOnPty) -> FaultSpan:
    """Unplug and plug in again under the same name; the board runs on."""
    begin_s, n = time.monotonic(), len(daemon.board.plugged_s)
    daemon.board.emulator.inflict("unplug")
    while len(daemon.board.plugged_s) == n:
        await asyncio.sleep(0.001)
    return FaultSpan(begin_s, daemon.board.plugged_s[-1])


async def _unplug_stalled(daemon: DaemonOnPty) -> FaultSpan:
    begin_s = (await _stall(daemon)).begin_s
    return FaultSpan(begin_s, (await _unplug(daemon)).end_s)


async def _unplug_syncing(daemon: DaemonOnPty) -> FaultSpan:
    """Come back without sending, and be unplugged again while the daemon waits for the identity."""
    begin_s, daemon.board.link.damage = time.monotonic(), lambda _: b""
    await _unplug(daemon)
    await daemon.until_status("syncing")
    second = asyncio.create_task(_unplug(daemon))
    await daemon.until_status("no-device")
    daemon.board.link.damage = None
    return FaultSpan(begin_s, (await second).end_s)


async def _unplug_at_once(daemon: DaemonOnPty) -> FaultSpan:
    """Unplug again at the instant that the board is back, as a loose plug does."""
    begin_s = (await _unplug(daemon)).begin_s
    return FaultSpan(begin_s, (await _unplug(daemon)).end_s)


def _other_board(*, stays_open: bool) -> FaultPlay:
    """Plug in another board, which the daemon refuses by its name, then the right one.

    The other is pulled before that, or is still open when the right board takes its name.
    """

    async def play(daemon: DaemonOnPty) -> FaultSpan:
        other = BoardInThread(daemon.path, EmulatedBoardParams(board_serial="TS0666"))
        right = asyncio.create_task(_unplug(daemon))
        await daemon.until_status("no-device")
        with other:
            await daemon.until_status("fault", "" if stays_open else "TS0666 is plugged in")
            if stays_open:
                await daemon.until_fresh_scan((await right).end_s)
        return await right

    return play


def _garbled(damage: Damage, reason: str) -> FaultPlay:
    async def play(daemon: DaemonOnPty) -> FaultSpan:
        begin_s, daemon.board.link.damage = time.monotonic(), damage
        await daemon.until_status("stalled", reason)
        await asyncio.sleep(begin_s + _LASTING_S - time.monotonic())
        daemon.board.link.damage = None
        return FaultSpan(begin_s, time.monotonic())

    return play


def _noise() -> Damage:
    rng = np.random.default_rng(1)
    return lambda data: rng.bytes(len(data))


class _CounterJump:
    """Frames whose counters jump once, as of firmware that resets a counter without a boot."""

    def __init__(self, sequence: int = 0, ticks: int = 0) -> None:
        self._sequence, self._ticks = sequence, ticks
        self._decoder, self._encoder = Decoder(LAYOUT), Encoder(LAYOUT)

    def __call__(self, data: bytes) -> bytes:
        out = b""
        for frame in self._decoder.feed(data):
            if isinstance(frame, Corrupt):
                continue
            if isinstance(frame, Scan):
                sequence = (frame.sequence + self._sequence) % (1 << 16)
                frame = Scan(sequence, frame.counts, self._jumped(frame.ticks), frame.flags)
            elif isinstance(frame, Hello):
                frame = Hello(**vars(frame) | {"ticks": self._jumped(frame.ticks)})
            out += self._encoder.encode(frame)
        return out

    def _jumped(self, ticks: int | None) -> int:
        return ((ticks or 0) + self._ticks) % (1 << 32)


def _counters_jump(sequence: int = 0, ticks: int = 0) -> FaultPlay:
    async def play(daemon: DaemonOnPty) -> FaultSpan:
        """Jump to the new counters, or back to the old ones, in turn."""
        link, now_s = daemon.board.link, time.monotonic()
        link.damage = _CounterJump(sequence, ticks) if link.damage is None else None
        return FaultSpan(now_s, now_s)

    return play


def _wrong_baud(data: bytes) -> bytes:
    return received_at(data, LAYOUT.file.baud, 57_600)[0]


CASES = (
    FaultCase("a bit flips", _brief("flip")),
    FaultCase("a byte is lost", _brief("drop")),
    FaultCase("a frame is cut", _brief("cut")),
    FaultCase("a frame comes twice", _brief("duplicate")),
    FaultCase("burst of noise, 40 bytes", _brief("burst")),
    FaultCase("the board misses a scan", _brief("overrun"), overruns=1),
    FaultCase(f"the board misses {_MISSED_SCANS} scans", _miss_scans, overruns=_MISSED_SCANS),
    FaultCase(f"stall of {STALL_S:g} s", _stall),
    FaultCase("noise for 1.2 s", _garbled(_noise(), "no frame")),
    FaultCase("wrong baud for 1.2 s", _garbled(_wrong_baud, "baud")),
    FaultCase("the board reboots", _brief("reboot", BOOT_S), restarts=1),
    FaultCase("its sequence jumps", _counters_jump(sequence=_SEQUENCE_JUMP), restarts=1),
    FaultCase("its ticks jump", _counters_jump(ticks=_TICK_JUMP), restarts=1),
    FaultCase("unplugged while running", _unplug, calm_s=_SETTLED_S),
    FaultCase("unplugged while stalled", _unplug_stalled, calm_s=_SETTLED_S),
    FaultCase("unplugged while syncing", _unplug_syncing, calm_s=_SETTLED_S),
    FaultCase("unplugged, back, unplugged", _unplug_at_once, calm_s=_SETTLED_S),
    FaultCase(
        "a wrong board, then the right one",
        _other_board(stays_open=False),
        calm_s=_SETTLED_S,
    ),
    FaultCase(
        "the same, the wrong one still open",
        _other_board(stays_open=True),
        calm_s=_SETTLED_S,
    ),
)

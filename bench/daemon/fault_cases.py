"""What happens to cables and boards, each as something that can be done to a `Stage`."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np

from bench.daemon.stage import LAYOUT, RATE_HZ, STALL_S, BoardInThread, Damage, Stage
from bench.daemon.uart import heard
from tactiled.emulator.board.firmware import BOOT_S
from tactiled.emulator.line.faults import FaultKind
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Corrupt, Hello, Scan

CALM_S = 0.3
_SETTLED_S = 1.2  # a port that was open for 1 s is tried again quickly
_LASTING_S = 1.2  # of noise and of a wrong baud rate: a cause is named after 1 s
_HELD_UP_SCANS = 30  # a third of a second: far beyond what is called a stall
_SEQUENCE_JUMP = 20_000  # of 65536: nearest neither to 0 nor to a whole turn
_TICK_JUMP = 1 << 31  # of 2^32 microseconds: half an hour


@dataclass(frozen=True)
class Span:
    """When a fault was there, on the host's monotonic clock."""

    begin_s: float
    end_s: float


Play = Callable[[Stage], Awaitable[Span]]


@dataclass(frozen=True)
class Case:
    """A fault, and what it may cost by itself.

    Attributes
    ----------
    scans_hit : int or None
        Scans that it destroys; None: all that were taken while it lasted, or were on their way.
    restarts : int
        How often the board counts anew by it.
    overruns : int
        Scans that the board misses itself and flags; the daemon must count exactly these as such.
    counts : bool
        Whether the daemon can know how many were lost: not over a boot, nor where another board came between.
    times : int
    calm_s : float
        All must have been well for so long before it is done.
    """

    name: str
    play: Play
    scans_hit: int | None = None
    restarts: int = 0
    overruns: int = 0
    counts: bool = True
    times: int = 10
    calm_s: float = CALM_S


def _brief(kind: FaultKind) -> Play:
    async def play(stage: Stage) -> Span:
        now_s = time.monotonic()
        stage.board.emulator.inflict(kind)
        return Span(now_s, now_s)

    return play


async def _held_up(stage: Stage) -> Span:
    """The board, or the host that emulates it, is too slow for a while."""
    now_s = time.monotonic()
    for _ in range(_HELD_UP_SCANS):
        stage.board.emulator.inflict("overrun")
    return Span(now_s, now_s + _HELD_UP_SCANS / RATE_HZ)


async def _stall(stage: Stage) -> Span:
    now_s = time.monotonic()
    stage.board.emulator.inflict("stall")
    await stage.until_said("stalled")
    return Span(now_s, now_s + STALL_S)


async def _reboot(stage: Stage) -> Span:
    now_s = time.monotonic()
    stage.board.emulator.inflict("reboot")
    return Span(now_s, now_s + BOOT_S)


async def _unplug(stage: Stage) -> Span:
    """Out, and back under the same name; the board runs on."""
    begin_s, n = time.monotonic(), len(stage.board.plugged_s)
    stage.board.emulator.inflict("unplug")
    while len(stage.board.plugged_s) == n:
        await asyncio.sleep(0.001)
    return Span(begin_s, stage.board.plugged_s[-1])


async def _unplug_stalled(stage: Stage) -> Span:
    begin_s = (await _stall(stage)).begin_s
    return Span(begin_s, (await _unplug(stage)).end_s)


async def _unplug_syncing(stage: Stage) -> Span:
    """It comes back mute, and is pulled again while the daemon still asks who it is."""
    begin_s, stage.board.link.damage = time.monotonic(), lambda _: b""
    await _unplug(stage)
    await stage.until_said("syncing")
    second = asyncio.create_task(_unplug(stage))
    await stage.until_said("no-device")
    stage.board.link.damage = None
    return Span(begin_s, (await second).end_s)


async def _unplug_at_once(stage: Stage) -> Span:
    """A loose plug: out again in the moment that it is back."""
    begin_s = (await _unplug(stage)).begin_s
    return Span(begin_s, (await _unplug(stage)).end_s)


async def _other_board(stage: Stage) -> Span:
    """Another board in its place, refused by its name and pulled; then the right one."""
    other = BoardInThread(stage.path, "TS0666")
    right = asyncio.create_task(_unplug(stage))
    await stage.until_said("no-device")
    with other:
        await stage.until_said("fault", "TS0666 is plugged in")
    return await right


async def _swapped(stage: Stage) -> Span:
    """The right board takes the name while the wrong one is still open."""
    other = BoardInThread(stage.path, "TS0666")
    right = asyncio.create_task(_unplug(stage))
    await stage.until_said("no-device")
    with other:
        await stage.until_said("fault")
        span = await right
        await stage.until_fresh_scan(span.end_s)
    return span


def _garbled(damage: Damage, says: str) -> Play:
    async def play(stage: Stage) -> Span:
        begin_s, stage.board.link.damage = time.monotonic(), damage
        await stage.until_said("stalled", says)
        await asyncio.sleep(begin_s + _LASTING_S - time.monotonic())
        stage.board.link.damage = None
        return Span(begin_s, time.monotonic())

    return play


def _noise() -> Damage:
    rng = np.random.default_rng(1)
    return lambda data: rng.bytes(len(data))


class _CountsAnew:
    """Frames whose counters jump once, as those of firmware that sets one back and does not boot."""

    def __init__(self, sequence: int = 0, ticks: int = 0) -> None:
        self._sequence, self._ticks = sequence, ticks
        self._decoder, self._encoder = Decoder(LAYOUT), Encoder(LAYOUT)

    def __call__(self, data: bytes) -> bytes:
        out = b""
        for frame in self._decoder.feed(data):
            if isinstance(frame, Scan):
                frame = Scan(
                    (frame.sequence + self._sequence) % (1 << 16),
                    frame.counts,
                    ((frame.ticks or 0) + self._ticks) % (1 << 32),
                    frame.flags,
                )
            elif isinstance(frame, Hello):
                frame = Hello(**vars(frame) | {"ticks": ((frame.ticks or 0) + self._ticks) % (1 << 32)})
            if not isinstance(frame, Corrupt):
                out += self._encoder.encode(frame)
        return out


def _counts_anew(sequence: int = 0, ticks: int = 0) -> Play:
    async def play(stage: Stage) -> Span:
        """Each second time, back to what it was: a jump as well."""
        now_s = time.monotonic()
        stage.board.link.damage = _CountsAnew(sequence, ticks) if stage.board.link.damage is None else None
        return Span(now_s, now_s)

    return play


_BAUD = LAYOUT.file.baud
CASES = (
    Case("a bit flips", _brief("flip"), 1),
    Case("a byte is lost", _brief("drop"), 1),
    Case("a frame is cut", _brief("cut"), 1),
    Case("a frame comes twice", _brief("duplicate"), 0),
    Case("burst of noise, 40 bytes", _brief("burst"), 1),
    Case("the board misses a scan", _brief("overrun"), 1, overruns=1),
    Case(f"the board misses {_HELD_UP_SCANS} scans", _held_up, overruns=_HELD_UP_SCANS),
    Case(f"stall of {STALL_S:g} s", _stall, 0),
    Case("noise for 1.2 s", _garbled(_noise(), "no frame"), times=5),
    Case("wrong baud for 1.2 s", _garbled(lambda data: heard(data, _BAUD, 57_600)[0], "baud"), times=5),
    Case("the board reboots", _reboot, restarts=1, counts=False),
    Case("its sequence jumps", _counts_anew(sequence=_SEQUENCE_JUMP), 0, restarts=1),
    Case("its ticks jump", _counts_anew(ticks=_TICK_JUMP), 0, restarts=1),
    Case("unplugged while running", _unplug, times=5, calm_s=_SETTLED_S),
    Case("unplugged while stalled", _unplug_stalled, times=5, calm_s=_SETTLED_S),
    Case("unplugged while syncing", _unplug_syncing, times=5, calm_s=_SETTLED_S),
    Case("unplugged, back, unplugged", _unplug_at_once, times=5, calm_s=_SETTLED_S),
    Case("a wrong board, then the right one", _other_board, counts=False, times=5, calm_s=_SETTLED_S),
    Case("the same, the wrong one still open", _swapped, counts=False, times=5, calm_s=_SETTLED_S),
)

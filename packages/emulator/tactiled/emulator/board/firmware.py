"""The board's firmware, sans-I/O: bytes and instants in, frames with the instants when they are ready out.

States, as ``protocols/board.md`` requires:

::

    off --power_up--> boot --50 ms--> idle (hello at once, then each second)
                                      idle --start--> running --stop--> idle

A layout without commands runs from the end of boot; one without hello is silent while idle. Rules:

1. A command is answered in any state after boot, also when it changes nothing: start while running and
   stop while idle are ``ok``. A type that the layout does not contain is ``unknown_command``.
2. A command repeated with its token (because the answer was lost) gets the same answer and is not carried
   out again; only the hello that `identify` asks for is sent again.
3. ``set_rate`` takes effect at once, running or idle; a rate whose frames do not fit the line, or that leaves
   no time to sample all channels, is a ``bad_argument``.
4. The sequence number counts every scan instant since power-up, missed ones included; a scan that ``stop``,
   ``set_rate`` or a reset interrupts does not count.
5. Bytes that arrive during boot, or are no frame, are ignored.
6. A ping takes its time on the line and until the main loop of the firmware comes round; then the tick is
   read and the answer is ready. Other commands take effect at once, so that a scene begins with ``start``.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import Crystal, Scanning, ScanSource, ScanTruth
from tactiled.errors import ConfigError, ContractError
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello, Scan
from tactiled.wire.layout import Layout

BOOT_S = 0.05  # power-up to the first hello: clocks settle, the ADC calibrates
HELLO_PERIOD_S = 1.0
# Part of the line for scans; acknowledgements and hellos need the rest, or they would queue up without end.
_LINE_SHARE = 0.95
_SLOWEST_HZ = 0.1  # at a lower rate the host cannot tell a stall


class Outgoing(NamedTuple):
    """A frame and the true instant at which the board can begin to send it."""

    ready_s: float
    data: bytes


class Board:
    """An emulated board, whose source is read in scene time and which calls `on_scan` for each scan instant.

    The constructor raises `ConfigError` where the board cannot keep the rate after power-up, that of `hello`,
    or the layout cannot carry what `hello` says.
    """

    def __init__(
        self,
        layout: Layout,
        hello: Hello,
        params: EmulatedBoardParams,
        source: ScanSource,
        *,
        power_up_s: float,
        on_scan: Callable[[ScanTruth], None],
    ) -> None:
        self._layout = layout
        self._hello = hello
        self._drift_ppm = params.drift_ppm
        self._answer_s = (params.answer_least_s, max(params.answer_least_s, params.answer_most_s))
        self._ping_s = 10 * layout.wire_bytes("ping") / layout.file.baud if layout.has("ping") else 0.0
        self._rng = np.random.default_rng(hello.boot_count)
        self._source = source
        self._on_scan = on_scan
        self._encoder = Encoder(layout)
        self._decoder = Decoder(layout, "host-to-board")
        self._offset_s = np.array(hello.channel_offset_s or [0.0] * layout.n_channels)
        self._sequence_bits = layout.bits("scan", "sequence") or 16
        self._boot_bits = layout.bits("hello", "boot_count") or 16
        if fault := self._misfit(hello.rate_hz):
            raise ConfigError("board", [fault])
        # True instant of scene time 0, which is the first start.
        self.scene_start_s: float | None = None
        self._index = 0
        self._out: list[Outgoing] = []
        self._answers: dict[Command, str] = {}
        self._scanning: Scanning | None = None
        self._boot_count = hello.boot_count % (1 << self._boot_bits)
        self._power_up(power_up_s, params.start_ticks, params.start_sequence)
        if layout.has("hello"):
            try:
                self._encoder.encode(self._present(power_up_s))
            except ContractError as error:
                raise ConfigError("board", [str(error)]) from None

    @property
    def running(self) -> bool:
        return self._scanning is not None

    def next_deadline_s(self) -> float:
        """True instant of the next event in `advance`."""
        due_s = self._next_hello_s if self._scanning is None else self._scanning.end_s
        return min(due_s, self._pongs[0][0]) if self._pongs else due_s

    def advance(self, now_s: float) -> list[Outgoing]:
        """Advance to an instant and return the frames that became ready, in order."""
        while (due_s := self.next_deadline_s()) <= now_s:
            if self._pongs and self._pongs[0][0] <= due_s:
                self._acknowledge(*self._pongs.popleft()[1], due_s)
            elif self._scanning is None:
                self._idle(due_s)
            else:
                self._scan(self._scanning, due_s)
        out, self._out = self._out, []
        return out

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host; answers come with the next `advance`."""
        self._out = self.advance(now_s)
        if now_s < self._boot_end_s:
            return
        for item in self._decoder.feed(data):
            if isinstance(item, Command):
                # Commands without token are not answered, and carried out each time.
                known = self._answers if self._layout.has("acknowledge") else {}
                result = known.get(item) or self._obey(item, now_s)
                if item.name == "identify":
                    self._send_hello(now_s)
                self._answers = {item: result}  # only the newest: the host has one command under way
                if item.name == "ping" and result == "ok":
                    took_s = self._ping_s + float(self._rng.uniform(*self._answer_s))
                    before_s = self._pongs[-1][0] if self._pongs else now_s
                    self._pongs.append((max(before_s, now_s + took_s), (item, result)))
                else:
                    self._acknowledge(item, result, now_s)

    def reboot(self, now_s: float) -> None:
        """Reset: ticks, sequence, rate and state are reset; unsent frames are lost."""
        self.advance(now_s)
        self._boot_count = (self._boot_count + 1) % (1 << self._boot_bits)
        self._power_up(now_s, start_ticks=0, start_sequence=0)

    def miss_scan(self, now_s: float) -> None:
        """Miss the next scan instant, as delayed firmware does; an idle board misses none."""
        self._out = self.advance(now_s)
        self._to_miss += self.running

    def _power_up(self, now_s: float, start_ticks: int, start_sequence: int) -> None:
        tick_s, bits = self._layout.tick_s or 1e-6, self._layout.bits("scan", "ticks") or 32
        self._crystal = Crystal(now_s, self._drift_ppm, tick_s, bits, start_ticks)
        self._rate_hz = self._hello.rate_hz
        self._sequence = start_sequence % (1 << self._sequence_bits)
        self._boot_end_s = self._next_hello_s = now_s + BOOT_S
        self._to_miss = 0
        self._overrun = False
        self._answers = {}
        # Answers to pings, with the instant of each.
        self._pongs: deque[tuple[float, tuple[Command, str]]] = deque()
        self._scanning = None
        self._first_after_start = False
        self._out = []
        self._decoder.reset()

    def _idle(self, now_s: float) -> None:
        """Act at the end of boot, and each second while idle."""
        if self._layout.has("hello"):
            self._send_hello(now_s)
        self._next_hello_s = now_s + HELLO_PERIOD_S
        if not self._layout.has("start"):
            self._start(now_s)

    def _obey(self, command: Command, now_s: float) -> str:
        if command.name == "start" and not self.running:
            self._start(now_s)
        elif command.name == "stop" and self.running:
            self._scanning = None
            self._next_hello_s = now_s + HELLO_PERIOD_S
        elif command.name == "set_rate":
            if command.rate_hz is None or self._misfit(command.rate_hz):
                return "bad_argument"
            self._rate_hz = command.rate_hz
            if self._scanning is not None:
                self._scan_from(now_s)
        elif command.name not in ("start", "stop", "ping", "identify"):
            return "unknown_command"
        return "ok"

    def _start(self, now_s: float) -> None:
        self._first_after_start = True
        self._scan_from(now_s)

    def _scan_from(self, now_s: float) -> None:
        if self.scene_start_s is None:
            self.scene_start_s = now_s
        self._scanning = Scanning(
            self._source,
            self._crystal,
            self._offset_s,
            rate_hz=self._rate_hz,
            begin_s=now_s,
            scene_start_s=self.scene_start_s,
        )

    def _scan(self, scanning: Scanning, end_s: float) -> None:
        """Sample all channels at a scan instant, or miss it."""
        begin_board_s, scene_s = scanning.begin_board_s, scanning.scene_s
        counts = scanning.take(self._index)
        began_s = self._crystal.true_s(begin_board_s)
        is_missed = self._to_miss > 0
        if is_missed:
            self._to_miss -= 1
            self._overrun = True
        else:
            flags = self._layout.flag("first_after_start") * self._first_after_start
            flags |= self._layout.flag("overrun") * self._overrun
            self._send(Scan(self._sequence, counts, self._crystal.ticks(begin_board_s), flags), end_s)
            self._first_after_start = self._overrun = False
        truth = ScanTruth(self._index, self._sequence, self._boot_count, began_s, scene_s, not is_missed)
        self._on_scan(truth)
        self._index += 1
        self._sequence = (self._sequence + 1) % (1 << self._sequence_bits)

    def _misfit(self, rate_hz: float) -> str:
        """Say why the board cannot keep a rate; empty where it can."""
        baud, last_s = self._layout.file.baud, float(self._offset_s.max())
        if not rate_hz >= _SLOWEST_HZ:  # also NaN, where a layout has floats
            return f"rate_hz: {rate_hz:g} scans a second are less than {_SLOWEST_HZ:g}"
        if rate_hz * 10 * self._layout.wire_bytes("scan") / baud > _LINE_SHARE:
            return f"rate_hz: {rate_hz:g} scans a second do not fit {baud} baud"
        if rate_hz * last_s > 1.0:
            return f"channel_step_s: a scan of {last_s:g} s is longer than a period of {1 / rate_hz:g} s"
        return ""

    def _present(self, now_s: float) -> Hello:
        state = {"boot_count": self._boot_count, "rate_hz": self._rate_hz, "streaming": self.running}
        return Hello(**vars(self._hello) | state | {"ticks": self._ticks(now_s)})

    def _send_hello(self, now_s: float) -> None:
        self._send(self._present(now_s), now_s)

    def _acknowledge(self, command: Command, result: str, now_s: float) -> None:
        if self._layout.has("acknowledge") and result in self._layout.file.results:
            self._send(Acknowledge(command.token, command.name, result, self._ticks(now_s)), now_s)

    def _ticks(self, now_s: float) -> int:
        return self._crystal.ticks(self._crystal.board_s(now_s))

    def _send(self, frame: Frame, ready_s: float) -> None:
        self._out.append(Outgoing(ready_s, self._encoder.encode(frame)))

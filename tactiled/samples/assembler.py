"""Scan frames to runs of timed scans and gaps: counting and timing."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from tactiled.array import Array
from tactiled.errors import ContractError
from tactiled.samples.block import Conversion, Gap, GapCause, ScanRun, TimedScan
from tactiled.samples.clock import STEEPEST_PPM, ClockFit, ClockParams
from tactiled.samples.fast import ScanCounter
from tactiled.tomlfile import Params
from tactiled.wire.frames import Acknowledge, Hello, Scan
from tactiled.wire.layout import Layout

# Standard deviation before the first scan: thirty years, because messages carry no infinity.
NO_CLOCK_SD_S = 1e9


class SampleParams(Params):
    """Parameters of the conversion from frames to scans."""

    late_after_s: float = Field(
        default=0.1,
        gt=0,
        description="a scan handled later than this after it was taken is late: no slip is valid on it",
    )
    transfer: Literal["line", "none"] = Field(
        default="line",
        description="line: a frame takes the time of its bytes at the baud rate; none: whole frames by USB",
    )
    clock: ClockParams = ClockParams()


@dataclass
class SampleCounts:
    """Counts of scans by what became of them."""

    scans: int = 0
    missing: int = 0
    overrun: int = 0  # of `missing`: not taken by the board, by the flag ``overrun`` of the next scan
    dropped: int = 0  # of `missing`: explained by no damaged byte, interruption or flag
    duplicate: int = 0
    restarts: int = 0


class Assembler:
    """Assemble scan frames into runs of scans and gaps.

    Call `read` for each read of the port, feed `scan`, `corrupt`, `answered` and `other` in the order of the
    stream, and `take` what they completed. No method reads a clock: `now_s` is the time at which bytes
    were handed over (host monotonic seconds).

    Parameters
    ----------
    baud : int
        Baud rate of the line; 0 for that of the layout.
    live : bool
        Events are acted on as they come. Otherwise no scan counts as late.
    array : Array, optional
        Has the unit and the range of the readings, and the channels for which the largest count of the
        converter is rest; for others it is a saturated reading. Without it, all finite volts are valid.
    """

    LARGEST_LEAD_S = 0.05  # largest error of the clock fit towards the future
    LEAST_STEP_S = 1e-6  # least difference of two instants: one tick
    SPARE_PART = 0.05  # share of the line that scans never fill (protocols/board.md)
    # Unanswered pings that are kept: a stalled line may hold back answers for some seconds.
    MOST_PINGS = 16
    # A read that comes after less than this part of the wait before it follows a read that was late.
    TIMELY_PART = 0.9

    def __init__(
        self,
        layout: Layout,
        params: SampleParams | None = None,
        baud: int = 0,
        *,
        live: bool = True,
        array: Array | None = None,
    ) -> None:
        self._layout = layout
        self._live = live
        self._array = array
        self._params = params or SampleParams()
        self._clock = self._params.clock
        if layout.measures_rate:  # the clock of the board has no nominal rate that it could deviate from
            self._clock = self._clock.model_copy(update={"max_drift_ppm": STEEPEST_PPM})
        self._wire_s: dict[str, float] = {}  # seconds on the wire by message; empty where they take none
        if self._params.transfer == "line":  # start, eight data, stop bits
            byte_s = 10 / (baud or layout.file.baud)
            self._wire_s = {name: byte_s * layout.wire_bytes(name) for name in layout.messages}
        self._frame_s = self._wire_s.get("scan", 0.0)
        self._counts_scans = layout.counts_scans
        self._fault_flag = layout.flag("reference_fault")
        self._overrun_flag = layout.flag("overrun")
        self._start_flag = layout.flag("first_after_start")
        self.reset()

    def reset(self) -> None:
        """Forget board, counters and clock."""
        self._hello: Hello | None = None
        self._handover_s: float | None = None
        self._index = -1
        self.counts = SampleCounts()
        self._scans: list[TimedScan] = []  # of a run that is not closed
        self._out: list[ScanRun | Gap] = []
        self._n_corrupt = 0
        self._restart_seen = False
        self._pending_gap: GapCause | None = None
        self._read_s = -np.inf
        self._since_read_s = np.inf  # time from the read before to the newest one
        self._waited_s = np.inf  # the same; infinity where the read before was late
        self._whole = True
        self._not_before_s = -np.inf
        self._newest_s = -np.inf
        self._newest_sd_s = NO_CLOCK_SD_S
        self._fit: ClockFit | None = None
        self._queued_s = 0.0
        self._begun: tuple[float, int] | None = None  # the read before: when, and bytes of a frame at its end
        self._pings: dict[int, float] = {}
        self._is_confirmed = True  # False: what the fit is made from may be an earlier run of the board
        self._counter = ScanCounter(
            self._layout.bits("scan", "sequence") or 16,
            self._layout.bits("scan", "ticks"),
            self._layout.tick_s,
        )

    @property
    def rate_hz(self) -> float:
        """Scan rate of the board's hello in hertz; 0.0 before any."""
        return self._hello.rate_hz if self._hello else 0.0

    @property
    def newest(self) -> tuple[float, float]:
        """Instant of the newest scan and its standard deviation; -inf and `NO_CLOCK_SD_S` before any."""
        return self._newest_s, self._newest_sd_s

    @property
    def drift_ppm(self) -> float:
        """Rate of the board clock against the host clock, parts per million."""
        return self._fit.drift_ppm if self._fit else 0.0

    @property
    def clock_warning(self) -> str:
        """Fault of the board's clock, and the option to set for it; empty for none."""
        return self._fit.warning if self._fit else ""

    def board(self, hello: Hello, now_s: float) -> None:
        """Take the hello of the board; a new boot, a new rate or another board begins a new run.

        The reboot of a board that does not count its boots shows in its ticks, which begin at zero again.
        """
        old = self._hello
        restart_seen, self._restart_seen = self._restart_seen, False
        if old is not None and replace(hello, streaming=old.streaming, ticks=old.ticks) == old:
            # The host may have been suspended while a board that counts its boots went on; whether its
            # sequence number has, too, the next scan shows.
            may_sleep, ticks = hello.boot_count != 0, hello.ticks
            if ticks is not None and not self._counter.runs_on(ticks, now_s, host_may_sleep=may_sleep):
                self.counts.restarts += 1
                self._new_run("restart")
            return
        self._close_run()  # its scans are those of the board as it was
        self._hello = hello
        array, in_units = self._array, self._layout.carries_units
        in_counts = array is not None and array.unit == "count"
        rests_at_full = np.zeros(self._layout.n_channels, np.int64)
        if array is not None:
            rests_at_full += array.falls_under_load
        conversion = self._conversion = Conversion(
            hello,
            1.0 if in_units or in_counts else hello.volts_per_count,
            None if in_units else 2**hello.adc_bits - 1 + rests_at_full,
            np.array(hello.channel_offset_s or (0.0,) * self._layout.n_channels),
            self._fault_flag,
            np.isfinite if array is None else array.in_range,
        )
        period_s = 1 / hello.rate_hz
        self._spare_s = max(period_s - self._frame_s, self.SPARE_PART * period_s)
        if old is not None:
            same_board = hello.board_serial == old.board_serial
            same_run = same_board and hello.boot_count == old.boot_count
            # A restart that scans have shown before this hello is counted already.
            self.counts.restarts += same_board and not same_run and not restart_seen
            self._new_run("rate" if same_run else "restart")
        self._fit = ClockFit(self._clock, self._frame_s + float(conversion.channel_offset_s.max()))
        self.adapter(self._handover_s)

    def adapter(self, handover_s: float | None) -> None:
        """Take the latency timer of the adapter (None: unknown); a configured value takes precedence."""
        self._handover_s = handover_s
        if self._fit is not None and self._params.clock.handover_s is None:
            self._fit.handover_s = handover_s

    def interrupt(self, cause: GapCause) -> None:
        """Close the run, and put a Gap before the next scan.

        The counters of the board are followed across it, so that the gap has a count if the board ran on.
        """
        self._close_run()
        self._pending_gap = cause
        if cause == "disconnect":
            self._is_confirmed = False
            if not self._layout.counts_scans:  # nobody knows how many scans it lasted
                self._new_clock()

    def _new_run(self, cause: GapCause) -> None:
        """Begin a new run of counters and clock."""
        self.interrupt(cause)
        self._new_clock()

    def _new_clock(self) -> None:
        self._counter.reset()
        self._not_before_s = -np.inf  # instants of the old run do not bound those of the new one
        self._is_confirmed = True
        self._pings.clear()
        if self._fit:
            self._fit.reset()

    def read(self, now_s: float, bytes_pending: int) -> None:
        """Begin a read of the port, before which `bytes_pending` bytes of a frame were received.

        Calls with the same `now_s` belong to one read. The time of a late read (the process slept, or the
        line stalled) does not show when its bytes were handed over, so the wait of the next read counts as
        unknown.
        """
        if now_s > self._read_s:
            since_read_s = now_s - self._read_s
            is_timely = since_read_s > self.TIMELY_PART * self._since_read_s
            self._waited_s = since_read_s if is_timely else np.inf
            is_begun = 0 < bytes_pending < self._layout.wire_bytes("scan")
            # A frame that takes no time on the line may be complete at any instant between the two reads.
            self._begun = (self._read_s, bytes_pending) if is_begun and self._frame_s > 0 else None
            self._since_read_s, self._read_s = since_read_s, now_s
            self._whole = bytes_pending == 0

    def corrupt(self) -> None:
        """Take note of a damaged frame, the cause of scans that turn out to be missing here."""
        self._n_corrupt += 1
        self.other("hello")  # it may have been a hello, the longest message

    def other(self, name: str) -> None:
        """Account for a message other than a scan, which delays the scans behind it on the line."""
        self._queued_s += self._wire_s.get(name, 0.0)
        self._begun = None

    def pinged(self, token: int, now_s: float) -> None:
        """Take note of a ping that is about to be sent; `now_s` is before its first byte."""
        self._pings[token] = now_s
        if len(self._pings) > self.MOST_PINGS:
            del self._pings[next(iter(self._pings))]

    def answered(self, answer: Acknowledge, now_s: float) -> None:
        """Take an answer to a command; that to a ping has ticks which were read during the round trip.

        A board that was switched off and on may have counters that fit those before, as if its scans had
        waited on the line: they count as late. The next answer decides, as it cannot be older than its ping.
        A board is another run only where its scans and the answer are late alike: counters that go on are no
        restart, however the host stalled.
        """
        self.other("acknowledge")
        if answer.command != "ping" or answer.result != "ok":
            return
        sent_s = self._pings.pop(answer.token, None)
        if sent_s is None or answer.ticks is None or self._fit is None or self._hello is None:
            return
        board_s = self._counter.board_s_at(answer.ticks, now_s)
        if board_s is None:
            return
        # Ping and answer occupy the line; ticks give the beginning of a tick, not the time within it.
        earliest_s = sent_s + self._wire_s.get("ping", 0.0) - self._counter.tick_s
        late_after_s = self._params.late_after_s
        is_late = self._counter.age_s > late_after_s
        if not self._is_confirmed and is_late and self._fit.is_behind(board_s, earliest_s - late_after_s):
            self.counts.restarts += 1
            self._new_run("restart")
            return
        self._is_confirmed = True
        self._fit.answered(board_s, earliest_s, now_s - self._wire_s.get("acknowledge", 0.0))

    def scan(self, scan: Scan, now_s: float) -> bool:
        """Take the next scan frame; return False for a duplicate, which is left out."""
        whole_by_s = now_s
        if self._begun is not None:  # the rest of that frame took no longer than its bytes on the line
            read_s, n_bytes = self._begun
            whole_by_s = min(now_s, read_s + self._frame_s * (1 - n_bytes / self._layout.wire_bytes("scan")))
            self._begun = None
        hello, fit, counter = self._hello, self._fit, self._counter
        if hello is None or fit is None:
            raise ContractError("Assembler.scan before Assembler.board")
        if scan.flags & self._start_flag and self._index >= 0:
            self.interrupt("start")
            counter.forget_sequence()
        if self._counts_scans:
            step = counter.step(scan.sequence, scan.ticks, now_s, hello.rate_hz)
        else:
            step = counter.follow(now_s, hello.rate_hz)
        if step.kind == "restart":
            self.counts.restarts += 1
            self._restart_seen = True
            self._new_run("restart")
            step = counter.step(scan.sequence, scan.ticks, now_s, hello.rate_hz)
        if step.kind == "duplicate":
            self.counts.duplicate += 1
            self.other("scan")
            return False
        self._place(step.n_scans, overrun=bool(scan.flags & self._overrun_flag))
        waited_s = self._waited_s if self._queued_s <= 0 else np.inf
        self._queued_s = max(0.0, self._queued_s - step.n_scans * self._spare_s)
        board_s = counter.board_s
        fit.add(board_s, now_s, waited_s, whole=self._whole, whole_by_s=whole_by_s)
        time_s, sd_s = fit.time_of(board_s)
        lead_s = time_s - now_s
        if is_ahead := lead_s >= self.LARGEST_LEAD_S:
            # The host was suspended, and its clock stood still. Left as it is, this instant would hold those
            # of later scans until the host's clock has reached it.
            time_s, sd_s = now_s, max(sd_s, lead_s)
        # A better fit may move instants back, but instants of successive scans never decrease.
        time_s = max(time_s, self._not_before_s)
        self._not_before_s = time_s + self.LEAST_STEP_S
        self._newest_s, self._newest_sd_s = time_s, sd_s
        age_s = now_s - time_s
        # The instant of a scan that was ahead is a guess: it is as unfit to act on as a late one.
        fresh = not is_ahead and -self.LARGEST_LEAD_S < age_s <= self._params.late_after_s
        counter.age_s = max(age_s, 0.0)
        if age_s > self._params.late_after_s:
            self._is_confirmed = False
        self._scans.append(TimedScan(scan, self._index, time_s, sd_s, self._live and not fresh))
        self.counts.scans += 1
        return True

    def take(self) -> list[ScanRun | Gap]:
        """Return the runs and gaps since the last call, in order."""
        self._close_run()
        out, self._out = self._out, []
        return out

    def _place(self, n_scans: int, *, overrun: bool) -> None:
        """Number the scan, and put a gap before it if scans are missing.

        Before an overrun, each damaged frame may have been a scan that the board did take, and so may every
        scan lost in an interruption; the flag shows that the board missed at least one.
        """
        if n_scans == 1 and not (overrun or self._pending_gap or self._n_corrupt):
            self._index += 1
            return
        n_missing = n_scans - 1
        cause = self._pending_gap or ("corrupt" if self._n_corrupt else "missing")
        is_unknown = self._n_corrupt > 0 and not self._layout.counts_scans
        if self._index >= 0 and (n_missing or self._pending_gap or is_unknown):
            self._close_run()
            self._out.append(Gap(n_missing, cause, self._index + n_scans))
        self._index += n_scans
        self.counts.missing += n_missing
        if overrun:
            n_hidden = n_missing if self._pending_gap else self._n_corrupt
            self.counts.overrun += max(n_missing - n_hidden, min(n_missing, 1))
        elif cause == "missing":
            self.counts.dropped += n_missing
        self._pending_gap = None
        self._n_corrupt = 0

    def _close_run(self) -> None:
        if self._scans:
            self._out.append(ScanRun(self._scans, self._conversion))
            self._scans = []

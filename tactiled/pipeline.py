"""Pipeline from bytes to events: decoding, timing and detection, for live, replayed and offline data."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.base import in_order
from tactiled.detect.contact.announced import course_of
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.detect.tuning import TunedSuite
from tactiled.detect.worker import Worker
from tactiled.errors import ContractError
from tactiled.events.types import ContactEvent, ContactState, Event, ScanEvent, SlipEvent, new_event
from tactiled.force.calibration import CalibrationFile
from tactiled.force.estimator import build_force
from tactiled.samples.assembler import Assembler, SampleParams, WaitingScan
from tactiled.samples.block import Gap, ScanBlock
from tactiled.samples.rate import RateMeter
from tactiled.tomlfile import Params
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Acknowledge, Corrupt, Hello, Scan
from tactiled.wire.layout import Layout

Output = Event | Hello | Acknowledge
BlockOutput = Output | ScanBlock
RATES_HZ = (0.1, 20_000.0)  # below, a stall cannot be detected; above, no serial line can carry the scans


class PipelineParams(Params):
    """Parameters of the parts of a pipeline."""

    samples: SampleParams = SampleParams()
    detect: DetectParams = DetectParams()
    force: bool = Field(default=False, description="a force message for each scan")
    calibration: CalibrationFile | None = Field(default=None, description="of the force messages")
    baud: int = Field(default=0, ge=0, description="of the line, where it is not the layout's")


@dataclass(frozen=True)
class Health:
    """Counters and state of a pipeline; `bytes_in == bytes_framed + bytes_discarded + bytes_pending`."""

    scans: int
    scans_missing: int
    scans_overrun: int
    """Part of `scans_missing`: the board missed the instant and flagged it."""
    scans_dropped: int
    """Part of `scans_missing`: missing between intact frames, without a flag or another known cause."""
    scans_duplicate: int
    restarts: int
    """Number of boots of the board or restarts of its counters; they do not count as missing scans."""
    frames: int
    """Number of good frames of any kind."""
    frames_corrupt: int
    corrupt_by_reason: Mapping[str, int]
    """Corrupt frames by `Corrupt.reason`."""
    bytes_in: int
    bytes_framed: int
    bytes_discarded: int
    bytes_pending: int
    newest_scan_s: float
    """Instant of the newest scan; -inf before there is one."""
    clock_sd_s: float
    clock_rate_ppm: float
    clock_warning: str
    """Fault of the board's clock, and the option to set for it; empty for none."""
    rate_hz: float
    contact: ContactState
    slipping: bool
    loss_known: bool
    """Scans carry a sequence number; otherwise `scans_missing` misses most of the lost ones."""
    damage_known: bool
    """Frames carry a checksum; otherwise a damaged reading may pass as a good one."""
    fits_late: int
    """Number of groove fits that were not ready at the scan at which they were due."""


class Pipeline:
    """Process the bytes of a board into events.

    Parameters
    ----------
    live : bool
        True for live data and exact replays: scans that were handed over late are marked, and events that
        rest on them are not valid. False for the analysis of a file, in which no scan is late.
    worker : Worker, optional
        Takes long computations; without one they are computed in place, with the same events.
    """

    MOST_READS = 1000  # that `receive_reads` is given at once: ten seconds of the published board

    def __init__(
        self,
        layout: Layout,
        array: Array,
        params: PipelineParams | None = None,
        *,
        live: bool = True,
        worker: Worker | None = None,
    ) -> None:
        params = params or PipelineParams()
        self.layout = layout
        self.array = array
        self._decoder = Decoder(layout)
        in_counts = array.unit == "count"
        self._assembler = Assembler(
            layout, params.samples, params.baud, live=live, in_counts=in_counts, in_range=array.in_range
        )
        self._meter = RateMeter()
        force = build_force(array, params.calibration) if params.force else None
        self.announce: Callable[[list[ScanEvent]], None] | None = None
        """Takes the events of the scans of a read before the detectors run, where the read completes
        consecutive scans and nothing else; they are among the outputs of `receive_data`, too."""
        self.tuning = TunedSuite(array, params.detect, partial(build_suite, worker=worker), force)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state: forget board, clock, detectors and counters."""
        self._decoder.reset()
        self._assembler.reset()
        self.tuning.reset()
        self.late_fits: list[int] = []
        """Due scans of the groove fits that were not ready in the last `receive_data`."""
        self._tuned_for = ""
        self.hello: Hello | None = None
        self._origins: list[_ScanOrigin] = []  # of the scans that the detectors have not seen yet
        self._frames = 0
        self._fits_late = 0
        self._corrupt: Counter[str] = Counter()
        self._bytes_before = (0, 0, 0)  # in, framed, discarded by earlier connections
        self._contact: ContactState = "none"
        self._slipping = False
        self._meter.reset()
        if (hello := self.layout.assumed_hello()) is not None:
            self._accept(hello, 0.0)

    def receive_data(self, data: bytes, now_s: float) -> list[Output]:
        """Process bytes, and return all outputs that they complete, in the order of the stream.

        Parameters
        ----------
        data : bytes
            Any part of the stream, of any length.
        now_s : float
            Time at which the bytes were handed over, host monotonic seconds.
        """
        out: list[Output] = []
        self._receive(data, now_s, out, as_blocks=False)
        self._finish(as_blocks=False)
        return out

    def receive_reads(self, reads: Sequence[tuple[bytes, float]]) -> list[list[Output]]:
        """Process reads at the speed of blocks, and return the outputs of each, as `receive_data` gives them.

        Parameters
        ----------
        reads : sequence of (bytes, float)
            Arguments of `receive_data`.
        """
        outputs: list[list[Output]] = [[] for _ in reads]
        for (data, now_s), out in zip(reads, outputs, strict=True):
            self._receive(data, now_s, out, as_blocks=False)
        self._finish(as_blocks=False)
        return outputs

    def receive_blocks(self, reads: Sequence[tuple[bytes, float]]) -> list[BlockOutput]:
        """Process reads as `receive_reads`, and return their outputs in order, with scans as blocks."""
        out: list[BlockOutput] = []
        for data, now_s in reads:
            self._receive(data, now_s, out, as_blocks=True)
        self._finish(as_blocks=True)
        return out

    def _finish(self, *, as_blocks: bool) -> None:
        """Run the detectors on what was received, and count the fits that were late."""
        self._flush(as_blocks=as_blocks)
        self.late_fits = self.tuning.take_late_fits()
        self._fits_late += len(self.late_fits)

    def _receive(self, data: bytes, now_s: float, out: list[Any], *, as_blocks: bool) -> None:
        """Process a read, up to the detectors; its outputs go to `out`, by now or with `_flush`."""
        self._assembler.read(now_s, self._decoder.bytes_pending)
        for frame in self._decoder.feed(data):
            if isinstance(frame, Scan):
                self._frames += 1
                if self.hello is None and self.layout.measures_rate:
                    self._measure(now_s, out)
                elif self.hello is not None and self._assembler.scan(frame, now_s):
                    self._origins.append(_ScanOrigin(out, now_s))
                continue
            self._frames += not isinstance(frame, Corrupt)
            if isinstance(frame, Corrupt):
                self._corrupt[frame.reason] += 1
                self._meter.reset()
                self._assembler.corrupt()
            elif isinstance(frame, Hello):
                self._assembler.other("hello")
                self._flush(as_blocks=as_blocks)
                out.append(frame)
                if check_hello(frame, self.layout, self.array) is None:
                    self._accept(frame, now_s)
                else:
                    self.hello = None
            elif isinstance(frame, Acknowledge):
                self._assembler.answered(frame, now_s)
                out.append(frame)

    @property
    def is_measuring(self) -> bool:
        """True while scans arrive whose rate is not known yet, so that they are no output."""
        return self._meter.has_begun

    def _measure(self, now_s: float, out: list[Any]) -> None:
        """Measure the rate; once it is known, the board is known, as if it had said hello."""
        rate_hz = self._meter.add(now_s)
        hello = self.layout.assumed_hello(rate_hz) if rate_hz is not None else None
        if hello is not None:
            self._meter.reset()
            hello = replace(hello, streaming=True)
            out.append(hello)
            if check_hello(hello, self.layout, self.array) is None:
                self._accept(hello, now_s)

    def assume_rate(self, measured_hz: float) -> None:
        """Take a rate that was measured before the first read, of a board that does not state it."""
        if self.hello is None and self.layout.measures_rate:
            hello = self.layout.assumed_hello(measured_hz)
            if hello is not None and check_hello(hello, self.layout, self.array) is None:
                self._accept(replace(hello, streaming=True), 0.0)

    def disconnected(self) -> None:
        """Handle a lost port: discard an incomplete frame, and put a Gap before the next scan."""
        self.interrupted()
        if self.layout.has("hello") or self.layout.measures_rate:
            self.hello = None
            self._meter.reset()

    def interrupted(self) -> None:
        """Handle missing bytes: as `disconnected`, but the board stays known."""
        sums = (self._decoder.bytes_in, self._decoder.bytes_framed, self._decoder.bytes_discarded)
        pending = self._decoder.bytes_pending
        before = [old + new for old, new in zip(self._bytes_before, sums, strict=True)]
        self._bytes_before = (before[0], before[1], before[2] + pending)
        self._decoder.reset()
        self._assembler.interrupt("disconnect")

    def health(self) -> Health:
        """Return the present counters and state."""
        counts = self._assembler.counts
        bytes_in, framed, discarded = self._bytes_before
        newest_s, sd_s = self._assembler.newest
        return Health(
            scans=counts.scans,
            scans_missing=counts.missing,
            scans_overrun=counts.overrun,
            scans_dropped=counts.dropped,
            scans_duplicate=counts.duplicate,
            restarts=counts.restarts,
            frames=self._frames,
            frames_corrupt=self._corrupt.total(),
            corrupt_by_reason=dict(self._corrupt),
            bytes_in=bytes_in + self._decoder.bytes_in,
            bytes_framed=framed + self._decoder.bytes_framed,
            bytes_discarded=discarded + self._decoder.bytes_discarded,
            bytes_pending=self._decoder.bytes_pending,
            newest_scan_s=newest_s,
            clock_sd_s=sd_s,
            clock_rate_ppm=self._assembler.drift_ppm,
            clock_warning=self._assembler.clock_warning,
            rate_hz=self._assembler.rate_hz,
            contact=self._contact,
            slipping=self._slipping,
            loss_known=self.layout.counts_scans,
            damage_known=self.layout.detects_damage,
            fits_late=self._fits_late,
        )

    def command(self, name: str, arguments: Mapping[str, Any], now_s: float) -> tuple[str, list[Event]]:
        """Change settings of clock and detectors between two reads.

        The events that follow depend on the commands and the data alone, so that a replay repeats them.

        Parameters
        ----------
        name : str
            ``"tare"``, ``"speed"``, ``"friction"``, ``"object-changed"``, ``"motion"``, ``"inhibit"``,
            ``"expect-load-change"`` or ``"thresholds"`` (protocols/control.md; the instants of ``"motion"``
            are those of the scans' clock); ``"adapter"``, which only the port says: its ``handover_s``;
            ``"ping"``, just before the daemon sends one: its ``token``; ``"late-fit"``, which only a
            recording says: the ``index`` of the scan at which a fit was due and not ready.
        arguments : mapping
            Checked ones.

        Returns
        -------
        reason : str
            Reason for a refusal; empty when the command was done.
        events : list of Event
            Ends of a contact or slip that the command interrupted, not valid.
        """
        tuning = self.tuning
        reason, events = "", list[Event]()
        if name == "tare":
            reason, events = tuning.tare(force=arguments["force"])
        elif name == "speed":
            tuning.set_speed(arguments["speed_mm_s"])
        elif name == "friction":
            reason = tuning.state_friction(arguments["value"], arguments["sd"])
        elif name == "object-changed":
            reason = tuning.change_object()
        elif name == "motion":
            reason = tuning.announce_motion(*course_of(arguments))
        elif name == "inhibit":
            tuning.inhibit(now_s, arguments["duration_s"])
        elif name == "expect-load-change":
            tuning.expect_load_change(now_s, arguments["duration_s"])
        elif name == "adapter":
            self._assembler.adapter(arguments["handover_s"])
        elif name == "ping":
            self._assembler.pinged(arguments["token"], now_s)
        elif name == "late-fit":
            tuning.expect_late_fit(arguments["index"])
        elif name == "thresholds":
            reason, events = tuning.set_thresholds(arguments["values"])
        else:
            raise ContractError(f"{name!r} is no command of the pipeline")
        return reason, self._note(events)

    def _accept(self, hello: Hello, now_s: float) -> None:
        if hello.board_serial != self._tuned_for:
            self.tuning.forget_zero()
            self._tuned_for = hello.board_serial
        self.hello = hello
        self._assembler.board(hello, now_s)

    def _flush(self, *, as_blocks: bool) -> None:
        """Run the detectors on the scans received, and give the outputs to the reads that completed them."""
        origins, self._origins = self._origins, []
        n_done = 0
        if self.announce is not None and origins and not origins[0].out:
            waiting = self._assembler.waiting()
            if waiting:
                self._flush_announced(self.announce, waiting, origins[0])
                return
        for item in self._assembler.flush():
            found = self._note(self.tuning.process(item))
            if isinstance(item, Gap):  # the scan behind it is always there
                origins[n_done].out.extend(found)
                continue
            part = origins[n_done : n_done + len(item)]
            n_done += len(item)
            if as_blocks:
                part[-1].out.extend([item, *found])
            elif found:
                _deliver(item, found, part, self.tuning.zero_known_s)
            else:
                for origin, event in zip(part, scan_events(item, part), strict=True):
                    origin.out.append(event)

    def _flush_announced(
        self, announce: Callable[[list[ScanEvent]], None], waiting: list[WaitingScan], origin: "_ScanOrigin"
    ) -> None:
        """Announce the scans of a read, run the detectors on them, and give both to the read."""
        scans = [
            new_event(
                ScanEvent,
                time_s=scan.time_s,
                index=scan.index,
                volts=scan.volts,
                valid=scan.valid,
                time_sd_s=scan.time_sd_s,
                age_s=origin.now_s - scan.time_s,
                late=scan.late,
            )
            for scan in waiting
        ]
        announce(scans)  # before the block is made, which takes as long as what was done for a scan by now
        found = [event for block in self._assembler.flush() for event in self.tuning.process(block)]
        origin.out.extend(in_order(scans, self._note(found)))

    def _note(self, events: list[Event]) -> list[Event]:
        """Keep the state of contact and slip for `health`; returns the events."""
        for event in events:
            if isinstance(event, ContactEvent):
                self._contact = event.state
            elif isinstance(event, SlipEvent):
                self._slipping = event.state == "onset"
        return events


class _ScanOrigin(NamedTuple):
    """Outputs of the read that completed a scan, and the time of that read."""

    out: list[Any]
    now_s: float


def _deliver(
    block: ScanBlock, found: Sequence[Event], origins: Sequence[_ScanOrigin], known_s: float
) -> None:
    """Give scans and events to their reads; each event follows the scan that completed its evidence.

    Events of scans that were held back until the zero was known follow the scan at `known_s`.
    """
    time_s: list[float] = block.time_s.tolist()
    n_scans = 0
    for event in in_order(scan_events(block, origins), found):
        if isinstance(event, ScanEvent):
            origins[n_scans].out.append(event)
            n_scans += 1
        else:
            origins[min(bisect_left(time_s, max(event.evidence_s, known_s)), len(time_s) - 1)].out.append(
                event
            )


def scan_events(block: ScanBlock, origins: Sequence[_ScanOrigin]) -> Iterator[ScanEvent]:
    """Yield one event for each scan of a block."""
    rows = zip(
        block.index.tolist(), block.volts.tolist(), block.valid.tolist(),
        block.time_s.tolist(), block.time_sd_s.tolist(), block.late.tolist(), origins, strict=True,
    )  # fmt: skip
    for index, volts, valid, time_s, sd_s, late, origin in rows:
        yield new_event(
            ScanEvent,
            time_s=time_s,
            index=index,
            volts=tuple(volts),
            valid=tuple(valid),
            time_sd_s=sd_s,
            age_s=origin.now_s - time_s,
            late=late,
        )


def check_hello(hello: Hello, layout: Layout, array: Array) -> str | None:
    """Return the reason why this board does not fit layout and array, or None when it does."""
    wanted = layout.file.protocol_version
    if hello.protocol_version != wanted:
        return (
            f"board {hello.board_serial} speaks protocol version {hello.protocol_version}, "
            f"{layout.name} is version {wanted}: update its firmware or name its layout in board.protocol"
        )
    if hello.array_id != array.name:
        return (
            f"board {hello.board_serial} carries the array {hello.array_id!r}, configured is "
            f"{array.name!r}: name the right one in board.array"
        )
    if array.n_channels != layout.n_channels:
        return (
            f"array {array.name!r} has {array.n_channels} channels ({array.n_taxels} taxels), a scan of "
            f"{layout.name} has {layout.n_channels}: correct the array file or the layout file"
        )
    if array.unit not in ("V", "count") and not layout.carries_units:
        return (
            f"array {array.name!r} reads {array.unit}, but the frames of {layout.name} carry the counts of a "
            "converter: describe the array in V or count (tactiled detect reads logs in any unit)"
        )
    slowest, fastest = RATES_HZ
    converts = 1 <= hello.adc_bits <= 32 and 0 < hello.adc_reference_v <= 100
    if not (slowest <= hello.rate_hz <= fastest and converts):
        return (
            f"board {hello.board_serial} reports {hello.rate_hz:g} Hz, {hello.adc_bits} bits and "
            f"{hello.adc_reference_v:g} V; possible are {slowest:g} to {fastest:g} Hz, 32 bits, 100 V"
        )
    return None

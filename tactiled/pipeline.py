"""Pipeline from bytes to events, for live, replayed and offline data.

It has two phases. `Pipeline.receive` turns the bytes of a read into scans: decoding, counting, timing.
`Pipeline.detect` runs the detectors on what one or more reads gave. The value between them is `Received`; the
daemon publishes its scans before the detectors run.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.base import in_order
from tactiled.detect.contact.announced import course_of
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.detect.tuning import TARE_S, TunedSuite
from tactiled.detect.worker import Worker
from tactiled.errors import ContractError
from tactiled.events.types import ContactEvent, ContactState, Event, SlipEvent
from tactiled.force.calibration import CalibrationFile
from tactiled.force.estimator import ForceEstimator, ForceSource, UncalibratedForce
from tactiled.received import Detected, Output, Received, joined
from tactiled.samples.assembler import Assembler, SampleParams
from tactiled.samples.block import Gap, ScanBlock, ScanRun
from tactiled.samples.rate_meter import RateMeter
from tactiled.tomlfile import Params
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Acknowledge, Corrupt, Hello, Scan
from tactiled.wire.layout import Layout

RATES_HZ = (0.1, 20_000.0)  # below, a stall cannot be detected; above, no serial line can carry the scans
_MISSED_SCANS = 5  # beyond the time of a tare, after which its scans are not of the present: as of a stall


class PipelineParams(Params):
    """Parameters of the parts of a pipeline."""

    samples: SampleParams = SampleParams()
    detect: DetectParams = DetectParams()
    force: bool = Field(default=False, description="a force message for each scan")
    calibration: CalibrationFile | None = Field(default=None, description="of the force messages")
    baud: int = Field(default=0, ge=0, description="of the line, where it is not the layout's")


@dataclass(frozen=True)
class Health:
    """Counters and state of a pipeline; `bytes_in == bytes_framed + bytes_discarded + bytes_pending`.

    Fields with names of `status` messages mean what these do (protocols/events/status.schema.json).
    """

    scans: int
    scans_missing: int
    scans_overrun: int
    scans_dropped: int
    """Part of `scans_missing`: missing between intact frames, without a flag or another known cause."""
    scans_duplicate: int
    restarts: int
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
    hidden_below: float
    loss_known: bool
    damage_known: bool
    fits_late: int


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

    MOST_READS = 1000  # that `detect` is given at once: ten seconds of the published board

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
        fits = array.n_channels == layout.n_channels  # `check_hello` refuses a board that does not
        self._assembler = Assembler(
            layout,
            params.samples,
            params.baud,
            live=live,
            array=array if fits else None,
        )
        self._meter = RateMeter()
        force: ForceSource | None = None
        if params.force:  # without a calibration every force is unknown
            file = params.calibration
            force = UncalibratedForce() if file is None else ForceEstimator(array, file)
        self.tuning = TunedSuite(array, params.detect, partial(build_suite, worker=worker), force)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state: forget board, clock, detectors and counters."""
        self._decoder.reset()
        self._assembler.reset()
        self.tuning.reset()
        self.late_fits: list[int] = []
        """Due scans of the groove fits that were not ready in the last `detect` since `receive`."""
        self._tuned_for = ""
        self.hello: Hello | None = None
        self._frames = 0
        self._fits_late = 0
        self._corrupt: Counter[str] = Counter()
        self._contact: ContactState = "none"
        self._slipping = False
        self._meter.reset()
        if (hello := self.layout.assumed_hello()) is not None:
            self._meet(hello, 0.0)

    def receive_data(self, data: bytes, now_s: float) -> list[Output]:
        """Process the bytes of a read in both phases, and return all outputs that they complete, in order."""
        return self.detect([self.receive(data, now_s)])[0]

    def receive(self, data: bytes, now_s: float) -> Received:
        """Turn the bytes of a read into scans, and hellos and answers of the board: the first phase.

        The bytes may be any part of the stream; `now_s` is when they were handed over.
        """
        received, self.late_fits = Received([], now_s), []
        items, assembler = received.items, self._assembler
        assembler.read(now_s, self._decoder.framer.bytes_pending)
        for frame in self._decoder.feed(data):
            if isinstance(frame, Corrupt):
                self._corrupt[frame.reason] += 1
                if frame.reason != "value":  # one line: text between scans, or one scan of the measurement
                    self._meter.reset()
                assembler.corrupt()
                continue
            self._frames += 1
            if isinstance(frame, Scan):
                if self.hello is not None:
                    assembler.scan(frame, now_s)
                elif self.layout.measures_rate and (hello := self._measured(now_s)) is not None:
                    self._meet(hello, now_s)
                    items.append(hello)
            elif isinstance(frame, Hello):
                assembler.other("hello")
                items += assembler.take()
                self._meet(frame, now_s)
                items.append(frame)
            elif isinstance(frame, Acknowledge):
                items += assembler.take()
                assembler.answered(frame, now_s)
                items.append(frame)
        items += assembler.take()
        return received

    def detect(self, received: Sequence[Received]) -> list[list[Output]]:
        """Run the detectors on what reads gave, and return the outputs of each read: the second phase.

        The outputs of a read are the same however many reads are given at once; many are faster. Each event
        is an output of the read that completed its evidence.
        """
        outputs: list[list[Output]] = [[] for _ in received]
        scans = [iter(one.scan_events) for one in received]
        for part in self.process(received):
            if isinstance(part.item, ScanBlock):
                for read, n_scans, events in part.by_read(part.item, self.tuning.zero_known_s):
                    of_read = islice(scans[read], n_scans)
                    outputs[read] += in_order(of_read, events) if events else of_read
            else:
                [(read, _)] = part.shares
                outputs[read] += part.events if isinstance(part.item, Gap) else [part.item]
        return outputs

    def process(self, received: Sequence[Received]) -> Iterator[Detected]:
        """Run the detectors as `detect` does, and yield what they are given with their events."""
        try:
            for item, shares in joined(received):
                given = item.block() if isinstance(item, ScanRun) else item
                events: list[Event] = []
                if isinstance(given, ScanBlock | Gap):
                    events = self._note(self.tuning.process(given))
                elif isinstance(given, Hello) and check_hello(given, self.layout, self.array) is None:
                    self._tune_for(given)
                yield Detected(given, events, shares)
        finally:  # also of a read that a detector fails on, for the replay of its recording
            self.late_fits = self.tuning.take_late_fits()
            self._fits_late += len(self.late_fits)

    @property
    def is_measuring(self) -> bool:
        """True while scans arrive whose rate is not known yet, so that they are no output."""
        return self.layout.measures_rate and self._meter.has_begun

    def know(self, hello: Hello) -> None:
        """Take the board as it was known before the first read."""
        self._meet(hello, 0.0)
        self._tune_for(hello)

    def disconnected(self) -> None:
        """Handle a lost port: discard an incomplete frame, and put a Gap before the next scan."""
        self.interrupted()
        if self.layout.has("hello") or self.layout.measures_rate:
            self.hello = None
            self._meter.reset()

    def interrupted(self) -> None:
        """Handle missing bytes: as `disconnected`, but the board stays known."""
        self._decoder.interrupted()
        self._assembler.interrupt("disconnect")

    def health(self) -> Health:
        """Return the present counters and state."""
        counts, framer = self._assembler.counts, self._decoder.framer
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
            bytes_in=framer.bytes_in,
            bytes_framed=framer.bytes_framed,
            bytes_discarded=framer.bytes_discarded,
            bytes_pending=framer.bytes_pending,
            newest_scan_s=newest_s,
            clock_sd_s=sd_s,
            clock_rate_ppm=self._assembler.drift_ppm,
            clock_warning=self._assembler.clock_warning,
            rate_hz=self._assembler.rate_hz,
            contact=self._contact,
            slipping=self._slipping,
            hidden_below=self.tuning.hidden_below,
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
            A command of protocols/control.md that concerns detectors (the instants of ``"motion"`` are those
            of the scans' clock); ``"adapter"``, which only the port says: its ``handover_s``; ``"ping"``,
            just before the daemon sends one: its ``token``; ``"late-fit"``, which only a recording says: the
            ``index`` of the scan at which a fit was due and not ready.

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
            rate_hz = self._assembler.rate_hz
            if now_s - self._assembler.newest[0] > TARE_S + (_MISSED_SCANS / rate_hz if rate_hz else 0.0):
                reason = "no new scans: is the board plugged in?"
            else:
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

    def _measured(self, now_s: float) -> Hello | None:
        """Measure the rate of a board that does not state it; once it is known, return a hello with it."""
        rate_hz = self._meter.add(now_s)
        hello = self.layout.assumed_hello(rate_hz) if rate_hz is not None else None
        if hello is None:
            return None
        self._meter.reset()
        return replace(hello, streaming=True)

    def _meet(self, hello: Hello, now_s: float) -> None:
        """Take a board that fits layout and array; scans of another one are ignored."""
        if check_hello(hello, self.layout, self.array) is None:
            self.hello = hello
            self._assembler.board(hello, now_s)
        else:
            self.hello = None

    def _tune_for(self, hello: Hello) -> None:
        """Forget the zero of another board."""
        if hello.board_serial != self._tuned_for:
            self.tuning.forget_zero()
            self._tuned_for = hello.board_serial

    def _note(self, events: list[Event]) -> list[Event]:
        """Keep the state of contact and slip for `health`; returns the events."""
        for event in events:
            if isinstance(event, ContactEvent):
                self._contact = event.state
            elif isinstance(event, SlipEvent):
                self._slipping = event.state == "onset"
        return events


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

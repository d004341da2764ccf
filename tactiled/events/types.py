"""Events: what a detector, or the state of the board, says.

All instants are ``time_s``: host monotonic seconds live, the file's own clock offline. They become epoch
seconds once, in `codec.encode`. No field is ever None or NaN: what is unknown has a value that says so
(a direction without information has ``direction_sd_deg = 180``), because a controller in another
language will read it.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

UNKNOWN_SD_DEG = 180.0  # wider than the uniform distribution on a circle (104): "no idea"


@dataclass(frozen=True, kw_only=True)
class Event:
    """Root of all events; `time_s` is the physical instant that the event is about."""

    topic: ClassVar[str]
    time_s: float

    @property
    def evidence_s(self) -> float:
        """Instant of the scan that completed the evidence: events come in this order."""
        return self.time_s


# Why a slip is said and yet not to be acted on: someone announced that the hand moves, or a load changes.
Suppressed = Literal["", "inhibit", "load-change"]


@dataclass(frozen=True, kw_only=True)
class SlipEvent(Event):
    """Slip began, deepened or ended."""

    topic: ClassVar[str] = "slip"
    state: Literal["onset", "end"]
    kind: Literal["incipient", "gross"]
    onset_s: float
    onset_sd_s: float
    direction_deg: float
    direction_sd_deg: float
    confidence: float
    taxels: tuple[int, ...]
    detector: str
    statistic: float
    threshold: float
    valid: bool
    detected_s: float
    """Instant of the scan that completed the evidence: `detected_s - onset_s` is the detector's delay."""
    suppressed: Suppressed = ""
    """Which announcement explains it; then `valid` is false. Empty where none does."""

    @property
    def evidence_s(self) -> float:
        return self.detected_s


# "unknown": touching, and nobody saw the touch begin (a start or a long gap in mid-contact): it may hold or
# slide. A slip is still found; its "onset" may then be a stop.
ContactState = Literal["none", "unknown", "loading", "holding", "sliding"]


@dataclass(frozen=True, kw_only=True)
class ContactEvent(Event):
    """The contact as a whole changed its state."""

    topic: ClassVar[str] = "contact"
    state: ContactState
    previous: ContactState
    taxels: tuple[int, ...]
    valid: bool


TextureStatus = Literal[
    "ok", "no-slip", "too-few-periods", "aliased", "ambiguous", "low-snr", "saturated", "stale"
]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One reading of an ambiguous texture."""

    period_mm: float
    angle_deg: float
    weight: float


@dataclass(frozen=True, kw_only=True)
class TextureEvent(Event):
    """Estimate of a grooved surface, or the named reason why there is none.

    Where `status` is not "ok", estimates are 0.0 and their sigmas too: read `status` first.
    """

    topic: ClassVar[str] = "texture"
    status: TextureStatus
    period_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_deg: float = 0.0
    angle_sd_deg: float = 0.0
    speed_mm_s: float = 0.0
    speed_sd_mm_s: float = 0.0
    speed_source: Literal["given", "estimated", "none"] = "none"
    frequency_hz: float = 0.0
    window_s: float = 0.0
    snr_db: float = 0.0
    candidates: tuple[Candidate, ...] = ()
    estimator: str = ""


@dataclass(frozen=True, kw_only=True)
class ScanEvent(Event):
    """One scan, as volts in channel order."""

    topic: ClassVar[str] = "scan"
    index: int
    volts: tuple[float, ...]
    valid: tuple[bool, ...]
    time_sd_s: float
    age_s: float
    """Seconds from the scan's instant to when the daemon handled it."""
    late: bool


@dataclass(frozen=True, kw_only=True)
class Sent:
    """How many messages of each topic this daemon has published of this board: the `seq` that comes next."""

    slip: int = 0
    contact: int = 0
    texture: int = 0
    scan: int = 0
    info: int = 0
    recording: int = 0
    command: int = 0


BoardState = Literal["no-device", "syncing", "running", "stalled", "fault"]


@dataclass(frozen=True, kw_only=True)
class StatusEvent(Event):
    """How the board, the line and the daemon are; published at 10 Hz whatever happens."""

    topic: ClassVar[str] = "status"
    state: BoardState
    valid: bool
    reason: str
    warning: str
    """What should be mended although it works: a noisy line, a board clock that is off, a slow adapter."""
    age_s: float
    """Seconds since the newest scan began; how old everything on the other topics is."""
    clock_sd_s: float
    """Sigma of the newest scan's instant; 1e9 before any scan."""
    clock_rate_ppm: float
    rate_hz: float
    scans: int
    frames_corrupt: int
    scans_missing: int
    scans_duplicate: int
    restarts: int
    """How often the board booted, or began to count anew."""
    bytes_in: int
    bytes_framed: int
    bytes_discarded: int
    bytes_pending: int
    connects: int
    contact: ContactState
    slipping: bool
    uptime_s: float
    inhibited_s: float = 0.0
    """For how much longer slips are published as not valid, because someone asked for it."""
    scans_overrun: int = 0
    """Of `scans_missing`: the board missed the scan instant and flagged it; the line is not to blame."""
    sent: Sent = Sent()
    """What a subscriber that lost nothing has heard of by now."""


@dataclass(frozen=True, kw_only=True)
class InfoEvent(Event):
    """What stands at the other end of the cable; repeated every second for those who come late."""

    topic: ClassVar[str] = "info"
    board_serial: str
    firmware_version: str
    protocol: str
    protocol_version: int
    array_id: str
    channels: int
    taxels: int
    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]
    channel_names: tuple[str, ...]
    rate_hz: float
    volts_per_count: float
    channel_offset_s: tuple[float, ...]
    tactiled_version: str


@dataclass(frozen=True, kw_only=True)
class RecordingEvent(Event):
    """How the recording is; published each second, and at each change."""

    topic: ClassVar[str] = "recording"
    state: Literal["off", "recording", "no-room", "failed"]
    reason: str
    file: str
    """The part being written, by the name it will have; empty where there is none."""
    parts: int
    bytes_written: int
    free_mb: float
    reads_dropped: int
    """Reads of the port that are in no file."""
    reads_waiting: int
    """Items that wait for the disk."""


@dataclass(frozen=True, kw_only=True)
class CommandEvent(Event):
    """Someone asked the daemon for something, and what came of it."""

    topic: ClassVar[str] = "command"
    request_id: str
    command: str
    arguments: str
    """As a JSON object."""
    who: str
    """As the client calls itself."""
    key: str
    """Name of the key that the client proved to own; empty on plain endpoints."""
    uid: int
    """User at the other end, as the kernel says; -1 where the transport does not tell it."""
    ok: bool
    reason: str
    """Why not; empty where `ok`."""
    scan_index: int
    """First scan that it holds for."""


AnyEvent = (
    SlipEvent
    | ContactEvent
    | TextureEvent
    | ScanEvent
    | StatusEvent
    | InfoEvent
    | RecordingEvent
    | CommandEvent
)
EVENT_TYPES: dict[str, type[Event]] = {kind.topic: kind for kind in get_args(AnyEvent)}

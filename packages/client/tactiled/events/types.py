"""Event types: results of the detectors, state of the board, outcome of commands.

Instants are host monotonic seconds live, and in the clock of the file offline. They become epoch seconds
once, in `codec.encode`. No field is ever None or NaN, because controllers in other languages read it: an
unknown quantity has a value that shows it (a direction without information has ``direction_sd_deg = 180``).
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar, get_args

UNKNOWN_SD_DEG = 180.0  # no information: wider than the uniform distribution on a circle (104)
UNKNOWN_SD_N = 1e9  # no information: no skin bears so much


@dataclass(frozen=True, kw_only=True)
class Event:
    """Base of all events; `time_s` is the physical instant of the event."""

    topic: ClassVar[str]
    evidence: ClassVar[str] = "time_s"  # field with the instant of the scan that completed the evidence
    time_s: float

    @property
    def evidence_s(self) -> float:
        """Instant of the scan that completed the evidence; events are published in this order."""
        return float(getattr(self, self.evidence))


E = TypeVar("E", bound=Event)


def new_event(kind: type[E], /, **fields: Any) -> E:  # slips have a field `kind`, too
    """Make an event of all its fields, for those of each scan.

    The constructor of a frozen dataclass sets each field by a call, in twice to four times the time.
    """
    event = kind.__new__(kind)
    vars(event).update(fields)
    return event


# Announcement of a client that makes a slip event invalid: the hand moves, or a load changes.
Suppressed = Literal["", "inhibit", "load-change"]


@dataclass(frozen=True, kw_only=True)
class SlipEvent(Event):
    """Onset of incipient or gross slip, or end of a slip."""

    topic: ClassVar[str] = "slip"
    evidence: ClassVar[str] = "detected_s"
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
    """Instant of the scan that completed the evidence; `detected_s - onset_s` is the detector's delay."""
    suppressed: Suppressed = ""  # announcement that covers this slip; `valid` is then false. Empty for none


# "unknown": in contact, but the beginning of the contact was not observed (start or long gap in mid-contact),
# so it may hold or slide. A slip is still detected; its "onset" may then be a stop.
# "shearing": part of the contact slips; from the setting grip only.
ContactState = Literal["none", "unknown", "loading", "holding", "shearing", "sliding"]


@dataclass(frozen=True, kw_only=True)
class ContactEvent(Event):
    """Change of the state of the whole contact."""

    topic: ClassVar[str] = "contact"
    state: ContactState
    previous: ContactState
    taxels: tuple[int, ...]
    valid: bool


GripState = Literal["none", "unknown", "sticking", "partial", "gross", "unloading"]


@dataclass(frozen=True, kw_only=True)
class GripEvent(Event):
    """Part of the friction limit that is in use, and probability of gross slip; one for each scan in contact.

    `_low` and `_high` are quantiles of 5 and 95 %. Where the state is none, the other numbers mean nothing.
    """

    topic: ClassVar[str] = "grip"
    utilisation: float = 0.0  # tangential load over the friction limit (median); 1 is gross slip
    utilisation_low: float = 0.0
    utilisation_high: float = 1.0
    friction: float = 0.0
    friction_low: float = 0.0
    friction_high: float = 0.0
    slipping_share: float = 0.0  # part of the contact area that slips now
    p_sliding: float = 0.0  # probability that all of the contact slides now
    p_gross_50ms: float = 0.0
    """Probability that gross slip begins within 50 ms, if the contact does not slide yet; 1 in gross slip."""
    p_gross_100ms: float = 0.0
    p_gross_300ms: float = 0.0
    load: float = 0.0
    shear_x: float = 0.0
    shear_y: float = 0.0
    torsion: float = 0.0
    unit: Literal["N", "relative"] = "relative"
    needed_load: float = 0.0  # load at which utilisation would be 0.7 at `friction_low`
    state: GripState = "none"
    valid: bool = False
    late: bool = False
    suppressed: Suppressed = ""


@dataclass(frozen=True, kw_only=True)
class ForceEvent(Event):
    """Force of the object on the skin; one for each scan.

    A component that the calibration does not know is 0.0 with the standard deviation `UNKNOWN_SD_N`.
    """

    topic: ClassVar[str] = "force"
    UNCALIBRATED: ClassVar[frozenset[str]] = frozenset(("nominal", "none"))
    """Values of `calibration` with which no force is known in newtons; a nominal one is off by up to 2.7."""
    fx_n: float = 0.0
    fy_n: float = 0.0
    fz_n: float = 0.0  # normal force; above 0 presses
    fx_sd_n: float = UNKNOWN_SD_N
    fy_sd_n: float = UNKNOWN_SD_N
    fz_sd_n: float = UNKNOWN_SD_N
    tx_nmm: float = 0.0  # moments about the origin of the array frame
    ty_nmm: float = 0.0
    tz_nmm: float = 0.0
    x_mm: float = 0.0  # centre of pressure; the centre of the array where there is hardly any normal force
    y_mm: float = 0.0
    taxel_fx_n: tuple[float, ...] = ()
    taxel_fy_n: tuple[float, ...] = ()
    taxel_fz_n: tuple[float, ...] = ()
    calibration: str = "none"
    """Name of the calibration; "nominal" for one from published numbers, "none" where there is none."""
    saturated: bool = False  # True where a channel is saturated: the force is at least this
    beyond_range: bool = False  # True where a reading exceeds those of the calibration
    channels_missing: int = 0
    """Number of channels without a valid reading, which were replaced by others of their taxel."""
    valid: bool = False
    late: bool = False


TextureStatus = Literal[
    "ok",
    "period-only",
    "no-slip",
    "too-few-periods",
    "aliased",
    "ambiguous",
    "uneven-channels",
    "several-gratings",
    "machine",
    "low-snr",
    "saturated",
    "stale",
]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Grating that is in view, with "period-only", or one of those that an ambiguous texture may be."""

    period_mm: float
    angle_deg: float
    weight: float
    period_sd_mm: float = 0.0  # standard deviation of the period with "period-only"; else 0.0
    period_min_mm: float = 0.0
    """Shortest period with "period-only", as of the event; else 0.0. The longest is next."""
    period_max_mm: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TextureEvent(Event):
    """Estimate of a grooved surface, or the reason why there is none.

    Where `status` is neither "ok" nor "period-only", estimates and their sigmas mean nothing: read `status`
    first. With "period-only" the angle is not known (`angle_sd_deg` 180).
    """

    topic: ClassVar[str] = "texture"
    evidence: ClassVar[str] = "answered_s"
    status: TextureStatus
    answered_s: float
    """Instant of the scan at which this was reported; `time_s` is the end of the window that was used."""
    period_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_deg: float = 0.0
    angle_sd_deg: float = 0.0
    speed_mm_s: float = 0.0
    speed_sd_mm_s: float = 0.0
    period_min_mm: float = 0.0
    """Shortest period for the permitted tilts of the grooves, with "period-only"; else 0.0."""
    period_max_mm: float = 0.0  # longest period: that of motion across the grooves
    speed_source: Literal["given", "estimated", "none"] = "none"
    frequency_hz: float = 0.0
    window_s: float = 0.0
    snr_db: float = 0.0
    stray_rad: float = 0.0
    """Root-mean-square difference of channels' phases from the wave; 0.0 where there is no wave."""
    candidates: tuple[Candidate, ...] = ()
    estimator: str = ""


@dataclass(frozen=True, kw_only=True)
class ScanEvent(Event):
    """Scan as volts in channel order."""

    topic: ClassVar[str] = "scan"
    index: int
    volts: tuple[float, ...]
    valid: tuple[bool, ...]
    time_sd_s: float
    age_s: float  # seconds from the instant of the scan to its handling by the daemon
    late: bool


@dataclass(frozen=True, kw_only=True)
class Sent:
    """Numbers of messages that this daemon has published for the board, by topic: the next `seq` of each."""

    slip: int = 0
    contact: int = 0
    texture: int = 0
    grip: int = 0
    scan: int = 0
    info: int = 0
    recording: int = 0
    command: int = 0
    force: int = 0


BoardState = Literal["no-device", "syncing", "running", "stalled", "fault"]


ScanPath = Literal["compiled", "python"]


@dataclass(frozen=True, kw_only=True)
class StatusEvent(Event):
    """State of board, line and daemon; published at 10 Hz in every state."""

    topic: ClassVar[str] = "status"
    state: BoardState
    valid: bool
    reason: str
    warning: str
    """Fault that does not stop the board: a noisy line, a board clock that deviates, a slow adapter."""
    age_s: float  # seconds since the newest scan began: the age of the newest data on the other topics
    clock_sd_s: float  # standard deviation of the newest scan's instant in seconds; 1e9 before any scan
    clock_rate_ppm: float
    rate_hz: float
    scans: int
    frames_corrupt: int
    scans_missing: int
    scans_duplicate: int
    restarts: int  # number of boots of the board, or of restarts of its counters
    bytes_in: int
    bytes_framed: int
    bytes_discarded: int
    bytes_pending: int
    connects: int
    contact: ContactState
    slipping: bool
    uptime_s: float
    inhibited_s: float = 0.0
    """Remaining seconds for which slips are published as not valid, on the request of a client."""
    scans_overrun: int = 0
    """Part of `scans_missing`: the board missed the scan instant and flagged it; the line is in order."""
    loop_lag_s: float = 0.0
    """Longest time since the last status for which the daemon could not react to anything."""
    fits_late: int = 0  # number of groove fits that were not ready at the scan at which they were due
    loss_known: bool = True  # False where frames have no sequence number: lost scans are then not counted
    damage_known: bool = True
    """False where frames have no checksum: a damaged reading may then pass as a good one."""
    path: ScanPath = "compiled"
    """Compiled code, or numpy where the library is missing; the results are the same."""
    hidden_below: float = 0.0
    """Load of a taxel, in the unit of the array, up to which it is told as no contact: of pads without shear,
    15 % of the largest load of late. 0 where no load hides another."""
    sent: Sent = Sent()  # messages that a subscriber without losses has received by now


@dataclass(frozen=True, kw_only=True)
class InfoEvent(Event):
    """Description of board, protocol and array; repeated every second for late subscribers."""

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
    """State of the recording; published each second, and at each change."""

    topic: ClassVar[str] = "recording"
    state: Literal["off", "recording", "no-room", "failed"]
    reason: str
    file: str  # final name of the file being written; empty for none
    parts: int
    bytes_written: int
    free_mb: float
    reads_dropped: int  # number of reads of the port that are in no file
    reads_waiting: int  # number of items that wait for the disk


@dataclass(frozen=True, kw_only=True)
class CommandEvent(Event):
    """Command of a client, and its outcome."""

    topic: ClassVar[str] = "command"
    request_id: str
    command: str
    arguments: str  # arguments as a JSON object
    who: str  # name that the client gives itself
    key: str  # name of the CURVE key of the client; empty on plain endpoints
    uid: int  # user id of the client from the kernel; -1 where the transport does not provide it
    ok: bool
    reason: str  # reason for a refusal; empty where `ok`
    scan_index: int  # index of the first scan that the command applies to


AnyEvent = (
    SlipEvent
    | ContactEvent
    | GripEvent
    | ForceEvent
    | TextureEvent
    | ScanEvent
    | StatusEvent
    | InfoEvent
    | RecordingEvent
    | CommandEvent
)
EVENT_TYPES: dict[str, type[Event]] = {kind.topic: kind for kind in get_args(AnyEvent)}

"""Event types: results of the detectors, state of the board, outcome of commands.

What each field means, and in which unit, is in the schemas of protocols/events, which a test compares with
these types.

Instants are host monotonic seconds live, and in the clock of the file offline. They become epoch seconds
once, in `codec.encode`. No field is ever None or NaN, because controllers in other languages read it: an
unknown quantity has a value that shows it (a direction without information has ``direction_sd_deg = 180``).
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar

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
    suppressed: Suppressed = ""


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
    utilisation: float = 0.0
    utilisation_low: float = 0.0
    utilisation_high: float = 1.0
    friction: float = 0.0
    friction_low: float = 0.0
    friction_high: float = 0.0
    slipping_share: float = 0.0
    p_sliding: float = 0.0
    p_gross_50ms: float = 0.0
    p_gross_100ms: float = 0.0
    p_gross_300ms: float = 0.0
    load: float = 0.0
    shear_x: float = 0.0
    shear_y: float = 0.0
    torsion: float = 0.0
    unit: Literal["N", "relative"] = "relative"
    needed_load: float = 0.0
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
    # values of `calibration` with which no force is known in newtons; a nominal one is off by up to 2.7
    UNCALIBRATED: ClassVar[frozenset[str]] = frozenset(("nominal", "none"))
    fx_n: float = 0.0
    fy_n: float = 0.0
    fz_n: float = 0.0
    fx_sd_n: float = UNKNOWN_SD_N
    fy_sd_n: float = UNKNOWN_SD_N
    fz_sd_n: float = UNKNOWN_SD_N
    tx_nmm: float = 0.0
    ty_nmm: float = 0.0
    tz_nmm: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    taxel_fx_n: tuple[float, ...] = ()
    taxel_fy_n: tuple[float, ...] = ()
    taxel_fz_n: tuple[float, ...] = ()
    calibration: str = "none"
    saturated: bool = False
    beyond_range: bool = False
    channels_missing: int = 0
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
    period_sd_mm: float = 0.0
    period_min_mm: float = 0.0
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
    period_mm: float = 0.0
    period_sd_mm: float = 0.0
    angle_deg: float = 0.0
    angle_sd_deg: float = 0.0
    speed_mm_s: float = 0.0
    speed_sd_mm_s: float = 0.0
    period_min_mm: float = 0.0
    period_max_mm: float = 0.0
    speed_source: Literal["given", "estimated", "none"] = "none"
    frequency_hz: float = 0.0
    window_s: float = 0.0
    snr_db: float = 0.0
    stray_rad: float = 0.0
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
    age_s: float
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
    age_s: float
    clock_sd_s: float
    clock_rate_ppm: float
    rate_hz: float
    scans: int
    frames_corrupt: int
    scans_missing: int
    scans_duplicate: int
    restarts: int
    bytes_in: int
    bytes_framed: int
    bytes_discarded: int
    bytes_pending: int
    connects: int
    contact: ContactState
    slipping: bool
    uptime_s: float
    inhibited_s: float = 0.0
    scans_overrun: int = 0
    loop_lag_s: float = 0.0
    fits_late: int = 0
    loss_known: bool = True
    damage_known: bool = True
    path: ScanPath = "compiled"
    hidden_below: float = 0.0
    sent: Sent = Sent()


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
    zero: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RecordingEvent(Event):
    """State of the recording; published each second, and at each change."""

    topic: ClassVar[str] = "recording"
    state: Literal["off", "recording", "no-room", "failed"]
    reason: str
    file: str
    parts: int
    bytes_written: int
    free_mb: float
    reads_dropped: int
    reads_waiting: int


@dataclass(frozen=True, kw_only=True)
class CommandEvent(Event):
    """Command of a client, and its outcome."""

    topic: ClassVar[str] = "command"
    request_id: str
    command: str
    arguments: str
    who: str
    key: str
    uid: int
    ok: bool
    reason: str
    scan_index: int


EVENT_TYPES: dict[str, type[Event]] = {kind.topic: kind for kind in Event.__subclasses__()}

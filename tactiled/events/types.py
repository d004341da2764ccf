"""Events: what a detector, or the state of the board, says.

All instants are ``time_s``: host monotonic seconds live, the file's own clock offline. They become epoch
seconds once, in `codec.encode`. No field is ever None or NaN: what is unknown has a value that says so
(a direction without information has ``direction_sd_deg = 180``), because a controller in another
language will read it.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

UNKNOWN_SD_DEG = 180.0  # wider than the uniform distribution on a circle (104): "no idea"


@dataclass(frozen=True, kw_only=True)
class Event:
    """Root of all events; `time_s` is the physical instant that the event is about."""

    topic: ClassVar[str]
    time_s: float


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


@dataclass(frozen=True, kw_only=True)
class ContactEvent(Event):
    """The contact as a whole changed its state."""

    topic: ClassVar[str] = "contact"
    state: Literal["none", "loading", "holding", "sliding"]
    previous: Literal["none", "loading", "holding", "sliding"]
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


BoardState = Literal["no-device", "syncing", "running", "stalled", "fault"]


@dataclass(frozen=True, kw_only=True)
class StatusEvent(Event):
    """How the board, the line and the daemon are; published at 10 Hz whatever happens."""

    topic: ClassVar[str] = "status"
    state: BoardState
    valid: bool
    reason: str
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
    bytes_in: int
    bytes_framed: int
    bytes_discarded: int
    bytes_pending: int
    connects: int
    contact: Literal["none", "loading", "holding", "sliding"]
    slipping: bool
    uptime_s: float


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


AnyEvent = SlipEvent | ContactEvent | TextureEvent | ScanEvent | StatusEvent | InfoEvent
EVENT_TYPES: dict[str, type[Event]] = {
    kind.topic: kind for kind in (SlipEvent, ContactEvent, TextureEvent, ScanEvent, StatusEvent, InfoEvent)
}

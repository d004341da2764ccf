"""Status and info events, made from session, pipeline counters, layout and array."""

from tactiled import compiled
from tactiled.array import Array
from tactiled.daemon.board.session import Session
from tactiled.events.types import InfoEvent, StatusEvent
from tactiled.pipeline import Health
from tactiled.version import __version__
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout

# Largest age of a fresh scan, in units of `Session.silence_s`: one for a stall that is not detected yet, and
# one for bunching by the adapter. An older scan came out of a backlog.
_STALE_FACTOR = 2.0


def status_event(
    session: Session,
    health: Health,
    *,
    now_s: float,
    started_s: float,
    connects: int,
    inhibited_s: float,
    loop_lag_s: float,
    warning: str,
) -> StatusEvent:
    """Make the status event of `now_s`; `valid` requires a running board and a fresh newest scan."""
    # Before the first scan the age counts from the start of the daemon.
    age_s = max(0.0, now_s - max(health.newest_scan_s, started_s))
    fresh_s = _STALE_FACTOR * session.silence_s
    reason = session.reason(now_s)
    if session.state == "running" and age_s > fresh_s:
        reason = (
            f"scans come late: the newest was taken {age_s * 1000:.0f} ms ago, and {fresh_s * 1000:.0f} ms "
            "is the most; is the host or the line overloaded?"
        )
    return StatusEvent(
        time_s=now_s,
        state=session.state,
        valid=session.state == "running" and age_s <= fresh_s,
        reason=reason,
        warning=warning,
        age_s=age_s,
        clock_sd_s=health.clock_sd_s,
        clock_rate_ppm=health.clock_rate_ppm,
        rate_hz=health.rate_hz,
        scans=health.scans,
        frames_corrupt=health.frames_corrupt,
        scans_missing=health.scans_missing,
        scans_overrun=health.scans_overrun,
        scans_duplicate=health.scans_duplicate,
        restarts=health.restarts,
        bytes_in=health.bytes_in,
        bytes_framed=health.bytes_framed,
        bytes_discarded=health.bytes_discarded,
        bytes_pending=health.bytes_pending,
        connects=connects,
        contact=health.contact,
        slipping=health.slipping,
        uptime_s=now_s - started_s,
        inhibited_s=inhibited_s,
        loop_lag_s=loop_lag_s,
        fits_late=health.fits_late,
        loss_known=health.loss_known,
        damage_known=health.damage_known,
        path="python" if compiled.reason_plain else "compiled",
    )


def info_event(hello: Hello, layout: Layout, array: Array, now_s: float) -> InfoEvent:
    """Make the info event from the hello of the board and the configured layout and array."""
    return InfoEvent(
        time_s=now_s,
        board_serial=hello.board_serial,
        firmware_version=hello.firmware_version,
        protocol=layout.name,
        protocol_version=hello.protocol_version,
        array_id=hello.array_id,
        channels=layout.n_channels,
        taxels=array.n_taxels,
        x_mm=tuple(array.x_mm.tolist()),
        y_mm=tuple(array.y_mm.tolist()),
        channel_names=array.channel_name,
        rate_hz=hello.rate_hz,
        volts_per_count=hello.volts_per_count,
        channel_offset_s=hello.channel_offset_s or (0.0,) * layout.n_channels,
        tactiled_version=__version__,
    )

"""Slip events made by hand."""

from tactiled.events.types import SlipEvent


def slip_at(time_s: float, direction_deg: float, direction_sd_deg: float = 0.0) -> SlipEvent:
    """Onset of a gross slip, detected when it happened."""
    return SlipEvent(
        time_s=time_s,
        state="onset",
        kind="gross",
        onset_s=time_s,
        onset_sd_s=0.0,
        direction_deg=direction_deg,
        direction_sd_deg=direction_sd_deg,
        confidence=1.0,
        taxels=(),
        detector="truth",
        statistic=0.0,
        threshold=0.0,
        valid=True,
        detected_s=time_s,
    )

"""Slip events: onset, transition to gross slip, end."""

import dataclasses

import numpy as np

from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.kink import KinkEstimate
from tactiled.detect.slip.scan_evidence import ScanEvidence, SlipDescription
from tactiled.events.types import SlipEvent

DETECTOR = "coherent"


def onset(
    now: ScanEvidence,
    onset_s: float,
    kink: KinkEstimate,
    description: SlipDescription,
    evidence: ShearEvidence,
    statistic: float,
) -> SlipEvent:
    """Make the onset event of a slip; `kink` holds the uncertainty of its instant."""
    return SlipEvent(
        time_s=onset_s,
        state="onset",
        kind="incipient",
        onset_s=onset_s,
        onset_sd_s=float(np.hypot(kink.sd_scans / now.rate_hz, now.time_sd_s)),
        direction_deg=description.direction_deg,
        direction_sd_deg=description.direction_sd_deg,
        confidence=description.confidence,
        taxels=description.taxels,
        detector=DETECTOR,
        statistic=statistic,
        threshold=evidence.threshold,
        valid=not now.is_late,
        detected_s=now.time_s,
    )


def gross(event: SlipEvent, now: ScanEvidence, gross_s: float, sd_scans: float) -> SlipEvent:
    """Make the gross-slip event; all other fields are those of the onset."""
    return dataclasses.replace(
        event,
        kind="gross",
        time_s=gross_s,
        onset_s=gross_s,
        onset_sd_s=float(np.hypot(sd_scans / now.rate_hz, now.time_sd_s)),
        valid=not now.is_late,
        detected_s=now.time_s,
    )


def ended(event: SlipEvent, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
    """Make the end event; all other fields are those of the newest event of the slip."""
    return dataclasses.replace(event, state="end", time_s=ended_s, detected_s=detected_s, valid=valid)

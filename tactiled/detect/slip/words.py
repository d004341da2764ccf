"""Events of a slip: its onset, its deepening, its end."""

import dataclasses

import numpy as np

from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.kink import KinkEstimate
from tactiled.detect.slip.witness import ScanEvidence, SlipDescription
from tactiled.events.types import SlipEvent

DETECTOR = "coherent"


def onset(
    now: ScanEvidence,
    onset_s: float,
    kink: KinkEstimate,
    said: SlipDescription,
    evidence: ShearEvidence,
    statistic: float,
) -> SlipEvent:
    """A slip begins; `kink` tells how well its instant is known."""
    return SlipEvent(
        time_s=onset_s,
        state="onset",
        kind="incipient",
        onset_s=onset_s,
        onset_sd_s=float(np.hypot(kink.sd_scans / now.rate_hz, now.time_sd_s)),
        direction_deg=said.direction_deg,
        direction_sd_deg=said.direction_sd_deg,
        confidence=said.confidence,
        taxels=said.taxels,
        detector=DETECTOR,
        statistic=statistic,
        threshold=evidence.threshold,
        valid=not now.is_late,
        detected_s=now.time_s,
    )


def gross(event: SlipEvent, now: ScanEvidence, gross_s: float, sd_scans: float) -> SlipEvent:
    """All of it slips; the rest is as its onset had it."""
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
    """It ends; the event repeats what the newest before said."""
    return dataclasses.replace(event, state="end", time_s=ended_s, detected_s=detected_s, valid=valid)

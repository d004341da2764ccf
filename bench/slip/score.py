"""Scores of slip events against truth: latency, misses, false alarms, direction, stated sigmas.

An event counts from the end of the scan that completed its evidence: `detected_s` plus `SCAN_SPAN_S`. Before
the tangential load grows (`FirstSlip.load_grows_s`) it is a false alarm, unless a tenth or more of the
contact slips or is about to, and the event says "incipient". From then until the slip is over, or `GRACE_S`
after gross slip if that is later, the first event is the detection; a slip without one is missed. The onset
and the sigma that an event states have no influence on this.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.slip.scenes import SCAN_SPAN_S, PlayedScene
from bench.slip.truth import FirstSlip
from tactiled.array import FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent

SETTLE_S = 1.0  # an alarm so soon after the press belongs to the press: a third of a long filter
GRACE_S = 0.5  # a slip of milliseconds (stick-slip) may be reported after its end


@dataclass(frozen=True)
class SlipScore:
    """Scores of one detector on one slip; NaN where there was no such event.

    Attributes
    ----------
    latency_s : float
        From the beginning of shear to the first event since the load grows.
    lead_s : float
        From that event to gross slip; positive where the event comes first.
    incipient_latency_s, gross_latency_s : float
        First event of that kind, after the slip became incipient or gross; negative is before.
    onset_error_s, onset_sd_s : float
        Stated onset of the first event, against the beginning of shear.
    gross_onset_error_s, gross_onset_sd_s : float
        Of the first gross event, against gross slip.
    direction_error_deg, direction_sd_deg : float
        Of the first event that states a direction; NaN where truth has none either.
    n_early : int
        False alarms before the load grew, those of the press excluded.
    n_on_press : int
        False alarms until `SETTLE_S` after the press.
    is_ended_early : bool
        The slip was reported as ended while it went on, and never as gross.
    """

    latency_s: float
    lead_s: float
    incipient_latency_s: float
    gross_latency_s: float
    onset_error_s: float
    onset_sd_s: float
    gross_onset_error_s: float
    gross_onset_sd_s: float
    direction_error_deg: float
    direction_sd_deg: float
    n_early: int
    n_on_press: int
    is_ended_early: bool = False


def complete_s(event: SlipEvent) -> float:
    """End of the scan with which the evidence was complete."""
    return event.detected_s + SCAN_SPAN_S


def onsets(events: Sequence[Event]) -> list[SlipEvent]:
    """Onsets that are not suppressed, in order of detection."""
    return [e for e in events if isinstance(e, SlipEvent) and e.state == "onset" and e.valid]


def score_slip(events: Sequence[Event], played: PlayedScene, slip: FirstSlip) -> SlipScore:
    """Score the events of a whole scene against its first gross slip."""
    reported = onsets(events)
    false = [e for e in reported if complete_s(e) < slip.load_grows_s and _is_false(e, played)]
    n_on_press = sum(_is_on_press(e, played) for e in false)
    until_s = max(slip.end_s, slip.gross_s + GRACE_S)
    of_slip = [e for e in reported if slip.load_grows_s <= complete_s(e) <= until_s]
    first = of_slip[0] if of_slip else None
    gross = next((e for e in of_slip if e.kind == "gross"), None)
    ends = [e for e in events if isinstance(e, SlipEvent) and e.state == "end"]
    direction_error_deg, direction_sd_deg = _direction_error_deg(of_slip, slip)

    def since(kind: str, true_s: float) -> float:
        return next((complete_s(e) - true_s for e in of_slip if e.kind == kind), np.nan)

    return SlipScore(
        latency_s=complete_s(first) - slip.shear_s if first else np.nan,
        lead_s=slip.gross_s - complete_s(first) if first else np.nan,
        incipient_latency_s=since("incipient", slip.incipient_s),
        gross_latency_s=since("gross", slip.gross_s),
        onset_error_s=first.onset_s - slip.shear_s if first else np.nan,
        onset_sd_s=first.onset_sd_s if first else np.nan,
        gross_onset_error_s=gross.onset_s - slip.gross_s if gross else np.nan,
        gross_onset_sd_s=gross.onset_sd_s if gross else np.nan,
        direction_error_deg=direction_error_deg,
        direction_sd_deg=direction_sd_deg,
        n_early=len(false) - n_on_press,
        n_on_press=n_on_press,
        is_ended_early=gross is None and any(slip.gross_s < e.detected_s < slip.end_s for e in ends),
    )


class AlarmCounts(NamedTuple):
    """Events of a scene without gross slip.

    Attributes
    ----------
    n_false, n_gross, n_on_press : int
        False alarms; those among them of kind "gross"; those among them until `SETTLE_S` after the press.
    n_partial : int
        Correct reports of incipient slip.
    """

    n_false: int
    n_gross: int
    n_on_press: int
    n_partial: int


def count_alarms(events: Sequence[Event], played: PlayedScene) -> AlarmCounts:
    """Count the events of a scene without gross slip."""
    reported = onsets(events)
    false = [e for e in reported if _is_false(e, played)]
    return AlarmCounts(
        len(false),
        sum(e.kind == "gross" for e in false),
        sum(_is_on_press(e, played) for e in false),
        len(reported) - len(false),
    )


def _is_false(event: SlipEvent, played: PlayedScene) -> bool:
    """Return whether an event outside a gross slip is false: nothing slips, or its kind is "gross"."""
    slips = any(start_s <= complete_s(event) <= end_s + GRACE_S for start_s, end_s in played.slipping)
    return event.kind == "gross" or not slips


def _is_on_press(event: SlipEvent, played: PlayedScene) -> bool:
    return complete_s(event) < played.press_end_s + SETTLE_S


def _direction_error_deg(of_slip: Sequence[SlipEvent], slip: FirstSlip) -> tuple[float, float]:
    stating = [e for e in of_slip if e.direction_sd_deg < UNKNOWN_SD_DEG]
    if not stating or slip.direction_deg is None:
        return np.nan, np.nan
    error_deg = stating[0].direction_deg - slip.direction_deg
    return (error_deg + 180.0) % 360.0 - 180.0, stating[0].direction_sd_deg


def quantile(latency_s: FloatArray | Sequence[float], part: float) -> float:
    """Quantile of latencies, where NaN is a miss and later than any; NaN of none."""
    ordered = np.where(np.isnan(latency_s), np.inf, np.asarray(latency_s, dtype=np.float64))
    return float(np.quantile(ordered, part, method="inverted_cdf")) if len(ordered) else np.nan


def median(latency_s: FloatArray | Sequence[float]) -> float:
    """Median of latencies, see `quantile`."""
    return quantile(latency_s, 0.5)


def coverage(error: FloatArray, sd: FloatArray) -> float:
    """Part of errors within one stated sigma; NaN of none."""
    stated = np.isfinite(error) & np.isfinite(sd)
    return float((np.abs(error[stated]) <= sd[stated]).mean()) if stated.any() else np.nan

"""What a slip event was worth: latency from true instants, misses, false alarms, direction, stated sigmas.

An event is known when the scan that completed its evidence is complete: `detected_s` plus the scan's own
`SCAN_SPAN_S`. Before the tangential load grows at all (`slip_truth`) it is a false alarm, except on the way
to or in a slip of a tenth or more of the contact (it may say "incipient" there, never "gross"). From then
until the slip is over, or `GRACE_S` after it became gross if that is later, it is the detection; none by then
is a miss. What an event states, its instant or sigma, has no say in this.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.slip.scenes import SCAN_SPAN_S, Played
from bench.slip.truth import TrueInstants
from tactiled.events.types import UNKNOWN_SD_DEG, Event, SlipEvent

FloatArray = NDArray[np.float64]

SETTLE_S = 1.0  # after a press ended, an alarm is still the press's: the third of a long filter
GRACE_S = 0.5  # a slip of milliseconds (stick-slip) may still be said of its own


@dataclass(frozen=True)
class Found:
    """How a detector did on one slip. NaN where it said nothing of the kind.

    Attributes
    ----------
    first_s : float
        First event since the load grew, after `t_shear`.
    to_gross_s : float
        From that event to `t_gross`: positive is early enough.
    incipient_s, gross_s : float
        First event of that kind since the load grew, after `t_incipient` and `t_gross`: negative is before.
    onset_error_s, onset_sd_s : float
        Stated onset of the first event, against `t_shear`: the first kink is all that it can know of.
    gross_onset_error_s, gross_onset_sd_s : float
        Of the first gross event, against `t_gross`.
    direction_error_deg, direction_sd_deg : float
        Of the first event about this slip that states a direction; NaN where truth has none too.
    early : int
        False alarms before the load grew, the press not counted.
    on_press : int
        False alarms while loading.
    let_go : bool
        An incipient slip was said to have ended while all went on slipping, and gross slip was not said.
    """

    first_s: float
    to_gross_s: float
    incipient_s: float
    gross_s: float
    onset_error_s: float
    onset_sd_s: float
    gross_onset_error_s: float
    gross_onset_sd_s: float
    direction_error_deg: float
    direction_sd_deg: float
    early: int
    on_press: int
    let_go: bool = False


def known_s(event: SlipEvent) -> float:
    """Instant at which the scan with the evidence is complete."""
    return event.detected_s + SCAN_SPAN_S


def onsets(events: Sequence[Event]) -> list[SlipEvent]:
    """Slip onsets that may be acted on, in order of evidence."""
    return [e for e in events if isinstance(e, SlipEvent) and e.state == "onset" and e.valid]


def score_slip(events: Sequence[Event], played: Played, slip: TrueInstants) -> Found:
    """Score the events of a whole scene against its first gross slip."""
    said = onsets(events)
    before = [e for e in said if known_s(e) < slip.grows_s and is_false(e, played)]
    on_press = sum(_is_on_press(e, played) for e in before)
    until_s = max(slip.end_s, slip.gross_s + GRACE_S)
    about = [e for e in said if slip.grows_s <= known_s(e) <= until_s]
    first = about[0] if about else None
    gross = next((e for e in about if e.kind == "gross"), None)
    turn_deg, turn_sd_deg = _direction_error_deg(about, slip)
    return Found(
        first_s=known_s(first) - slip.shear_s if first else np.nan,
        to_gross_s=slip.gross_s - known_s(first) if first else np.nan,
        incipient_s=_since(about, "incipient", slip.incipient_s),
        gross_s=_since(about, "gross", slip.gross_s),
        onset_error_s=first.onset_s - slip.shear_s if first else np.nan,
        onset_sd_s=first.onset_sd_s if first else np.nan,
        gross_onset_error_s=gross.onset_s - slip.gross_s if gross else np.nan,
        gross_onset_sd_s=gross.onset_sd_s if gross else np.nan,
        direction_error_deg=turn_deg,
        direction_sd_deg=turn_sd_deg,
        early=len(before) - on_press,
        on_press=on_press,
        let_go=gross is None and any(slip.gross_s < end.detected_s < slip.end_s for end in _ends(events)),
    )


def _ends(events: Sequence[Event]) -> list[SlipEvent]:
    return [e for e in events if isinstance(e, SlipEvent) and e.state == "end"]


def is_false(event: SlipEvent, played: Played) -> bool:
    """Whether an event outside a gross slip is a false alarm: nothing slips, or not all that it says."""
    slips = any(start <= known_s(event) <= end + GRACE_S for start, end in played.slipping)
    return event.kind == "gross" or not slips


class Tally(NamedTuple):
    """Events of a scene that never slips as a whole.

    Attributes
    ----------
    false, gross, on_press : int
        False alarms; those of them that say "gross"; those of them while loading.
    partial : int
        Events that rightly say that a part slips.
    """

    false: int
    gross: int
    on_press: int
    partial: int


def tally(events: Sequence[Event], played: Played) -> Tally:
    """Count the events of a scene that never slips as a whole."""
    said = onsets(events)
    false = [e for e in said if is_false(e, played)]
    return Tally(
        len(false),
        sum(e.kind == "gross" for e in false),
        sum(_is_on_press(e, played) for e in false),
        len(said) - len(false),
    )


def _is_on_press(event: SlipEvent, played: Played) -> bool:
    return known_s(event) < played.held_s + SETTLE_S


def median(values: FloatArray | Sequence[float]) -> float:
    """Of latencies of which NaN is a miss: a miss is later than any."""
    return quantile(values, 0.5)


def quantile(values: FloatArray | Sequence[float], part: float) -> float:
    """Of latencies of which NaN is a miss; infinite where it falls among the misses, NaN of none at all."""
    sized = np.where(np.isnan(values), np.inf, np.asarray(values, dtype=np.float64))
    return float(np.quantile(sized, part, method="inverted_cdf")) if len(sized) else np.nan


def coverage(error: FloatArray, sd: FloatArray) -> float:
    """Part of errors within one stated sigma; NaN of none."""
    stated = np.isfinite(error) & np.isfinite(sd)
    return float((np.abs(error[stated]) <= sd[stated]).mean()) if stated.any() else np.nan


def _since(about: Sequence[SlipEvent], kind: str, true_s: float) -> float:
    return next((known_s(e) - true_s for e in about if e.kind == kind), np.nan)


def _direction_error_deg(about: Sequence[SlipEvent], slip: TrueInstants) -> tuple[float, float]:
    stating = [e for e in about if e.direction_sd_deg < UNKNOWN_SD_DEG]
    if not stating or slip.direction_deg is None:
        return np.nan, np.nan
    off_deg = stating[0].direction_deg - slip.direction_deg
    return (off_deg + 180.0) % 360.0 - 180.0, stating[0].direction_sd_deg

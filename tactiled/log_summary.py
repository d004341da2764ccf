"""Lines for people on a log that was analysed: rate, range, contact, slip, and why an event is missing."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent, TextureEvent

# Below a zero which was measured under load: part of the scans, and of the range (less is noise or drift),
# and of the span of the pressure (less is drift of a sensor that was pressed later).
_BELOW_SCANS, _BELOW_RANGE, _BELOW_SPAN = 0.05, 1 / 1024, 0.2
# Correlation of the shear of two pads. Fingers that hold one object have 0.9 and more.
_OPPOSED = 0.7


def summary(
    array: Array,
    time_s: FloatArray,
    readings: FloatArray,
    events: Sequence[Event],
    topics: Collection[str],
    speed_mm_s: float,
    *,
    sliding_is_given: bool,
) -> Iterator[str]:
    """Yield the lines.

    Parameters
    ----------
    array : Array
    time_s : (n,) float64
    readings : (n, channels) float64
        As in the file.
    events : sequence of Event
        Of all topics that were computed.
    topics : collection of str
        Topics that were asked for.
    speed_mm_s : float
        Sliding speed that was given; 0 for none.
    sliding_is_given : bool
    """
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    spacing_s = np.diff(time_s)
    jitter = float(np.abs(spacing_s - np.median(spacing_s)).mean() * rate_hz)
    yield (
        f"{len(time_s)} scans in {time_s[-1] - time_s[0]:.4g} s: {rate_hz:.4g} Hz, "
        f"spacing varies by {100 * jitter:.1f} % on average"
    )
    yield _range_used(array, readings)
    contact_s, slip_s = _contact_and_slip_s(events, float(time_s[-1]))
    # For other topics, no detector of contact has run.
    if {"slip", "contact"} & set(topics) or ("texture" in topics and not sliding_is_given):
        yield f"in contact {contact_s:.1f} s, in slip {slip_s:.1f} s"
        yield from _loaded_zero(array, time_s, readings)
        if contact_s == 0:
            yield (
                "no contact: is the zero right? --tare-s 0.3 takes the first 0.3 s as zero, `sign` in the "
                "array file turns a channel round, `[contact]` sets the level"
            )
        elif slip_s == 0 and "slip" in topics and not sliding_is_given:
            yield (
                "no slip: if the log slides all the same, --sliding says so"
                + ("; --setting fast reports it at a lower probability" if array.has_shear else "")
            )
    if "grip" in topics and array.has_shear and not any(isinstance(event, GripEvent) for event in events):
        yield "no grip: the mean load of the taxels must exceed 0.5 % of the array's `range`"
    if {"slip", "grip"} & set(topics):
        yield from _opposed_pads(array, readings)
    if "texture" in topics:
        yield from _texture(array, events, rate_hz, speed_mm_s, slip_s > 0 or sliding_is_given)


def _loaded_zero(array: Array, time_s: FloatArray, readings: FloatArray) -> Iterator[str]:
    """Yield a line where the pressure falls below the zero that was taken from the beginning of the log."""
    weights = array.normal_weights()
    first = time_s < time_s[0] + array.zero_first_s
    if not first.any() or not weights.any() or array.unit == "uT":  # a load may lower a field
        return
    pressure = np.nan_to_num(readings - readings[first].mean(axis=0)) @ weights.mean(axis=0)
    low, high = np.quantile(pressure, [_BELOW_SCANS, 1 - _BELOW_SCANS]).tolist()
    if -low > max(_BELOW_RANGE * (array.high - array.low), _BELOW_SPAN * (high - low)):
        yield (
            f"pressure falls to {-low:.3g} {array.unit} below the zero: was the sensor touched in the first "
            f"{array.zero_first_s:g} s? Then `zero` must be a number, or one for each channel"
        )


def _opposed_pads(array: Array, readings: FloatArray) -> Iterator[str]:
    """Yield a line for each pad whose shear opposes that of the first one."""
    weights = array.shear_weights()
    shear = []
    for pad in sorted(set(array.pad.tolist())):
        along = weights[:, array.pad == pad].sum(axis=1)
        felt = np.nan_to_num((readings - np.nanmedian(readings, axis=0)) @ along.T)
        shear.append(felt[:, 0] + 1j * felt[:, 1])
    for number, of_pad in enumerate(shear[1:], start=1):
        size = float(np.sqrt(np.vdot(of_pad, of_pad).real * np.vdot(shear[0], shear[0]).real))
        agreement = np.vdot(of_pad, shear[0]) / size if size > 0 else 0.0
        if abs(agreement) > _OPPOSED and agreement.real < 0:
            yield (
                f"shear of pad {number} opposes that of pad 0, and the two cancel: if these are fingers that "
                f"face each other, turn its axes by about {np.degrees(np.angle(agreement)) % 360:.0f} deg "
                "(`axes_deg` in its grid)"
            )


def _range_used(array: Array, readings: FloatArray) -> str:
    finite = readings[np.isfinite(readings)]
    if not finite.size:
        return "no readings"
    low, high = float(finite.min()), float(finite.max())
    part = 100 * (high - low) / (array.high - array.low)
    lost = int((~array.in_range(readings)).sum())
    words = f"readings from {low:g} to {high:g} {array.unit}: {part:.2g} % of the range"
    return words + (f"; {lost} missing or saturated" if lost else "")


def _contact_and_slip_s(events: Sequence[Event], end_s: float) -> tuple[float, float]:
    """Total times in contact and in slip."""
    totals = [0.0, 0.0]
    began: list[float | None] = [None, None]
    for event in events:
        if isinstance(event, ContactEvent):
            which, is_on = 0, event.state != "none"
        elif isinstance(event, SlipEvent):
            which, is_on = 1, event.state == "onset"
        else:
            continue
        start_s = began[which]
        if is_on and start_s is None:
            began[which] = event.evidence_s
        elif not is_on and start_s is not None:
            totals[which] += event.evidence_s - start_s
            began[which] = None
    for which, start_s in enumerate(began):
        if start_s is not None:
            totals[which] += end_s - start_s
    return totals[0], totals[1]


def _texture(
    array: Array, events: Sequence[Event], rate_hz: float, speed_mm_s: float, slides: bool
) -> Iterator[str]:
    told = Counter(event.status for event in events if isinstance(event, TextureEvent))
    if told:
        yield "texture: " + ", ".join(f"{status} {n}" for status, n in told.most_common())
    if told["ok"] or told["period-only"]:
        return
    if not slides:
        yield "no texture: nothing slides; --sliding or --sliding FROM:TO says what does"
    elif not told:
        yield (
            "no texture: the slides were too short, or their ripples too weak, for a first answer "
            "(86 scans of sliding at least)"
        )
    elif speed_mm_s == 0 and not (array.has_shear and array.has_places):
        yield "no period: without shear channels it needs the sliding speed (--speed)"
    elif speed_mm_s:
        finest_mm = speed_mm_s / (0.45 * rate_hz)
        yield (
            f"no period: at {rate_hz:.4g} Hz and this speed, grooves must exceed {finest_mm:.2g} mm, "
            "and be within --period (0.5:20 if left out)"
        )

"""Lines for people on a log that was analysed: rate, range, contact, slip, and why an event is missing."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.events.types import ContactEvent, Event, SlipEvent, TextureEvent


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
    is_forces_alone = set(topics) == {"force"}  # no detector of contact has run
    if (not sliding_is_given and not is_forces_alone) or {"slip", "contact"} & set(topics):
        yield f"in contact {contact_s:.1f} s, in slip {slip_s:.1f} s"
        if contact_s == 0:
            yield (
                "no contact: is the zero right? --tare-s 0.3 takes the first 0.3 s as zero, `sign` in the "
                "array file turns a channel round, `[contact]` sets the level"
            )
        elif slip_s == 0 and "slip" in topics and not sliding_is_given:
            yield (
                "no slip: --sliding says that the log slides"
                + (", as from its beginning, and --setting fast needs less shear" if array.has_shear else "")
            )
    if "texture" in topics:
        yield from _texture(array, events, rate_hz, speed_mm_s, slip_s > 0 or sliding_is_given)


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
        yield "no texture: the log ended before a window was full"
    elif speed_mm_s == 0 and not (array.has_shear and array.has_places):
        yield "no period: without shear channels it needs the sliding speed (--speed)"
    elif speed_mm_s:
        finest_mm = speed_mm_s / (0.45 * rate_hz)
        yield f"no period: at {rate_hz:.3g} Hz and this speed, grooves must exceed {finest_mm:.2g} mm"

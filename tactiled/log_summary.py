"""Lines for people on a log that was analysed: rate, range, contact, slip, and why an event is missing."""

import math
from collections import Counter
from collections.abc import Collection, Iterator

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent, TextureEvent

# Below a zero which was measured under load: part of the scans, and of the range (less is noise or drift),
# and of the span of the pressure (less is drift of a sensor that was pressed later).
_BELOW_SCANS, _BELOW_RANGE, _BELOW_SPAN = 0.05, 1 / 1024, 0.2
_BACK_PART = 0.2  # of that: a pressure which ends so near to its zero was free at both ends
REST_S = 0.3  # of the beginning of a log, as most array files take for their zero
_FAR_ZERO = 0.02  # of the range, from readings at the beginning
# Correlation of the shear of two pads. Fingers that hold one object have 0.9 and more.
_OPPOSED = 0.7


# Readings of which the summary is computed: every scan of a log of 19 minutes of 36 channels at 100 Hz
# (32 MB), an even part of the scans of a longer one.
_MOST_VALUES = 1 << 22
_PIECE_SCANS = 1000  # that are taken at once: a row becomes several Python objects before it is thinned


def percent(part: float) -> str:
    """Return a part in percent, two digits at least."""
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


class LogTally:
    """Figures of a log of any length, taken while it is processed; its memory is bounded."""

    def __init__(self, array: Array, board: str) -> None:
        self.array = array
        self.board = board
        """Serial number of the board whose recording it is; else the name of the file."""
        self.keeps_events = False
        self.events: list[Event] = []
        """All events, where `keeps_events`."""
        self.n_events = self.n_printed = 0
        self.n_scans = 0
        self.n_repeats = 0
        self.first_s = self.last_s = math.nan
        self.low, self.high = math.inf, -math.inf
        self.n_missing = self.n_outside = 0  # readings: none, and at the limits of the range or beyond
        self.lasted_s = {"contact": 0.0, "slip": 0.0, "gross": 0.0}
        """Times in contact, in slip and in gross slip, as reported."""
        self.has_grip = False
        self.textures: Counter[str] = Counter()
        self._began: dict[str, float] = {}
        self._most = max(2, _MOST_VALUES // array.n_channels)
        self._stride = 1
        self._scans: list[tuple[float, float, FloatArray]] = []

    def add_scans(self, time_s: FloatArray, readings: FloatArray) -> None:
        """Take consecutive scans: times (n,), readings (n, channels) as in the file."""
        for start in range(0, len(time_s), _PIECE_SCANS):
            piece = slice(start, start + _PIECE_SCANS)
            self._add_piece(time_s[piece], readings[piece])

    def _add_piece(self, time_s: FloatArray, readings: FloatArray) -> None:
        if not self.n_scans:
            self.first_s = float(time_s[0])
        spacing_s = np.diff(time_s, prepend=self.last_s)
        self.last_s = float(time_s[-1])
        is_finite = np.isfinite(readings)
        self.low = min(self.low, float(readings.min(where=is_finite, initial=np.inf)))
        self.high = max(self.high, float(readings.max(where=is_finite, initial=-np.inf)))
        self.n_missing += readings.size - int(is_finite.sum())
        self.n_outside += int((is_finite & ~self.array.in_range(readings)).sum())
        for k in range(-self.n_scans % self._stride, len(time_s), self._stride):
            self._scans.append((float(time_s[k]), float(spacing_s[k]), readings[k].copy()))
        self.n_scans += len(time_s)
        while len(self._scans) > self._most:
            del self._scans[1::2]
            self._stride *= 2

    def add_event(self, event: Event) -> None:
        """Take the next event."""
        if self.keeps_events:
            self.events.append(event)
        if isinstance(event, TextureEvent):
            self.textures[event.status] += 1
        self.has_grip = self.has_grip or isinstance(event, GripEvent)
        if isinstance(event, ContactEvent):
            is_on = event.state != "none"
        elif isinstance(event, SlipEvent):
            is_on = event.state == "onset"
            if event.kind == "gross":
                self._note("gross", event.evidence_s, is_on=is_on)
        else:
            return
        self._note(event.topic, event.evidence_s, is_on=is_on)

    def finish(self) -> None:
        """End what lasts to the end of the log."""
        for what in list(self._began):
            self._note(what, self.last_s, is_on=False)

    @property
    def time_s(self) -> FloatArray:
        """Times of the scans that were kept (k,)."""
        return np.array([time_s for time_s, _, _ in self._scans])

    @property
    def spacing_s(self) -> FloatArray:
        """Times from the scan before to each scan that was kept (k,), without the first scan."""
        return np.array([spacing_s for _, spacing_s, _ in self._scans[1:]])

    @property
    def readings(self) -> FloatArray:
        """Readings of the scans that were kept (k, channels)."""
        return np.array([row for _, _, row in self._scans])

    def _note(self, what: str, time_s: float, *, is_on: bool) -> None:
        if is_on:
            self._began.setdefault(what, time_s)
        elif (began_s := self._began.pop(what, None)) is not None:
            self.lasted_s[what] += time_s - began_s


def summary(
    tally: LogTally, topics: Collection[str], speed_mm_s: float, *, sliding_is_given: bool
) -> Iterator[str]:
    """Yield the lines on a finished tally: `topics` were asked for; a speed of 0 was not given."""
    array, duration_s = tally.array, tally.last_s - tally.first_s
    if duration_s == 0:
        yield "1 scan: a rate and events need two or more"
        return
    rate_hz = (tally.n_scans - 1) / duration_s
    spacing_s = tally.spacing_s
    jitter = float(np.abs(spacing_s - np.median(spacing_s)).mean() * rate_hz)
    yield (
        f"{tally.n_scans} scans in {duration_s:.4g} s: {rate_hz:.4g} Hz, "
        f"spacing varies by {100 * jitter:.1f} % on average"
    )
    if tally.n_repeats:
        yield (
            f"{tally.n_repeats} of them repeat the one before and are left out: the sensor gives "
            f"{rate_hz * (1 - tally.n_repeats / tally.n_scans):.3g} scans a second"
        )
    yield _range_used(tally)
    # For other topics, no detector of contact has run.
    if {"slip", "contact"} & set(topics) or ("texture" in topics and not sliding_is_given):
        contact_s, slip_s, gross_s = tally.lasted_s.values()
        yield f"in contact {contact_s:.1f} s, in slip {slip_s:.1f} s, in gross slip {gross_s:.1f} s"
        yield from _lost_zero(array, tally.time_s, tally.readings)
        yield from _loaded_zero(array, tally.time_s, tally.readings)
        yield from _far_zero(array, tally.time_s, tally.readings)
        if tally.lasted_s["contact"] == 0:
            tare = "" if array.zero_first_s else "--tare-s 0.3 takes the first 0.3 s as zero, "
            yield (
                f"no contact: is the zero right? {tare}`sign` in the array file turns a channel round, "
                "`[contact]` sets the level"
            )
        elif tally.lasted_s["slip"] == 0 and "slip" in topics and not sliding_is_given:
            yield (
                "no slip: if the log slides all the same, --sliding says so"
                + ("; --setting fast reports it at a lower probability" if array.measures_ratio else "")
            )
    if "grip" in topics and array.measures_ratio and not tally.has_grip:
        yield "no grip: the mean load of the taxels must exceed 0.5 % of the array's `range`"
    if {"slip", "grip"} & set(topics):
        yield from _opposed_pads(array, tally.readings)
    if "texture" in topics:
        has_slip = tally.lasted_s["slip"] > 0 or sliding_is_given
        yield from _texture(array, tally.textures, rate_hz, speed_mm_s, has_slip)


def channels_without_zero(array: Array, time_s: FloatArray, readings: FloatArray) -> list[int]:
    """Return the channels with valid readings, none of them from the time that gives the zero."""
    first = time_s < time_s[0] + array.zero_first_s
    valid = array.in_range(readings)
    lost: list[int] = np.flatnonzero(valid.any(axis=0) & ~valid[first].any(axis=0)).tolist()
    return lost if first.any() else []


def _lost_zero(array: Array, time_s: FloatArray, readings: FloatArray) -> Iterator[str]:
    """Yield a line on channels that are left out because their first readings come too late."""
    if lost := channels_without_zero(array, time_s, readings):
        yield (
            f"channels {lost} have no valid reading in the first {array.zero_first_s:g} s to be their zero, "
            "and are left out: write numbers as `zero` in the array file"
        )


def far_from_zero(array: Array, rest: FloatArray) -> NDArray[np.int64]:
    """Return the channels whose readings at the beginning of a log (channels,) are far from their zero."""
    far = np.abs(rest - array.zero) > _FAR_ZERO * (array.high - array.low)
    return np.asarray(np.flatnonzero(far & (array.zero_first_s == 0)))


def _far_zero(array: Array, time_s: FloatArray, readings: FloatArray) -> Iterator[str]:
    """Yield a line where a log begins far from a zero that the array file states."""
    first = np.ma.masked_invalid(readings[time_s < time_s[0] + REST_S])
    rest = np.ma.filled(np.ma.median(first, axis=0), np.nan)  # type: ignore[no-untyped-call]
    if (far := far_from_zero(array, rest)).size:
        yield (
            f"channels that begin far from the `zero` of the array: {len(far)}, by up to "
            f"{np.nanmax(np.abs(rest - array.zero)):.4g} {array.unit}: if nothing touches the sensor then, "
            "give --tare-s 0.3, or write zero = 'first 0.3 s' in the array file"
        )


def _loaded_zero(array: Array, time_s: FloatArray, readings: FloatArray) -> Iterator[str]:
    """Yield a line where the pressure falls below the zero that was taken from the beginning of the log."""
    weights = array.normal_weights()
    first = time_s < time_s[0] + array.zero_first_s
    if not first.any() or not weights.any() or array.unit == "uT":  # a load may lower a field
        return
    readings = np.where(array.in_range(readings), readings, np.nan)
    zero = np.array([np.nanmedian(one) if np.isfinite(one).any() else np.nan for one in readings[first].T])
    pressure = np.nan_to_num(readings - zero) @ weights.mean(axis=0)
    low, high = np.quantile(pressure, [_BELOW_SCANS, 1 - _BELOW_SCANS]).tolist()
    if -low > max(_BELOW_RANGE * (array.high - array.low), _BELOW_SPAN * (high - low)):
        at_lowest = readings[pressure <= low]
        lowest = [
            float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else 0.0 for one in at_lowest.T
        ]
        found = ", ".join(f"{zero:.5g}" for zero in lowest)
        falls = f"pressure falls to {-low:.3g} {array.unit} below the zero"
        numbers = f"Then write numbers: where it is lowest, zero = [{found}]"
        end = float(np.median(pressure[time_s > time_s[-1] - array.zero_first_s]))
        if abs(end) < _BACK_PART * -low:
            yield (
                f"{falls} and comes back to it at the end: channels that fall under load have `sign = -1` in "
                f"the array file. Or was the sensor touched at both ends? {numbers}"
            )
        else:
            yield f"{falls}: was the sensor touched in the first {array.zero_first_s:g} s? {numbers}"


def _opposed_pads(array: Array, readings: FloatArray) -> Iterator[str]:
    """Yield a line for each pad whose shear opposes that of the first one, along one axis or both."""
    weights = array.shear_weights()
    is_read = np.isfinite(readings).any(axis=0)
    change = np.zeros_like(readings)
    change[:, is_read] = readings[:, is_read] - np.nanmedian(readings[:, is_read], axis=0)
    change = np.nan_to_num(change)
    shear = []
    for pad in sorted(set(array.pad.tolist())):
        along = weights[:, array.pad == pad].sum(axis=1)
        shear.append(change @ along.T)
    for number, of_pad in enumerate(shear[1:], start=1):
        products = (of_pad * shear[0]).sum(axis=0)
        size = float(np.sqrt((of_pad**2).sum() * (shear[0] ** 2).sum()))
        axes = [name for name, product in zip("xy", products, strict=True) if product < -_OPPOSED * size / 2]
        if axes and float(np.abs(products).sum()) > _OPPOSED * size:
            yield (
                f"shear of pad {number} opposes that of pad 0 along {' and '.join(axes)}, and both cancel: "
                "fingers that face each other are mirror images: see `mirrored` and `axes_deg` of [[grids]]"
            )


def _range_used(tally: LogTally) -> str:
    if tally.low > tally.high:
        return "no readings"
    array = tally.array
    part = (tally.high - tally.low) / (array.high - array.low)
    words = f"readings from {tally.low:g} to {tally.high:g} {array.unit}: {percent(part)} of the range"
    words += f"; {tally.n_missing} missing" if tally.n_missing else ""
    if tally.n_outside:
        words += (
            f"; {tally.n_outside} saturated, and not used. If they are true, widen `range` in the array file"
        )
    return words


def _texture(
    array: Array, told: Counter[str], rate_hz: float, speed_mm_s: float, slides: bool
) -> Iterator[str]:
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
        yield "no period: with this array, it needs the sliding speed (--speed)"
    elif speed_mm_s:
        finest_mm = speed_mm_s / (0.45 * rate_hz)
        yield (
            f"no period: at {rate_hz:.4g} Hz and this speed, grooves must exceed {finest_mm:.2g} mm, "
            "and be within --period (0.5:20 if left out)"
        )

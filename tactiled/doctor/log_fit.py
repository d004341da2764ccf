"""Findings of `check-config --log`: how an array file fits a log, and what to write in it otherwise."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.doctor.finding import Finding
from tactiled.errors import DataError
from tactiled.log_summary import REST_S, channels_without_zero, far_from_zero, percent
from tactiled.recording.spacing import spacing_of

_PRESSED = 0.95  # quantile of the change of all channels beyond which a log is taken as pressed
# A channel that changes less than this part of what the others do while they are pressed tells no sign.
_LEAST_PART = 0.1
_LEAST_NOISES = 20.0  # standard deviations of the noise that a press changes a channel by, as in `calibrate`
_MOST_SATURATED = 0.01  # of the scans
_PAUSES = 3.0  # times the longest usual step
_MOST_NAMES = 12


def log_fit(array: Array, time_s: FloatArray, readings: FloatArray) -> list[Finding]:
    """Compare an array with a log: times (n,), two at least; readings (n, channels), NaN where missing.

    The first finding has the rate as ``rate_hz``. `DataError` if there is no reading at all.
    """
    if not np.isfinite(readings).any():
        raise DataError("the log has no valid reading: check --columns")
    n_first = int(np.searchsorted(time_s, time_s[0] + REST_S))
    parts = (np.ma.masked_invalid(part) for part in (readings[:n_first], readings))
    first, whole = (np.ma.filled(np.ma.median(p, axis=0), np.nan) for p in parts)  # type: ignore[no-untyped-call]
    rest = np.nan_to_num(np.where(np.isnan(first), whole, first))  # 0 of a channel without a reading
    return [
        _rate(time_s, readings),
        _range(array, readings),
        _dead(array, readings),
        _zero(array, time_s, readings, rest),
        _signs(array, readings - rest),
    ]


def _rate(time_s: FloatArray, readings: FloatArray) -> Finding:
    period_s, longest_s, rows = spacing_of(time_s, readings)
    steps_s = np.diff(time_s)
    n_pauses = int((steps_s > _PAUSES * longest_s).sum())
    words = f"{1 / period_s:.4g} Hz"
    if longest_s > period_s:
        words += f", uneven: steps of {steps_s.min():.3g} to {longest_s:.3g} s"
    if rows > 1:
        words += f", rows repeat: one scan in {rows}"
    if n_pauses:
        words += f", {n_pauses} pauses, the longest of {steps_s.max():.3g} s"
    return Finding("log: rate", "ok", words, values={"rate_hz": 1 / period_s})


def _range(array: Array, readings: FloatArray) -> Finding:
    low, high = float(np.nanmin(readings)), float(np.nanmax(readings))
    words = f"readings from {low:.6g} to {high:.6g} {array.unit}"
    if low < array.low or high > array.high:
        beyond = f"{words}, beyond {array.low:g} to {array.high:g}"
        wider = f"range = [{min(low, array.low):.6g}, {max(high, array.high):.6g}], or more"
        return Finding("log: range", "fail", beyond, wider)
    at_limit = ~np.isnan(readings) & ~array.in_range(readings)
    saturated = np.flatnonzero(at_limit.mean(axis=0) > _MOST_SATURATED)
    if saturated.size:
        words += f"; saturated at times: {_names(array, saturated)}"
        return Finding("log: range", "warn", words, "press less, or set range to what the converter gives")
    part = (high - low) / (array.high - array.low)
    return Finding("log: range", "ok", f"{words}, {percent(part)} of the range")


def _dead(array: Array, readings: FloatArray) -> Finding:
    unread = ~np.isfinite(readings).any(axis=0)
    still = ~unread & (np.ma.filled(np.ma.ptp(np.ma.masked_invalid(readings), axis=0), 1.0) == 0)
    kinds = {"no readings": np.flatnonzero(unread), "never change": np.flatnonzero(still)}
    words = "; ".join(f"{kind}: {_names(array, dead)}" for kind, dead in kinds.items() if dead.size)
    if not words:
        return Finding("log: channels", "ok", "every channel changes")
    remedy = "check the wiring and --columns; detectors leave such channels out"
    return Finding("log: channels", "warn", words, remedy)


def _zero(array: Array, time_s: FloatArray, readings: FloatArray, rest: FloatArray) -> Finding:
    if array.zero_first_s:
        words = f"first {array.zero_first_s:g} s; nothing may touch the array then"
        late = np.array(channels_without_zero(array, time_s, readings), dtype=np.int64)
        if not late.size:
            return Finding("log: zero", "ok", words)
        words = f"no valid reading in the first {array.zero_first_s:g} s: {_names(array, late)}"
        remedy = "write numbers as zero; detectors leave such channels out"
        return Finding("log: zero", "warn", words, remedy)
    far = far_from_zero(array, rest)
    if not far.size:
        return Finding("log: zero", "ok", "the log begins at the zero of the array, within 2 % of the range")
    far_by = f"{np.abs(rest - array.zero).max():.4g} {array.unit}"
    words = f"the log begins {far_by} from the zero of the array: {_names(array, far)}"
    remedy = "set zero = 'first 0.3 s', unless something touches the array when the log begins"
    return Finding("log: zero", "warn", words, remedy)


def _signs(array: Array, change: FloatArray) -> Finding:
    """Compare signs of load channels with the way that they go where the log changes most."""
    loads = np.array([kind in ("normal", "side") for kind in array.channel_kind])
    if not loads.any():
        return Finding("log: signs", "ok", "no load channels")
    size = np.sqrt(np.nansum(change[:, loads] ** 2, axis=1))
    pressed = size >= np.quantile(size, _PRESSED)
    goes = np.median(np.nan_to_num(change)[pressed], axis=0) * array.sign
    noise = np.array([_noise(one) for one in change.T])
    if float(np.abs(goes[loads]).max()) < _LEAST_NOISES * max(float(np.median(noise[loads])), 1e-12):
        words = "nothing presses the array in this log, so that signs cannot be checked"
        return Finding("log: signs", "warn", words, "record a firm press")
    tells = loads & (np.abs(goes) > _LEAST_PART * float(np.abs(goes[loads]).max()))
    falls: NDArray[np.int64] = np.flatnonzero(tells & (goes < 0))
    if not falls.size:
        words = "load channels rise where the log changes most"
        if array.has_shear:
            words += (
                "; a log does not show the signs of shear channels: drag the skin over a table along +x and "
                "+y; x and y must rise, otherwise directions are wrong by up to 180 deg"
            )
        return Finding("log: signs", "ok", words)
    words = f"fall where the log changes most: {_names(array, falls)}"
    other = {int(-sign) for sign in array.sign[falls]}
    if len(falls) == int(tells.sum()) and len(other) == 1:
        remedy = f"if that is a press, sign = {other.pop()} for that kind"
    else:
        remedy = "if that is a press, list each channel in [[channels]], these with the other sign"
    if array.zero_first_s:
        remedy += "; if the log begins under load, give zero as numbers instead"
    return Finding("log: signs", "warn", words, remedy)


def _noise(change: FloatArray) -> float:
    """Standard deviation of the white noise of a channel, from second differences."""
    known = change[np.isfinite(change)]
    return 1.4826 * float(np.median(np.abs(np.diff(known, 2)))) / np.sqrt(6) if len(known) > 2 else 0.0


def _names(array: Array, channels: NDArray[np.int64]) -> str:
    shown = [array.channel_name[channel] for channel in channels[:_MOST_NAMES]]
    more = len(channels) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")

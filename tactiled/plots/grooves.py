"""The grooves of a log in pictures: how the answer grew, how they lie under the array, whether they fit."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.events.types import SlipEvent, TextureEvent

FloatArray = NDArray[np.float64]
_PERIOD, _ANGLE, _REFUSED, _MOTION = "#1f4e79", "#e07b00", "#777777", "#c0392b"
_TAXEL_MM = 0.8  # radius on the map
_MARGIN_MM = 2.5  # around the taxels
_BINS = 40  # of a groove's phase
_WITHIN = 1.96  # sigmas of a 95 % interval


def draw_answers(
    period_axis: Axes, angle_axis: Axes, events: Sequence[TextureEvent], origin_s: float
) -> None:
    """Answers against time with their 95 % intervals as bands; refusals as crosses along the bottom, named.

    Parameters
    ----------
    events : sequence of TextureEvent
        At least one of them "ok".
    """
    ok = [e for e in events if e.status == "ok"]
    time_s = np.array([e.time_s for e in ok]) - origin_s
    refused_s = np.array([e.time_s for e in events if e.status != "ok"]) - origin_s
    refused = refusals_in_words(events)
    sides = (
        (period_axis, _PERIOD, [(e.period_mm, e.period_sd_mm) for e in ok], "period (mm)", "mm"),
        (angle_axis, _ANGLE, [(e.angle_deg, e.angle_sd_deg) for e in ok], "angle (deg)", "deg"),
    )
    for axis, color, pairs, label, unit in sides:
        value, sd = np.array(pairs).T
        axis.fill_between(
            time_s, value - _WITHIN * sd, value + _WITHIN * sd, color=color, alpha=0.2, lw=0, label="95 %"
        )
        axis.plot(time_s, value, ".-", color=color, lw=0.8, ms=4)
        if refused:
            axis.plot(
                refused_s, np.full(len(refused_s), 0.03), "x", color=_REFUSED, ms=5,
                transform=axis.get_xaxis_transform(), label=f"refused: {refused}",
            )  # fmt: skip
        axis.ticklabel_format(axis="y", useOffset=False)
        axis.set(xlabel="time (s)", ylabel=label)
        axis.set_title(f"last: {in_words(value[-1], sd[-1])} {unit}", fontsize=10)
        axis.legend(frameon=False, fontsize=9, loc="upper right")


def answer_in_words(events: Sequence[TextureEvent], onsets: Sequence[SlipEvent]) -> str:
    """The last answer, what it took, and how soon the first came; or why there was none."""
    ok = [e for e in events if e.status == "ok"]
    if not ok:
        return f"grooves: no answer ({refusals_in_words(events)})" if events else ""
    last = ok[-1]
    words = (
        f"grooves of {in_words(last.period_mm, last.period_sd_mm)} mm at "
        f"{in_words(last.angle_deg, last.angle_sd_deg)}° ({last.estimator}"
    )
    if last.speed_source != "none":
        words += f", {last.speed_mm_s:.3g} mm/s {last.speed_source}"
    for other in last.candidates[1:2]:
        words += f"; another of {other.period_mm:.4g} mm at {other.angle_deg:.1f}°"
    before_s = [e.detected_s for e in onsets if e.detected_s <= ok[0].time_s]
    if before_s:
        words += f"; first answer {ok[0].time_s - before_s[-1]:.1f} s after slip was said"
    return f"{words})"


def refusals_in_words(events: Sequence[TextureEvent]) -> str:
    """``ambiguous 3, low-snr 1``."""
    counted = Counter(e.status for e in events if e.status != "ok")
    return ", ".join(f"{status} {number}" for status, number in counted.most_common())


def draw_map(axis: Axes, array: Array, event: TextureEvent, onsets: Sequence[SlipEvent]) -> None:
    """Grooves under the taxels, a second grating dashed, and where the skin goes.

    Parameters
    ----------
    event : TextureEvent
        An "ok".
    onsets : sequence of SlipEvent
        The last one's direction is shown.
    """
    low = np.array([array.x_mm.min(), array.y_mm.min()]) - _MARGIN_MM
    high = np.array([array.x_mm.max(), array.y_mm.max()]) + _MARGIN_MM
    _draw_grooves(axis, (low + high) / 2, event.period_mm, event.angle_deg, "-", np.hypot(*(high - low)))
    for other in event.candidates[1:2]:
        _draw_grooves(axis, (low + high) / 2, other.period_mm, other.angle_deg, "--", np.hypot(*(high - low)))
        axis.plot(
            [], [], "--", color=_ANGLE, label=f"second: {other.period_mm:.3g} mm, {other.angle_deg:.1f}°"
        )
    for number, place in enumerate(zip(array.x_mm, array.y_mm, strict=True)):
        axis.add_patch(Circle(place, _TAXEL_MM, fill=True, fc="white", ec="black", zorder=3))
        axis.text(*place, str(number), ha="center", va="center", fontsize=8, zorder=4)
    direction_deg = _direction_deg(onsets)
    if direction_deg is not None:
        way = np.array([np.cos(np.radians(direction_deg)), np.sin(np.radians(direction_deg))])
        tail = (low + high) / 2 - way * (high - low).min() / 2.6
        axis.annotate(
            "", tail + way * (high - low).min() / 1.3, tail, zorder=5,
            arrowprops={"arrowstyle": "-|>", "color": _MOTION, "lw": 2, "alpha": 0.8},
        )  # fmt: skip
        axis.plot([], [], color=_MOTION, lw=2, label=f"the skin goes to {direction_deg:.0f}°")
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (mm)", ylabel="y (mm)")
    axis.set_aspect("equal")
    axis.set_title(
        f"grooves under the array: {event.period_mm:.4g} mm, normal at {event.angle_deg:.1f}°", fontsize=10
    )
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, loc="lower left").set_zorder(6)


def _draw_grooves(
    axis: Axes, middle: FloatArray, period_mm: float, angle_deg: float, style: str, size_mm: float
) -> None:
    normal = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    along = np.array([-normal[1], normal[0]]) * size_mm
    n_half = int(size_mm / period_mm / 2) + 1
    for number in range(-n_half, n_half + 1):
        ends = np.array([middle + number * period_mm * normal + side * along for side in (-1, 1)])
        axis.plot(*ends.T, style, color=_PERIOD if style == "-" else _ANGLE, lw=1, alpha=0.6, zorder=1)


def _direction_deg(onsets: Sequence[SlipEvent]) -> float | None:
    """Of the last slip, where it could tell."""
    known = [e.direction_deg for e in onsets if e.direction_sd_deg < 90]
    return known[-1] if known else None


def draw_folded(
    axis: Axes,
    array: Array,
    time_s: FloatArray,
    volts: FloatArray,
    channel_offset_s: FloatArray,
    event: TextureEvent,
    onsets: Sequence[SlipEvent],
) -> None:
    """The ripple of each taxel against the groove's phase beneath it: where the answer is right, all are one.

    Parameters
    ----------
    time_s : (n,) float64
    volts : (n, channels) float64
    channel_offset_s : (channels,) float64
    event : TextureEvent
        An "ok"; its window is shown.
    """
    inside = (time_s > event.time_s - event.window_s) & (time_s <= event.time_s + 1e-9)
    seconds, readings = time_s[inside] - event.time_s, np.nan_to_num(volts[inside])
    drift = np.polynomial.polynomial.polyvander(seconds / event.window_s, 3)
    ripple = readings - drift @ np.linalg.lstsq(drift, readings, rcond=None)[0]
    names = np.array([name.split(".")[-1] for name in array.channel_name])
    liveliest = max(dict.fromkeys(names.tolist()), key=lambda name: float(ripple[:, names == name].std()))
    angle, direction_deg = np.radians(event.angle_deg), _direction_deg(onsets)
    forward = -1.0 if direction_deg is not None and np.cos(angle - np.radians(direction_deg)) < 0 else 1.0
    edges = np.linspace(0, 1, _BINS + 1)
    for channel in np.flatnonzero(names == liveliest):
        taxel = array.channel_taxel[channel]
        across_mm = array.x_mm[taxel] * np.cos(angle) + array.y_mm[taxel] * np.sin(angle)
        turns = event.frequency_hz * (seconds + channel_offset_s[channel])
        phase = (turns + forward * across_mm / event.period_mm) % 1
        count, _ = np.histogram(phase, edges)
        total, _ = np.histogram(phase, edges, weights=ripple[:, channel])
        seen = count > 0
        middle = (edges[:-1] + edges[1:]) / 2
        axis.plot(middle[seen], 1e3 * total[seen] / count[seen], lw=1, label=str(taxel))
    axis.set(xlabel="phase of the groove beneath the taxel (turns)", ylabel="ripple (mV)", xlim=(0, 1))
    axis.set_title(f"{liveliest} of every taxel, folded on these grooves: alike where they fit", fontsize=10)
    if array.n_taxels <= 16:
        axis.legend(title="taxel", fontsize=7, frameon=False, ncol=3, loc="lower center")


def in_words(value: float, sd: float) -> str:
    """A number to the digits that its sigma allows: ``1.2000 ± 0.0001``."""
    digits = int(np.clip(np.ceil(-np.log10(max(sd, 1e-9))), 0, 9))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"

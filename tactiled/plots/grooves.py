"""Pictures of groove estimates: estimates over time, the grating under the array, and the folded ripples."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.events.types import SlipEvent, TextureEvent
from tactiled.events.words import with_sd
from tactiled.plots.palette import GROOVES, NEUTRAL, SECOND_GRATING, SLIP

FloatArray = NDArray[np.float64]
_TAXEL_MM = 0.8  # radius on the map
_MARGIN_MM = 2.5  # around the taxels
_BINS = 40  # of the phase of a groove
_SDS_95 = 1.96  # half a 95 % interval, in standard deviations
_REASONS: Mapping[str, str] = {
    "no-slip": "no answer, the skin does not slide",
    "too-few-periods": "no answer, too few ripple periods in the window",
    "aliased": "no answer, ripples are too fast for the scan rate",
    "ambiguous": "no answer, several gratings fit the phases",
    "uneven-channels": "no answer, the phases of the channels differ too much",
    "several-gratings": "no answer, several gratings are in view",
    "period-only": "period without angle",
    "machine": "no answer, all channels swing at once, as with a motor",
    "low-snr": "no answer, no ripple above the noise",
    "saturated": "no answer, readings are saturated",
    "stale": "no answer, too many scans are late",
}


def draw_answers(
    period_axis: Axes, angle_axis: Axes, events: Sequence[TextureEvent], origin_s: float
) -> None:
    """Draw estimates over time with 95 % intervals, and refusals as crosses at the bottom.

    Parameters
    ----------
    events : sequence of TextureEvent
        At least one of them "ok".
    """
    ok = [e for e in events if e.status == "ok"]
    time_s = np.array([e.answered_s for e in ok]) - origin_s
    refused_s = np.array([e.answered_s for e in events if e.status != "ok"]) - origin_s
    refused = refusals_in_words(events)
    sides = (
        (period_axis, [(e.period_mm, e.period_sd_mm) for e in ok], "period (mm)", "mm"),
        (angle_axis, [(e.angle_deg, e.angle_sd_deg) for e in ok], "angle (deg)", "deg"),
    )
    for axis, pairs, label, unit in sides:
        value, sd = np.array(pairs).T
        axis.fill_between(
            time_s, value - _SDS_95 * sd, value + _SDS_95 * sd, color=GROOVES, alpha=0.2, lw=0, label="95 %"
        )
        axis.plot(time_s, value, ".-", color=GROOVES, lw=0.8, ms=4)
        if refused:
            axis.plot(
                refused_s, np.full(len(refused_s), 0.03), "x", color=NEUTRAL, ms=5,
                transform=axis.get_xaxis_transform(), label=f"refused: {refused}",
            )  # fmt: skip
        axis.ticklabel_format(axis="y", useOffset=False)
        axis.set(xlabel="time (s)", ylabel=label)
        axis.set_title(f"last: {with_sd(value[-1], sd[-1])} {unit}", fontsize=10)
        axis.legend(frameon=False, fontsize=9, loc="upper right")


def answer_in_words(events: Sequence[TextureEvent], onsets: Sequence[SlipEvent]) -> str:
    """Describe the last estimate and the time to the first one, or the reasons of the refusals."""
    ok = [e for e in events if e.status == "ok"]
    if not ok and events and events[-1].status == "period-only" and events[-1].period_mm > 0:
        last = events[-1]
        return f"grooves of {with_sd(last.period_mm, last.period_sd_mm)} mm, angle unknown ({last.estimator})"
    if not ok:
        return f"grooves: no answer ({refusals_in_words(events)})" if events else ""
    last = ok[-1]
    words = (
        f"grooves of {with_sd(last.period_mm, last.period_sd_mm)} mm at "
        f"{with_sd(last.angle_deg, last.angle_sd_deg)}° ({last.estimator}"
    )
    if last.speed_source != "none":
        words += f", {last.speed_mm_s:.3g} mm/s {last.speed_source}"
    for other in last.candidates[1:2]:
        words += f"; another of {other.period_mm:.4g} mm at {other.angle_deg:.1f}°"
    before_s = [e.detected_s for e in onsets if e.detected_s <= ok[0].time_s]
    if before_s:
        words += f"; first answer {ok[0].answered_s - before_s[-1]:.1f} s after slip was detected"
    return f"{words})"


def refusals_in_words(events: Sequence[TextureEvent]) -> str:
    """Count the refusals by reason, e.g. ``ambiguous 3, low-snr 1``."""
    counted = Counter(e.status for e in events if e.status != "ok")
    return ", ".join(f"{status} {number}" for status, number in counted.most_common())


def refusal_reason(event: TextureEvent) -> str:
    """Describe why an event has no complete estimate."""
    return _REASONS.get(event.status, event.status)


def draw_map(axis: Axes, array: Array, event: TextureEvent, onsets: Sequence[SlipEvent]) -> None:
    """Draw the grooves under the taxels, a second grating dashed, and the direction of motion.

    Parameters
    ----------
    event : TextureEvent
        With status "ok".
    onsets : sequence of SlipEvent
        The direction of the last one with a direction is drawn.
    """
    low = np.array([array.x_mm.min(), array.y_mm.min()]) - _MARGIN_MM
    high = np.array([array.x_mm.max(), array.y_mm.max()]) + _MARGIN_MM
    _draw_grooves(axis, (low + high) / 2, event.period_mm, event.angle_deg, "-", np.hypot(*(high - low)))
    for other in event.candidates[1:2]:
        _draw_grooves(axis, (low + high) / 2, other.period_mm, other.angle_deg, "--", np.hypot(*(high - low)))
        axis.plot(
            [],
            [],
            "--",
            color=SECOND_GRATING,
            label=f"second: {other.period_mm:.3g} mm, {other.angle_deg:.1f}°",
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
            arrowprops={"arrowstyle": "-|>", "color": SLIP, "lw": 2, "alpha": 0.8},
        )  # fmt: skip
        axis.plot([], [], color=SLIP, lw=2, label=f"direction of slip {direction_deg:.0f}°")
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
    color = GROOVES if style == "-" else SECOND_GRATING
    for number in range(-n_half, n_half + 1):
        ends = np.array([middle + number * period_mm * normal + side * along for side in (-1, 1)])
        axis.plot(*ends.T, style, color=color, lw=1, alpha=0.6, zorder=1)


def _direction_deg(onsets: Sequence[SlipEvent]) -> float | None:
    """Direction of the last slip that has one; None where none has."""
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
    """Draw the ripple over the phase of the groove beneath each taxel: mean and range over the taxels.

    Where the estimate is right, all taxels have the same curve and the range is narrow. Parameters as for
    `folded_ripples`.
    """
    name, phase, ripple = folded_ripples(array, time_s, volts, channel_offset_s, event, onsets)
    ripple = 1e3 * ripple[:, (known := np.isfinite(ripple).all(axis=0))]
    phase = phase[known]
    label = f"range of {len(ripple)} taxels"
    axis.fill_between(
        phase, ripple.min(axis=0), ripple.max(axis=0), color=GROOVES, alpha=0.2, lw=0, label=label
    )
    axis.plot(phase, ripple.mean(axis=0), color=GROOVES, lw=1.2, label="mean")
    axis.set(xlabel="phase of the groove beneath the taxel (turns)", xlim=(0, 1))
    axis.set_ylabel(f"ripple (0.001 {array.unit})")
    axis.set_title(f"{name} of every taxel, folded on these grooves: narrow where they fit", fontsize=10)
    axis.legend(fontsize=9, frameon=False, loc="lower center", ncol=2)


def folded_ripples(
    array: Array,
    time_s: FloatArray,
    volts: FloatArray,
    channel_offset_s: FloatArray,
    event: TextureEvent,
    onsets: Sequence[SlipEvent],
) -> tuple[str, FloatArray, FloatArray]:
    """Average the ripple of each taxel over the phase of the groove beneath it.

    Parameters
    ----------
    time_s : (n,) float64
    volts : (n, channels) float64
    channel_offset_s : (channels,) float64
    event : TextureEvent
        With status "ok"; its window is used.
    onsets : sequence of SlipEvent
        The last direction decides in which sense the phase grows.

    Returns
    -------
    name : str
        Channel of each taxel that is shown: the one with the largest ripple.
    phase : (bins,) float64
        Centres of the bins, in turns.
    ripple : (taxels, bins) float64
        Mean ripple, without a cubic trend; NaN in bins without a scan.
    """
    inside = (time_s > event.time_s - event.window_s) & (time_s <= event.time_s + 1e-9)
    seconds, readings = time_s[inside] - event.time_s, np.nan_to_num(volts[inside])
    drift = np.polynomial.polynomial.polyvander(seconds / event.window_s, 3)
    ripple = readings - drift @ np.linalg.lstsq(drift, readings, rcond=None)[0]
    names = np.array([name.split(".")[-1] for name in array.channel_name])
    shown = max(dict.fromkeys(names.tolist()), key=lambda name: float(ripple[:, names == name].std()))
    angle, direction_deg = np.radians(event.angle_deg), _direction_deg(onsets)
    forward = -1.0 if direction_deg is not None and np.cos(angle - np.radians(direction_deg)) < 0 else 1.0
    edges = np.linspace(0, 1, _BINS + 1)
    rows = []
    for channel in np.flatnonzero(names == shown):
        taxel = array.channel_taxel[channel]
        across_mm = array.x_mm[taxel] * np.cos(angle) + array.y_mm[taxel] * np.sin(angle)
        turns = event.frequency_hz * (seconds + channel_offset_s[channel])
        phase = (turns + forward * across_mm / event.period_mm) % 1
        count, _ = np.histogram(phase, edges)
        total, _ = np.histogram(phase, edges, weights=ripple[:, channel])
        rows.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    return shown, (edges[:-1] + edges[1:]) / 2, np.array(rows)

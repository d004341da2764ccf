"""Pictures of groove estimates: estimates over time, and the grating under the array."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from tactiled.array import Array, FloatArray
from tactiled.events.types import SlipEvent, TextureEvent
from tactiled.events.words import with_sd
from tactiled.plots.palette import GROOVES, NEUTRAL, SECOND_GRATING, SLIP

_TAXEL_MM = 0.8  # radius on the map
_MARGIN_MM = 2.5  # around the taxels
_SDS_95 = 1.96  # half a 95 % interval, in standard deviations


def draw_answers(
    period_axis: Axes, angle_axis: Axes, events: Sequence[TextureEvent], origin_s: float
) -> None:
    """Draw estimates over time with 95 % intervals, and refusals as crosses; one event at least is "ok"."""
    ok = [e for e in events if e.status == "ok"]
    time_s = np.array([e.answered_s for e in ok]) - origin_s
    refused_s = np.array([e.answered_s for e in events if e.status != "ok"]) - origin_s
    refused = _refusals(events)
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
        return f"grooves: no answer ({_refusals(events)})" if events else ""
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


def _refusals(events: Sequence[TextureEvent]) -> str:
    """Count the refusals by reason, e.g. ``ambiguous 3, low-snr 1``."""
    counted = Counter(e.status for e in events if e.status != "ok")
    return ", ".join(f"{status} {number}" for status, number in counted.most_common())


def draw_map(axis: Axes, array: Array, event: TextureEvent, onsets: Sequence[SlipEvent]) -> None:
    """Draw the grooves of an "ok" event under the taxels, a second grating dashed, and the last direction."""
    low = np.array([array.x_mm.min(), array.y_mm.min()]) - _MARGIN_MM
    high = np.array([array.x_mm.max(), array.y_mm.max()]) + _MARGIN_MM
    _draw_grooves(axis, (low + high) / 2, event.period_mm, event.angle_deg, "-", np.hypot(*(high - low)))
    for other in event.candidates[1:2]:
        _draw_grooves(axis, (low + high) / 2, other.period_mm, other.angle_deg, "--", np.hypot(*(high - low)))
        label = f"second: {other.period_mm:.3g} mm, {other.angle_deg:.1f}°"
        axis.plot([], [], "--", color=SECOND_GRATING, label=label)
    for number, place in enumerate(zip(array.x_mm, array.y_mm, strict=True)):
        axis.add_patch(Circle(place, _TAXEL_MM, fill=True, fc="white", ec="black", zorder=3))
        axis.text(*place, str(number), ha="center", va="center", fontsize=8, zorder=4)
    if known := [e.direction_deg for e in onsets if e.direction_sd_deg < 90]:
        direction_deg = known[-1]
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

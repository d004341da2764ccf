"""How the answer about the grooves grew in a log: period and angle, each with its 95 % interval."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from tactiled.events.types import TextureEvent

_PERIOD, _ANGLE, _REFUSED = "#1f4e79", "#e07b00", "#777777"
_WITHIN = 1.96  # sigmas of a 95 % interval


def draw_answers(
    period_axis: Axes, angle_axis: Axes, events: Sequence[TextureEvent], origin_s: float
) -> None:
    """Answers against time with their intervals as bands; refusals as crosses along the bottom.

    Parameters
    ----------
    events : sequence of TextureEvent
        At least one of them "ok".
    """
    ok = [e for e in events if e.status == "ok"]
    time_s = np.array([e.time_s for e in ok]) - origin_s
    refused_s = np.array([e.time_s for e in events if e.status != "ok"]) - origin_s
    last = ok[-1]
    speed = f", {last.speed_mm_s:.3g} mm/s {last.speed_source}" if last.speed_source != "none" else ""
    sides = (
        (period_axis, _PERIOD, [(e.period_mm, e.period_sd_mm) for e in ok], "period (mm)", speed),
        (angle_axis, _ANGLE, [(e.angle_deg, e.angle_sd_deg) for e in ok], "angle (deg)", ""),
    )
    for axis, color, pairs, label, more in sides:
        value, sd = np.array(pairs).T
        axis.plot(time_s, value, ".-", color=color, lw=0.8, ms=4)
        axis.errorbar(time_s, value, _WITHIN * sd, fmt="none", color=color, elinewidth=1, alpha=0.5)
        axis.plot(
            refused_s, np.full(len(refused_s), 0.03), "x", color=_REFUSED, ms=5,
            transform=axis.get_xaxis_transform(),
        )  # fmt: skip
        axis.ticklabel_format(axis="y", useOffset=False)
        axis.set(xlabel="time (s)", ylabel=label)
        axis.set_title(f"last: {in_words(value[-1], sd[-1])}{more} ({last.estimator})", fontsize=10)


def in_words(value: float, sd: float) -> str:
    """A number to the digits that its sigma allows: ``1.2000 ± 0.0001``."""
    digits = int(np.clip(np.ceil(-np.log10(max(sd, 1e-9))), 0, 9))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"

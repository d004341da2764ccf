"""Picture of the slips of a scene: how long before all of the contact slides the first report comes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactiled.events.types import Event, GripEvent, SlipEvent
from tactiled.plots.log import KnownTruth
from tactiled.plots.palette import MARGIN, SLIP, TRUTH

_BEFORE_S, _AFTER_S = 0.1, 0.25  # shown before shear begins to rise, and after all of the contact slides
_ARROW, _WORDS, _TOP = 0.1, 1.2, 1.3  # heights, parts of the friction limit: arrow, words, axis


def draw_slips(path: Path, events: Sequence[Event], truth: KnownTruth) -> str:
    """Draw the part of the friction limit in use around each true slip; return the title.

    Friction is known after the first slip. The events are on the clock of `truth`, which has one slip at
    least.
    """
    figure = Figure(figsize=(10, 4), layout="constrained")
    rows = figure.subplots(1, len(truth.spans_s), sharey=True, squeeze=False)
    leads = []
    for number, (axis, span_s) in enumerate(zip(rows[0], truth.spans_s, strict=True), 1):
        lead_ms = _draw_slip(axis, events, truth, *span_s)
        if lead_ms >= 1:
            leads.append(f"{lead_ms:.0f} ms")
        known = "not known yet" if number == 1 else "measured by the slide before"
        axis.set_title(f"slip {number}: friction {known}", fontsize=10)
    title = "No slip was reported before all of the contact slid"
    if leads:
        of_all = f", {len(leads)} of {len(truth.spans_s)} times" if len(leads) < len(truth.spans_s) else ""
        title = f"Slip is reported {' and '.join(leads)} before all of the contact slides{of_all}"
    figure.suptitle(title)
    rows[0][0].set_ylabel("shear over friction limit")
    rows[0][-1].legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.12))
    figure.savefig(path, dpi=110)
    return title


def _draw_slip(
    axis: Axes, events: Sequence[Event], truth: KnownTruth, begin_s: float, gross_s: float
) -> float:
    """Draw one slip; return the time (ms) from its report to gross slip, negative for a late one."""
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    reported_s = min((e.detected_s for e in onsets if e.detected_s > begin_s), default=np.inf)
    lead_ms = 1e3 * (gross_s - reported_s)
    grips = [e for e in events if isinstance(e, GripEvent) and e.valid and e.state != "none"]
    used = [(e.time_s, e.utilisation_low, e.utilisation, e.utilisation_high) for e in grips]
    time_s, low, middle, high = np.array(used).reshape(-1, 4).T
    estimated_ms = 1e3 * (time_s - begin_s)
    axis.plot(
        1e3 * (truth.time_s - begin_s), truth.utilisation, color=TRUTH, lw=3, alpha=0.6, label="true"
    )  # fmt: skip
    axis.plot(estimated_ms, middle, color=MARGIN, lw=1.5, label="estimated")
    axis.fill_between(estimated_ms, low, high, color=MARGIN, alpha=0.2, lw=0, label="90 % interval")
    gross_ms, reported_ms = 1e3 * (gross_s - begin_s), 1e3 * (reported_s - begin_s)
    axis.axvline(gross_ms, color=TRUTH, lw=2)
    axis.annotate(" all of it slides (true)", (gross_ms, _WORDS))
    if lead_ms > 0:
        axis.axvline(reported_ms, color=SLIP, lw=2)
        axis.annotate("slip is reported ", (reported_ms, _WORDS), ha="right")
        arrow = {"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", (reported_ms, _ARROW), (gross_ms, _ARROW), arrowprops=arrow)
        between = ((reported_ms + gross_ms) / 2, _ARROW)
        axis.annotate(f"{lead_ms:.0f} ms", between, (0, 4), textcoords="offset points", ha="center")
    axis.set_xlim(-1e3 * _BEFORE_S, gross_ms + 1e3 * _AFTER_S)
    axis.set_ylim(0, _TOP)
    axis.axhline(1.0, color="black", lw=0.6)
    axis.set_xlabel("time since shear begins to rise (ms)")
    return lead_ms

"""Picture of one slip: how long before all of the contact slides the first report comes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tactiled.events.types import Event, GripEvent, SlipEvent
from tactiled.plots.log import KnownTruth
from tactiled.plots.palette import MARGIN, SLIP, TRUTH

_BEFORE_S, _AFTER_S = 0.15, 0.25  # shown before shear begins to rise, and after all of the contact slides
_ARROW, _WORDS, _TOP = 0.12, 1.22, 1.35  # heights, parts of the friction limit: arrow, words, axis


def draw_first_slip(path: Path, events: Sequence[Event], truth: KnownTruth) -> str:
    """Draw the part of the friction limit in use around the first true slip; return the title.

    The events are on the clock of `truth`, which has one slip at least.
    """
    begin_s, gross_s = truth.spans_s[0]
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    reported_s = min((e.detected_s for e in onsets if e.detected_s > begin_s), default=np.inf)
    lead_ms = 1e3 * (gross_s - reported_s)
    title = "No slip was reported before all of the contact slid"
    if lead_ms >= 1:
        title = f"Slip is reported {lead_ms:.0f} ms before all of the contact slides"
    figure = Figure(figsize=(9, 4), layout="constrained")
    axis = figure.subplots()
    axis.set_title(title)
    grips = [e for e in events if isinstance(e, GripEvent) and e.valid and e.state != "none"]
    rows = [(e.time_s, e.utilisation_low, e.utilisation, e.utilisation_high) for e in grips]
    time_s, low, middle, high = np.array(rows).reshape(-1, 4).T
    axis.plot(
        1e3 * (truth.time_s - begin_s), truth.utilisation, color=TRUTH, lw=3, alpha=0.6,
        label="in use, true",
    )  # fmt: skip
    axis.plot(1e3 * (time_s - begin_s), middle, color=MARGIN, lw=1.5, label="in use, estimated")
    axis.fill_between(
        1e3 * (time_s - begin_s), low, high, color=MARGIN, alpha=0.2, lw=0, label="90 % interval"
    )
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
    axis.set_ylabel("shear over friction limit")
    axis.legend(frameon=False, loc="center left")
    figure.savefig(path, dpi=110)
    return title

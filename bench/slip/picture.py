"""Picture of ``./run bench slip``: what each setting reports, and calibration."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.slip.cases import RANDOM
from bench.slip.replay import (
    GROSS_PS,
    INCIPIENT_PS,
    NAMES,
    CaseEvents,
    gross_curve_at,
    incipient_curve_at,
)
from bench.slip.score import (
    Reported,
    false_onsets_per_hour,
    gross_reported,
    rests_called_gross,
    slow_reported_ahead,
    usual,
)
from bench.slip.tables import by_name, by_threshold, reliability_of
from tactiled.detect.contact.slips_by_threshold import SlipThresholds

_COLOURS = ("#1f77b4", "#2ca02c", "#ff7f0e", "#d62728", "#9467bd")
_MARKERS = ("o", "s", "^", "x", "+")  # of the settings, then of other detectors

Score = Callable[[Sequence[Reported]], float]


def _ahead(reported: Sequence[Reported]) -> float:
    return _percent(slow_reported_ahead(usual(reported)))


def _gross(reported: Sequence[Reported]) -> float:
    return _percent(gross_reported(usual(reported), 0.1))


def _rests(reported: Sequence[Reported]) -> float:
    return _percent(rests_called_gross(reported))


def _percent(cases: Sequence[bool]) -> float:
    return 100 * float(np.mean(cases)) if cases else float("nan")


def draw_slip(path: Path, groups: Mapping[str, Sequence[CaseEvents]]) -> None:
    """Write the picture. Lines: curves over the probabilities of the contact model; marks: settings."""
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    incipient, gross, calibration = figure.subplots(1, 3)
    for colour, (group, events) in zip(_COLOURS, groups.items(), strict=False):
        label = group if group == RANDOM else f"families, {group}"
        curve = [incipient_curve_at(p) for p in INCIPIENT_PS]
        _draw(incipient, events, curve, (false_onsets_per_hour, _ahead), colour, label)
        curve = [gross_curve_at(p) for p in GROSS_PS]
        _draw(gross, events, curve, (_rests, _gross), colour, label)
    for marker, name in zip(_MARKERS, NAMES, strict=False):
        incipient.plot([], [], marker, color="#555555", label=name)
    incipient.set(xscale="symlog", xlabel="onsets an hour where nothing slips")
    incipient.set(ylabel="slow slips reported 100 ms ahead (%)", ylim=(0, 103), title="Incipient slip")
    gross.set(xlabel="rests called gross (%)", ylabel="gross slips reported in 100 ms (%)", ylim=(0, 103))
    gross.set(title="Gross slip")
    found = reliability_of(groups[RANDOM])
    known = found.time_s > 0
    calibration.plot(
        found.said_s[known] / found.time_s[known], found.seen_s[known] / found.time_s[known], "o-"
    )
    calibration.plot([0, 1], [0, 1], "k:", lw=1)
    calibration.set(xlabel="probability that a tenth of the area slips", ylabel="share of the time it did")
    calibration.set(title="Calibration while shear grows, random worlds")
    for axes in (incipient, gross, calibration):
        axes.grid(alpha=0.3)
    incipient.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def _draw(
    axes: Axes,
    events: Sequence[CaseEvents],
    curve: Sequence[SlipThresholds],
    scores: tuple[Score, Score],
    colour: str,
    label: str,
) -> None:
    def point(found: Sequence[Reported]) -> tuple[float, float]:
        return scores[0](found), scores[1](found)

    x, y = zip(*(point(by_threshold(events, at)) for at in curve), strict=True)
    axes.plot(x, y, "-", color=colour, lw=1.5, label=label)
    for marker, name in zip(_MARKERS, NAMES, strict=False):
        axes.plot(*point(by_name(events, name)), marker, color=colour, ms=8)

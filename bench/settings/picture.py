"""Picture of ``./run bench settings``: what each probability gains and costs, beside the other detector."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.settings.bench import (
    POSTERIOR_SETTINGS,
    SettingsFound,
    reliability_of,
    told_by_coherent,
    told_by_posterior,
)
from bench.settings.cases import RANDOM
from bench.settings.replay import (
    GROSS_PS,
    INCIPIENT_PS,
    CaseEvents,
    gross_curve_at,
    incipient_curve_at,
)
from bench.settings.score import (
    Told,
    false_onsets_per_hour,
    gross_told,
    rests_called_gross,
    slow_told_ahead,
    usual,
)
from tactiled.detect.grip.thresholds import SlipThresholds
from tactiled.detect.slip.detector import SETTINGS

_COLOURS = ("#1f77b4", "#2ca02c", "#ff7f0e", "#d62728")
_MARKERS = ("o", "s", "^")

Score = Callable[[Sequence[Told]], float]


def _ahead(told: Sequence[Told]) -> float:
    return _percent(slow_told_ahead(usual(told)))


def _gross(told: Sequence[Told]) -> float:
    return _percent(gross_told(usual(told), 0.1))


def _rests(told: Sequence[Told]) -> float:
    return _percent(rests_called_gross(told))


def _percent(cases: Sequence[bool]) -> float:
    return 100 * float(np.mean(cases)) if cases else float("nan")


def draw_settings(path: Path, found: SettingsFound) -> None:
    """Write the picture. Lines and hollow marks: contact model; filled marks: detector of docs/slip.md."""
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    incipient, gross, calibration = figure.subplots(1, 3)
    for colour, (group, events) in zip(_COLOURS, found.groups().items(), strict=False):
        label = group if group == RANDOM else f"families, {group}"
        curve = [incipient_curve_at(p) for p in INCIPIENT_PS]
        _draw(incipient, events, curve, (false_onsets_per_hour, _ahead), colour, label)
        curve = [gross_curve_at(p) for p in GROSS_PS]
        _draw(gross, events, curve, (_rests, _gross), colour, label)
    for marker, name, grip in zip(_MARKERS, SETTINGS, POSTERIOR_SETTINGS, strict=True):
        incipient.plot([], [], marker, color="#555555", label=f"{name}; hollow: {grip}")
    incipient.set(xscale="symlog", xlabel="onsets an hour where nothing slips")
    incipient.set(ylabel="slow slips told 100 ms ahead (%)", ylim=(0, 103), title="Incipient slip")
    gross.set(xlabel="rests called gross (%)", ylabel="gross slips told within 100 ms (%)", ylim=(0, 103))
    gross.set(title="Gross slip")
    told = reliability_of(found.groups()[RANDOM])
    known = told.time_s > 0
    calibration.plot(told.said_s[known] / told.time_s[known], told.seen_s[known] / told.time_s[known], "o-")
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
    def point(told: Sequence[Told]) -> tuple[float, float]:
        return scores[0](told), scores[1](told)

    x, y = zip(*(point(told_by_posterior(events, at)) for at in curve), strict=True)
    axes.plot(x, y, "-", color=colour, lw=1.5, label=label)
    for marker, name in zip(_MARKERS, SETTINGS, strict=True):
        axes.plot(*point(told_by_coherent(events, name)), marker, color=colour, ms=8)
    for marker, at in zip(_MARKERS, POSTERIOR_SETTINGS.values(), strict=True):
        axes.plot(*point(told_by_posterior(events, at)), marker, color=colour, ms=8, mfc="none")

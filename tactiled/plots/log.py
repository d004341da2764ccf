"""Picture of a log: readings, margin to slip, grooves and one slip, with the truth where known."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.events.types import Event, GripEvent, SlipEvent, TextureEvent
from tactiled.plots import save
from tactiled.plots.grooves import answer_in_words, draw_answers, draw_map
from tactiled.plots.palette import CHANNELS, MARGIN, SLIP, TRUTH

_TOP = 1.5  # of the axis: a posterior that knows little reaches far beyond 1


@dataclass(frozen=True, eq=False)
class KnownTruth:
    """Ground truth of a log."""

    onsets_s: tuple[float, ...]  # instants at which a tenth of the contact slips
    # Each slip from the beginning of shear to gross slip. An onset estimated inside is no false alarm
    spans_s: tuple[tuple[float, float], ...]
    time_s: FloatArray  # (n,)
    utilisation: FloatArray  # (n,): at these instants; NaN without contact


def draw_log(
    path: Path,
    array: Array,
    time_s: FloatArray,
    volts: FloatArray,
    events: Sequence[Event],
    title: str,
    *,
    truth: KnownTruth | None = None,
) -> None:
    """Draw the readings of a taxel, the margin to slip, groove estimates and the first slip, gross if one is.

    Events and `time_s` (n,) are on the same clock; `volts` (n, channels) are in the unit of the array.
    """
    origin_s, last_s = float(time_s[0]), float(time_s[-1])
    slips = [e for e in events if isinstance(e, SlipEvent)]
    onsets = [e for e in slips if e.state == "onset"]
    textures = [e for e in events if isinstance(e, TextureEvent)]
    answers = [e for e in textures if e.status == "ok"]
    grips = [e for e in events if isinstance(e, GripEvent)]
    spread = np.ma.masked_invalid(volts).std(axis=0).filled(0.0)
    taxel = int(np.argmax(np.bincount(array.channel_taxel, spread, array.n_taxels)))
    channels = np.flatnonzero(array.channel_taxel == taxel)[: len(CHANNELS)]
    rows = ["rr"] + ["gg"] * bool(grips) + ["pa"] * bool(answers)
    below = "m" * bool(answers) + "o" * bool(onsets)
    rows += [(below * 2)[:2]] * bool(below)
    figure = Figure(figsize=(11, 3.2 * len(rows)), layout="constrained")
    axes = figure.subplot_mosaic("\n".join(rows))
    answer = answer_in_words(textures, onsets)
    figure.suptitle(f"{title}: taxel {taxel} of {array.name}" + f"\n{answer}" * bool(answer))
    for color, channel in zip(CHANNELS, channels, strict=False):
        name = array.channel_name[channel].split(".")[-1]
        axes["r"].plot(time_s - origin_s, volts[:, channel], color=color, lw=0.9, label=name)
    axes["r"].set_ylabel(f"readings ({array.unit})")
    if grips:
        _draw_margin(axes["g"], grips, truth, origin_s)
    for name in "r" + "g" * bool(grips):
        _mark_slips(axes[name], slips, last_s, truth, origin_s)
        axes[name].set_xlim(0, last_s - origin_s)
        axes[name].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
        axes[name].set_xlabel("time (s)")
    if answers:
        draw_answers(axes["p"], axes["a"], textures, origin_s)
        draw_map(axes["m"], array, answers[-1], onsets)
    if onsets:
        gross = [e for e in onsets if e.kind == "gross" and truth is None]
        _draw_onset(axes["o"], channels, time_s, volts, (gross or onsets)[0], truth, array.unit)
    save(figure, path)


def _mark_slips(
    axis: Axes, slips: Sequence[SlipEvent], last_s: float, truth: KnownTruth | None, origin_s: float
) -> None:
    """Shade each slip from onset to end, darker up to its detection, and the true slips.

    What ends a slip is an end, a gross onset of the same slip, or the end of the log.
    """
    shaded = ("true: shear begins to gross slip", "gross slip", "incipient slip", "onset to detection")
    once = {label: label for label in shaded}  # in the legend
    for begin_s, gross_s in truth.spans_s if truth is not None else ():
        label = once.pop(shaded[0], None)
        axis.axvspan(begin_s - origin_s, gross_s - origin_s, color=TRUTH, alpha=0.5, lw=0, label=label)
    for event, after in zip_longest(slips, slips[1:]):
        if event.state != "onset":
            continue
        end_s = last_s if after is None else after.onset_s if after.state == "onset" else after.time_s
        begin, detected, end = event.onset_s - origin_s, event.detected_s - origin_s, end_s - origin_s
        if end > begin:
            alpha, label = 0.16 if event.kind == "gross" else 0.07, once.pop(f"{event.kind} slip", None)
            axis.axvspan(begin, end, color=SLIP, alpha=alpha, lw=0, label=label)
        axis.axvspan(begin, detected, color=SLIP, alpha=0.6, lw=0.6, label=once.pop(shaded[3], None))


def _draw_onset(
    axis: Axes,
    channels: NDArray[np.int64],
    time_s: FloatArray,
    volts: FloatArray,
    first: SlipEvent,
    truth: KnownTruth | None,
    unit: str,
) -> None:
    """Draw an onset enlarged: milliseconds and thousandths of the unit relative to it."""
    is_known = truth is not None and bool(truth.onsets_s)
    onset_s = truth.onsets_s[0] if truth is not None and truth.onsets_s else first.onset_s
    near = (time_s > onset_s - 0.1) & (time_s < onset_s + 0.25)
    for color, channel in zip(CHANNELS, channels, strict=False):
        change = volts[near, channel] - volts[near, channel][:1]
        axis.plot(1e3 * (time_s[near] - onset_s), 1e3 * change, ".-", color=color, lw=0.9, ms=4)
    if is_known:
        axis.axvline(0, color=TRUTH, lw=2.5, alpha=0.6, label="true: a tenth slips")
    begin_ms, sd_ms = 1e3 * (first.onset_s - onset_s), 1e3 * first.onset_sd_s
    latency_ms = 1e3 * (first.detected_s - first.onset_s)
    axis.axvspan(begin_ms - sd_ms, begin_ms + sd_ms, color=SLIP, alpha=0.12, lw=0, label="onset ± 1 sd")
    axis.axvline(begin_ms, color=SLIP, lw=1.2, label="estimated onset")
    label = f"detected {latency_ms:.0f} ms later"
    axis.axvline(begin_ms + latency_ms, color=SLIP, lw=1.2, ls=":", label=label)
    axis.set_xlabel("time since a tenth slips (ms)" if is_known else "time since the onset (ms)")
    axis.set_ylabel(f"change (m{unit})" if unit in ("V", "N") else f"change (0.001 {unit})")
    axis.set_title(f"first {first.kind} slip", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncol=2)


def _draw_margin(axis: Axes, grips: Sequence[GripEvent], truth: KnownTruth | None, origin_s: float) -> None:
    """Draw utilisation with its 90 % interval over the truth, and `p_sliding`."""
    time_s = np.array([grip.time_s for grip in grips]) - origin_s
    known = np.array([grip.valid and grip.state != "none" for grip in grips])
    low, middle, high, gross = (
        np.where(known, [getattr(grip, name) for grip in grips], np.nan)
        for name in ("utilisation_low", "utilisation", "utilisation_high", "p_sliding")
    )
    if truth is not None:
        axis.plot(truth.time_s - origin_s, truth.utilisation, color=TRUTH, lw=3, alpha=0.6, label="true")
    axis.fill_between(time_s, low, high, color=MARGIN, alpha=0.2, lw=0, label="5 to 95 %")
    axis.plot(time_s, middle, color=MARGIN, lw=1.2, label="utilisation")
    axis.plot(time_s, gross, color=SLIP, lw=0.9, ls="--", label="probability that\nall of it slides")
    axis.axhline(1.0, color="black", lw=0.6)
    axis.set_ylim(0, _TOP)
    axis.set_ylabel("shear over\nfriction limit")

"""Picture of a log: readings, margin to slip and events, with the ground truth where known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import SwtBank
from tactiled.detect.suite import DetectParams
from tactiled.detect.wang2019.slip import SlipParams, level_at
from tactiled.detect.wang2019.spectrum import spectrum
from tactiled.events.types import Event, GripEvent, SlipEvent, TextureEvent
from tactiled.plots.grooves import answer_in_words, draw_answers, draw_folded, draw_map, refusal_reason
from tactiled.plots.palette import CHANNELS, GROOVES, MARGIN, NEUTRAL, SLIP, TRUTH
from tactiled.recording.table import to_blocks
from tactiled.samples.block import ScanBlock

FloatArray = NDArray[np.float64]
_TOP = 1.5  # of the axis: a posterior that knows little reaches far beyond 1
_REFUSED_WINDOW_S = 2.0  # least window in the spectrum of a refusal
_SPECTRUM_MARGIN = 4  # times the estimated frequency: its first harmonics


@dataclass(frozen=True, eq=False)
class KnownMargin:
    """True utilisation (n,) at n instants (n,) in seconds; NaN without contact."""

    time_s: FloatArray
    utilisation: FloatArray


@dataclass(frozen=True)
class KnownTruth:
    """Ground truth: slips, the ripple frequency of the grooves and the utilisation, if any."""

    onsets_s: tuple[float, ...] = ()  # instants at which a tenth of the contact slips
    # Each slip from the beginning of shear to gross slip. An onset estimated inside is no false alarm
    spans_s: tuple[tuple[float, float], ...] = ()
    frequency_hz: float | None = None
    label: str = ""
    margin: KnownMargin | None = None


@dataclass(frozen=True)
class _SlipSpan:
    """A reported slip: onset, detection and end; the end of the log where the slip has no end."""

    onset_s: float
    detected_s: float
    end_s: float
    is_gross: bool


def draw_log(
    path: Path,
    array: Array,
    time_s: FloatArray,
    volts: FloatArray,
    events: Sequence[Event],
    params: DetectParams,
    title: str,
    *,
    channel_offset_s: FloatArray | None = None,
    truth: KnownTruth | None = None,
) -> None:
    """Draw the readings of a taxel, the margin to slip, groove estimates and their fit.

    With the published methods, the wavelet coefficients that they compare with a threshold are drawn as well.

    Parameters
    ----------
    path : Path
        PNG, or another format that matplotlib derives from the suffix.
    time_s : (n,) float64
    volts : (n, channels) float64
        In the unit of the array.
    events : sequence of Event
        Events of this log, on the same clock.
    channel_offset_s : (channels,) float64, optional
        Delay of each channel's sample after the start of the scan.
    """
    truth = truth or KnownTruth()
    if channel_offset_s is None:
        channel_offset_s = np.zeros(array.n_channels)
    origin_s = float(time_s[0])
    slips = [e for e in events if isinstance(e, SlipEvent)]
    onsets = [e for e in slips if e.state == "onset"]
    textures = [e for e in events if isinstance(e, TextureEvent)]
    answers = [e for e in textures if e.status == "ok"]
    taxel = _most_varying_taxel(array, volts)
    channels = np.flatnonzero(array.channel_taxel == taxel)[: len(CHANNELS)]
    last_row = ["o"] * bool(onsets) + ["s"] * bool(textures)
    grips = [e for e in events if isinstance(e, GripEvent)]
    is_published = params.setting == "wang2019"
    rows = (
        ["vv"]
        + ["cc"] * is_published
        + ["gg"] * bool(grips)
        + ["pa", "mf"] * bool(answers)
        + ["".join((last_row * 2)[:2])] * bool(last_row)
    )
    figure = Figure(figsize=(11, 3.2 * len(rows)), layout="constrained")
    axes = figure.subplot_mosaic("\n".join(rows))
    answer = answer_in_words(textures, onsets)
    figure.suptitle(f"{title}: taxel {taxel} of {array.name}" + f"\n{answer}" * bool(answer))
    _draw_readings(axes["v"], array, channels, time_s - origin_s, volts)
    parts = to_blocks(time_s, volts, None, array.in_range(volts))
    blocks = [part for part in parts if isinstance(part, ScanBlock)]
    if is_published:
        draw_coefficients(axes["c"], array, channels, blocks, origin_s, params.wang2019.slip)
    spans = list(_spans(slips, float(time_s[-1])))
    if grips:
        draw_margin(axes["g"], grips, truth.margin, origin_s)
    for name in "v" + "c" * is_published + "g" * bool(grips):
        _mark_slips(axes[name], spans, truth, origin_s)
        axes[name].set_xlim(0, float(time_s[-1]) - origin_s)
        axes[name].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
        axes[name].set_xlabel("time (s)")
    if answers:
        draw_answers(axes["p"], axes["a"], textures, origin_s)
        draw_map(axes["m"], array, answers[-1], onsets)
        draw_folded(axes["f"], array, time_s, volts, channel_offset_s, answers[-1], onsets)
    if onsets:
        _draw_onset(axes["o"], channels, time_s, volts, channel_offset_s, onsets, truth, array.unit)
    if textures:
        shown = (answers or [e for e in textures if e.status != "no-slip"] or textures)[-1]
        _draw_spectrum(axes["s"], array, channels, time_s, volts, shown, params, truth)
    figure.savefig(path, dpi=110)


def _most_varying_taxel(array: Array, volts: FloatArray) -> int:
    """Select the taxel with the largest variation."""
    spread = np.nan_to_num(np.nanstd(np.where(np.isfinite(volts), volts, 0.0), axis=0))
    return int(np.argmax(np.bincount(array.channel_taxel, spread, array.n_taxels)))


def _draw_readings(
    axis: Axes, array: Array, channels: NDArray[np.int64], seconds: FloatArray, volts: FloatArray
) -> None:
    for color, channel in zip(CHANNELS, channels, strict=False):
        name = array.channel_name[channel].split(".")[-1]
        axis.plot(seconds, volts[:, channel], color=color, lw=0.9, label=name)
    axis.set_ylabel(f"readings ({array.unit})")


def _spans(slips: Sequence[SlipEvent], last_s: float) -> Iterator[_SlipSpan]:
    """Pair onsets with what ends them: an end, a gross onset of the same slip, or the end of the log."""
    for number, event in enumerate(slips):
        if event.state == "onset":
            after = slips[number + 1] if number + 1 < len(slips) else None
            end_s = last_s if after is None else after.onset_s if after.state == "onset" else after.time_s
            yield _SlipSpan(event.onset_s, event.detected_s, end_s, event.kind == "gross")


def _mark_slips(axis: Axes, spans: Sequence[_SlipSpan], truth: KnownTruth, origin_s: float) -> None:
    """Shade each slip from onset to end, darker up to its detection, and the true slips."""
    seen: set[str] = set()

    def once(label: str) -> str | None:
        if label in seen:
            return None
        seen.add(label)
        return label

    for begin_s, gross_s in truth.spans_s:
        label = once("true: shear begins to gross slip")
        axis.axvspan(begin_s - origin_s, gross_s - origin_s, color=TRUTH, alpha=0.5, lw=0, label=label)
    for span in spans:
        kind = "gross slip" if span.is_gross else "incipient slip"
        begin, detected, end = span.onset_s - origin_s, span.detected_s - origin_s, span.end_s - origin_s
        if end > begin:
            axis.axvspan(
                begin, end, color=SLIP, alpha=0.16 if span.is_gross else 0.07, lw=0, label=once(kind)
            )
        axis.axvspan(begin, detected, color=SLIP, alpha=0.6, lw=0.6, label=once("onset to detection"))


def _draw_onset(
    axis: Axes,
    channels: NDArray[np.int64],
    time_s: FloatArray,
    volts: FloatArray,
    channel_offset_s: FloatArray,
    onsets: Sequence[SlipEvent],
    truth: KnownTruth,
    unit: str,
) -> None:
    """Draw the first onset enlarged: milliseconds and thousandths of the unit relative to it."""
    onset_s = truth.onsets_s[0] if truth.onsets_s else onsets[0].onset_s
    near = (time_s > onset_s - 0.1) & (time_s < onset_s + 0.25)
    for color, channel in zip(CHANNELS, channels, strict=False):
        change = volts[near, channel] - volts[near, channel][0]
        sampled_s = time_s[near] + channel_offset_s[channel]
        axis.plot(1e3 * (sampled_s - onset_s), 1e3 * change, ".-", color=color, lw=0.9, ms=4)
    if truth.onsets_s:
        axis.axvline(0, color=TRUTH, lw=2.5, alpha=0.6, label="true: a tenth slips")
    first = onsets[0]
    begin_ms, sd_ms = 1e3 * (first.onset_s - onset_s), 1e3 * first.onset_sd_s
    latency_ms = 1e3 * (first.detected_s - first.onset_s)
    axis.axvspan(begin_ms - sd_ms, begin_ms + sd_ms, color=SLIP, alpha=0.12, lw=0, label="onset ± 1 sd")
    axis.axvline(begin_ms, color=SLIP, lw=1.2, label="estimated onset")
    label = f"detected {latency_ms:.0f} ms later"
    axis.axvline(begin_ms + latency_ms, color=SLIP, lw=1.2, ls=":", label=label)
    axis.set_xlabel("time since a tenth slips (ms)" if truth.onsets_s else "time since the onset (ms)")
    axis.set_ylabel(f"change (m{unit})" if unit in ("V", "N") else f"change (0.001 {unit})")
    axis.set_title("first slip", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncol=2)


def _draw_spectrum(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    time_s: FloatArray,
    volts: FloatArray,
    event: TextureEvent,
    params: DetectParams,
    truth: KnownTruth,
) -> None:
    """Draw the spectrum of the channel with the largest peak, with the estimate or the refusal's reason."""
    is_answer = event.status == "ok"
    window_s = event.window_s if is_answer else max(event.window_s, _REFUSED_WINDOW_S)
    inside = (time_s > event.time_s - window_s) & (time_s <= event.time_s + 1e-9)
    window = np.nan_to_num(volts[inside][:, channels])
    title = f"spectrum of {window_s:.3g} s until {event.time_s - float(time_s[0]):.1f} s"
    axis.set_title(title if is_answer else f"{title}:\n{refusal_reason(event)}", fontsize=10)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel(f"amplitude (0.001 {array.unit})")
    if len(window) < 8:  # nothing to transform
        return
    rate_hz = float(1 / np.median(np.diff(time_s)))
    step = Quantiser(array).volts_per_step
    found = spectrum(window, rate_hz, step, params.wang2019.texture.low_pass_hz)
    best = int(np.argmax(found.amplitude_volts[found.peak]))
    name = array.channel_name[channels[best]].split(".")[-1]
    amplitude = 1e3 * found.amplitude_volts[:, best]
    axis.plot(found.frequency_hz, amplitude, ".-", color=CHANNELS[best], lw=1, ms=4, label=name)
    if truth.frequency_hz is not None:
        axis.axvline(truth.frequency_hz, color=TRUTH, lw=2.5, alpha=0.6, label=truth.label)
    if is_answer:
        label = (
            f"estimate: {event.frequency_hz:.2f} Hz\nD = {event.period_mm:.3f} mm, "
            f"angle {event.angle_deg:.1f}°\n(window {event.window_s:.3g} s)"
        )
        axis.axvline(event.frequency_hz, color=GROOVES, lw=1.2, label=label)
    elif event.status == "period-only":
        period = f"\nD = {event.period_mm:.3g} mm" if event.period_mm > 0 else ""
        label = f"estimate: {event.frequency_hz:.2f} Hz{period}"
        axis.axvline(event.frequency_hz, color=GROOVES, lw=1.2, label=label)
    if event.frequency_hz > 0:
        axis.set_xlim(0, max(_SPECTRUM_MARGIN * event.frequency_hz, 1.0))
    axis.legend(frameon=False, fontsize=9, loc="upper right")


def draw_coefficients(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    blocks: list[ScanBlock],
    origin_s: float,
    slip: SlipParams,
) -> None:
    """Draw the coefficients of the channels of one taxel, with the threshold of the published procedure."""
    largest = slip.threshold_volts
    for block in blocks:
        level = level_at(block.rate_hz, slip)
        volts, usable = SwtBank(array, level).filter(Quantiser(array).process(block))
        shown = np.where(usable, volts, np.nan)[:, channels]
        for color, values in zip(CHANNELS, shown.T, strict=False):
            axis.plot(block.time_s - origin_s, values * 1e3, color=color, lw=0.8)
        if np.isfinite(shown).any():
            largest = max(largest, float(np.nanmax(np.abs(shown))))
        axis.set_ylabel(f"coif1 level {level} (mV)")
    for sign in (-1, 1):
        label = f"threshold {slip.threshold_volts * 1e3:g} mV" if sign > 0 else None
        axis.axhline(sign * slip.threshold_volts * 1e3, color=NEUTRAL, ls="--", lw=1, label=label)
    # Linear up to the threshold, logarithmic beyond: kinks of slip are a hundred times larger.
    axis.set_yscale("symlog", linthresh=slip.threshold_volts * 1e3)
    axis.set_ylim(-1.5e3 * largest, 1.5e3 * largest)
    axis.set_title("slip criterion of the published procedure: one taxel", fontsize=10)


def draw_margin(axis: Axes, grips: Sequence[GripEvent], truth: KnownMargin | None, origin_s: float) -> None:
    """Draw utilisation with its 90 % interval over the truth, and `p_gross_300ms`.

    Parameters
    ----------
    origin_s : float
        Instant that is 0 on the axis of time.
    """
    time_s = np.array([grip.time_s for grip in grips]) - origin_s
    known = np.array([grip.valid and grip.state != "none" for grip in grips])
    low, middle, high, gross = (
        np.where(known, [getattr(grip, name) for grip in grips], np.nan)
        for name in ("utilisation_low", "utilisation", "utilisation_high", "p_gross_300ms")
    )
    if truth is not None:
        axis.plot(truth.time_s - origin_s, truth.utilisation, color=TRUTH, lw=3, alpha=0.6, label="true")
    axis.fill_between(time_s, low, high, color=MARGIN, alpha=0.2, lw=0, label="5 to 95 %")
    axis.plot(time_s, middle, color=MARGIN, lw=1.2, label="utilisation")
    axis.plot(time_s, gross, color=SLIP, lw=0.9, ls="--", label="probability of gross\nslip within 0.3 s")
    axis.axhline(1.0, color="black", lw=0.6)
    axis.set_ylim(0, _TOP)
    axis.set_ylabel("shear over\nfriction limit")

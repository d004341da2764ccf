"""Picture of a log: readings, detector signals and events, with the ground truth where known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import BankParams, SwtBank
from tactiled.detect.suite import DetectParams
from tactiled.detect.wang2019.slip import level_at
from tactiled.detect.wang2019.spectrum import spectrum
from tactiled.events.types import Event, SlipEvent, TextureEvent
from tactiled.plots.grooves import answer_in_words, draw_answers, draw_folded, draw_map
from tactiled.recording.table import to_blocks
from tactiled.samples.block import ScanBlock

FloatArray = NDArray[np.float64]
TRUE, FOUND, QUIET = "#1a7f37", "#c0392b", "#777777"
CHANNELS = ("#1f4e79", "#e07b00", "#6aa4d8", "#5b3a8c", "#b38f00", "#2b8a8a")


@dataclass(frozen=True)
class KnownTruth:
    """Ground truth: slip onsets, and the ripple frequency of the grooves, if any."""

    onsets_s: tuple[float, ...] = ()
    frequency_hz: float | None = None
    label: str = ""


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
    """Draw voltages and wavelet coefficients of a taxel, groove estimates, and their fit.

    Parameters
    ----------
    path : Path
        PNG (or any format matplotlib knows by ending).
    time_s : (n,) float64
    volts : (n, channels) float64
    events : sequence of Event
        Events of this log, on the same clock.
    channel_offset_s : (channels,) float64, optional
        Delay of each channel's sample after the start of the scan.
    truth : KnownTruth, optional
    """
    truth = truth or KnownTruth()
    if channel_offset_s is None:
        channel_offset_s = np.zeros(array.n_channels)
    origin_s = float(time_s[0])
    onsets = [e for e in events if isinstance(e, SlipEvent) and e.state == "onset"]
    said = [e for e in events if isinstance(e, TextureEvent)]
    textures = [e for e in said if e.status == "ok"]
    taxel = _liveliest(array, volts)
    channels = np.flatnonzero(array.channel_taxel == taxel)
    last_row = ["o"] * bool(onsets) + ["s"] * bool(textures)
    rows = ["vv", "cc"] + ["pa", "mf"] * bool(textures) + ["".join((last_row * 2)[:2])] * bool(last_row)
    figure = Figure(figsize=(11, 3.2 * len(rows)), layout="constrained")
    axes = figure.subplot_mosaic("\n".join(rows))
    answer = answer_in_words(said, onsets)
    figure.suptitle(f"{title}: taxel {taxel} of {array.name}" + f"\n{answer}" * bool(answer))
    _draw_volts(axes["v"], array, channels, time_s - origin_s, volts)
    _draw_coefficients(axes["c"], array, channels, time_s, volts, params)
    for name in "vc":
        _mark_onsets(axes[name], onsets, truth, origin_s)
        axes[name].set_xlim(0, float(time_s[-1]) - origin_s)
        axes[name].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
        axes[name].set_xlabel("time (s)")
    if textures:
        draw_answers(axes["p"], axes["a"], said, origin_s)
        draw_map(axes["m"], array, textures[-1], onsets)
        draw_folded(axes["f"], array, time_s, volts, channel_offset_s, textures[-1], onsets)
    if onsets:
        _draw_onset(axes["o"], channels, time_s, volts, channel_offset_s, onsets, truth)
    if textures:
        _draw_spectrum(axes["s"], array, channels, time_s, volts, textures[-1], params, truth)
    figure.savefig(path, dpi=110)


def _liveliest(array: Array, volts: FloatArray) -> int:
    """Select the taxel with the largest variation."""
    spread = np.nan_to_num(np.nanstd(np.where(np.isfinite(volts), volts, 0.0), axis=0))
    return int(np.argmax(np.bincount(array.channel_taxel, spread, array.n_taxels)))


def _draw_volts(
    axis: Axes, array: Array, channels: NDArray[np.int64], seconds: FloatArray, volts: FloatArray
) -> None:
    for color, channel in zip(CHANNELS, channels, strict=False):
        name = array.channel_name[channel].split(".")[-1]
        axis.plot(seconds, volts[:, channel], color=color, lw=0.9, label=name)
    axis.set_ylabel("volts")


def _draw_coefficients(
    axis: Axes,
    array: Array,
    channels: NDArray[np.int64],
    time_s: FloatArray,
    volts: FloatArray,
    params: DetectParams,
) -> None:
    slip = params.wang2019.slip
    largest = slip.threshold_volts
    for block in to_blocks(time_s, volts, None, array.in_range(volts)):
        if not isinstance(block, ScanBlock):
            continue
        level = level_at(block.rate_hz, slip)
        found = SwtBank(array, BankParams(levels=(level,))).process(block)
        shown = np.where(found.usable[:, 0], found.volts[:, 0], np.nan)[:, channels]
        for color, values in zip(CHANNELS, shown.T, strict=False):
            axis.plot(block.time_s - time_s[0], values * 1e3, color=color, lw=0.8)
        if np.isfinite(shown).any():
            largest = max(largest, float(np.nanmax(np.abs(shown))))
        axis.set_ylabel(f"coif1 level {level} (mV)")
    for sign in (-1, 1):
        label = f"threshold {slip.threshold_volts * 1e3:g} mV" if sign > 0 else None
        axis.axhline(sign * slip.threshold_volts * 1e3, color=QUIET, ls="--", lw=1, label=label)
    # Linear up to the threshold, logarithmic beyond: kinks of slip are a hundred times larger.
    axis.set_yscale("symlog", linthresh=slip.threshold_volts * 1e3)
    axis.set_ylim(-1.5e3 * largest, 1.5e3 * largest)


def _mark_onsets(axis: Axes, onsets: Sequence[SlipEvent], truth: KnownTruth, origin_s: float) -> None:
    for number, onset_s in enumerate(truth.onsets_s):
        label = "true onset" if not number else None
        axis.axvline(onset_s - origin_s, color=TRUE, lw=2.5, alpha=0.6, label=label)
    for number, event in enumerate(onsets):
        label = "estimated onset" if not number else None
        axis.axvline(event.onset_s - origin_s, color=FOUND, lw=1.2, label=label)
        label = "said at" if not number else None
        axis.axvline(event.detected_s - origin_s, color=FOUND, lw=0.9, ls=":", label=label)


def _draw_onset(
    axis: Axes,
    channels: NDArray[np.int64],
    time_s: FloatArray,
    volts: FloatArray,
    channel_offset_s: FloatArray,
    onsets: Sequence[SlipEvent],
    truth: KnownTruth,
) -> None:
    """Draw the first onset enlarged, in milliseconds and millivolts relative to it."""
    onset_s = truth.onsets_s[0] if truth.onsets_s else onsets[0].onset_s
    near = (time_s > onset_s - 0.1) & (time_s < onset_s + 0.25)
    for color, channel in zip(CHANNELS, channels, strict=False):
        change = volts[near, channel] - volts[near, channel][0]
        sampled_s = time_s[near] + channel_offset_s[channel]
        axis.plot(1e3 * (sampled_s - onset_s), 1e3 * change, ".-", color=color, lw=0.9, ms=4)
    if truth.onsets_s:
        axis.axvline(0, color=TRUE, lw=2.5, alpha=0.6)
    first = onsets[0]
    begins, sd = 1e3 * (first.onset_s - onset_s), 1e3 * first.onset_sd_s
    axis.axvline(begins, color=FOUND, lw=1.2)
    axis.axvspan(begins - sd, begins + sd, color=FOUND, alpha=0.12, lw=0, label="estimate ± sigma")
    axis.axvline(1e3 * (first.detected_s - onset_s), color=FOUND, lw=0.9, ls=":")
    axis.set_xlabel("time since the true onset (ms)" if truth.onsets_s else "time since the onset (ms)")
    axis.set_ylabel("change (mV)")
    axis.set_title("the first slip", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="upper left")


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
    inside = (time_s > event.time_s - event.window_s) & (time_s <= event.time_s + 1e-9)
    window = np.nan_to_num(volts[inside][:, channels])
    rate_hz = float(1 / np.median(np.diff(time_s)))
    step = Quantiser(array).volts_per_step
    seen = spectrum(window, rate_hz, step, params.wang2019.texture.low_pass_hz)
    best = int(np.argmax(seen.amplitude_volts[seen.peak]))
    name = array.channel_name[channels[best]].split(".")[-1]
    axis.plot(
        seen.frequency_hz,
        1e3 * seen.amplitude_volts[:, best],
        ".-",
        color=CHANNELS[best],
        lw=1,
        ms=4,
        label=name,
    )
    if truth.frequency_hz is not None:
        axis.axvline(truth.frequency_hz, color=TRUE, lw=2.5, alpha=0.6, label=truth.label)
    label = (
        f"estimate: {event.frequency_hz:.2f} Hz\nD = {event.period_mm:.3f} mm, "
        f"angle {event.angle_deg:.1f}°\n(window {event.window_s:.3g} s)"
    )
    axis.axvline(event.frequency_hz, color=FOUND, lw=1.2, label=label)
    axis.set_xlim(0, max(4 * event.frequency_hz, 1.0))
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("amplitude (mV)")
    axis.set_title("spectrum of the last window", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="upper right")

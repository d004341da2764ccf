"""Grooves from one window of scans: the joint maximum-likelihood fit of a plane wave to all channels.

`wave_model` has the model. Steps: find the line in the pooled spectrum (`wave_lines`); list every wave vector
that its phases allow (`wave_search`); climb to the maximum from the best, harmonics and all (`wave_solve`);
weigh best against the others; state sigmas from the Fisher information.

Each window is fitted anew. Running sums could spare what depends on scans alone, the spectrum and the
projection of trends, and that once a window slides: while it grows, its bins move with it. `./run bench
texture` prints their part of a fit. Starting from the last answer would spare the search; but the search is
what finds a rival that has become as likely since, and bits would depend on which windows came before.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.answer import answer
from tactiled.detect.grooves.basis import Window, make_window, tabulate
from tactiled.detect.grooves.beside import agree, cleared, pairs_of
from tactiled.detect.grooves.harmonics import foreign_lines
from tactiled.detect.grooves.model import Layout, WaveFit, WaveMotion, WaveParams
from tactiled.detect.grooves.refine import Refined, refine
from tactiled.detect.grooves.ripple import Ripple, strongest
from tactiled.detect.grooves.search import search, together
from tactiled.detect.grooves.weigh import TEMPER, by_load, has_lever, pair_candidates, weighed

_MOST_BAD_PART = 0.05  # of a channel's readings; with more, the channel is left out
_MOST_VOLTS = 1e9  # no converter reads more; fourth powers of it, and of its noise, are finite numbers
_MOST_STRAY_ALIASED = 0.2  # radians^2: with more, what suits no wave suits its mirror image no better
_BROAD = 0.25 * np.pi  # of turn: what is no wave is no clean line either
_ALIASED = 0.45  # of the scan rate: above, a ripple cannot be told from its mirror image
_SAME_LINE = 0.25 * np.pi  # of turn: strong lines are known far better than by a quarter of a bin
_MOST_LINES = 3  # hum and the like that may be stronger than the grooves, and one
_WAVES = ("ok", "ambiguous")
_OWN_HARMONICS = 8  # of a grating, none of which is a second one
_SECOND_PART = 0.01  # of a grating's power: weaker ones may be what the model does not describe of it
Line = tuple[float, list[int]]  # turn, and which multiples of it are its own


def fit_wave(
    volts: FloatArray,
    time_s: FloatArray,
    channel_offset_s: FloatArray,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    usable: NDArray[np.bool_] | None = None,
    speeds_mm_s: FloatArray | None = None,
) -> WaveFit:
    """The joint fit for one window.

    Parameters
    ----------
    volts : (n, channels) float64
    time_s : (n,) float64
        Instants at which scans began, evenly spaced or nearly so.
    channel_offset_s : (channels,) float64
    layout : Layout
    motion : WaveMotion
    params : WaveParams
    usable : (n, channels) bool
        False for readings not to go by; default: those that are finite.
    speeds_mm_s : (n,) float64, optional
        Speed from each scan to the next, where it is known and not steady; `motion` then has the mean.
    """
    sane = np.abs(volts) <= _MOST_VOLTS
    usable = sane if usable is None else usable & sane
    chosen = np.flatnonzero(usable.mean(axis=0) >= 1 - _MOST_BAD_PART)
    n = len(volts)
    if n <= params.trend_order + 4 * params.max_harmonics + 1:
        return WaveFit("too-few-periods")
    if not len(chosen):
        return WaveFit("saturated")
    readings = _filled(volts[:, chosen], usable[:, chosen])
    x_mm, y_mm = layout.x_mm[chosen], layout.y_mm[chosen]
    centre = (x_mm.min() + x_mm.max()) / 2, (y_mm.min() + y_mm.max()) / 2
    here = Layout(x_mm - centre[0], y_mm - centre[1], layout.kind[chosen])
    rate = np.full(n, motion.speed_mm_s if motion.has_speed else 1.0)
    if speeds_mm_s is not None and motion.has_speed:
        rate = speeds_mm_s
    window = make_window(readings, time_s, rate, channel_offset_s[chosen])
    return _fit(window, here, motion, params)


def _filled(volts: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Readings with the few bad ones bridged by a line."""
    volts = volts.copy()
    scans = np.arange(len(volts))
    for c in np.flatnonzero(~usable.all(axis=0)):
        good = usable[:, c]
        volts[~good, c] = np.interp(scans[~good], scans[good], volts[good, c])
    return volts


def _fit(window: Window, layout: Layout, motion: WaveMotion, params: WaveParams) -> WaveFit:
    """The strongest wave and, where there is another beside it, the second."""
    first, line = _strongest_wave(window, layout, motion, params)
    if line is None or first.status not in _WAVES:
        return first
    # What bears the first wave out moves the second one too.
    motion = motion.without_speed if first.status == "ok" and not first.is_tied else motion
    least = _SECOND_PART * _line_power(window, line[0])
    second, other = _strongest_wave(window.without(*line), layout, motion, params, least)
    if other is None or second.status != "ok":
        return first
    # Anew without the other, which was noise to it.
    first, _ = _strongest_wave(window.without(*other), layout, motion, params)
    return replace(first, second=second) if first.status == "ok" else first


def _line_power(window: Window, turn: float) -> float:
    return float(tabulate(window, turn, 1).explained().sum())


def _strongest_wave(
    window: Window, layout: Layout, motion: WaveMotion, params: WaveParams, least: float = 0.0
) -> tuple[WaveFit, Line | None]:
    """Fit of the strongest line that is a wave, of some power; lines that are none are taken out first."""
    if float(window.power.sum()) < least:  # no line has more than all that is there
        return WaveFit("low-snr"), None
    gone: list[float] = []
    for _ in range(_MOST_LINES):
        readings = strongest(window, params)
        if not readings or max(_line_power(each.window, each.turn) for each in readings) < least:
            return WaveFit("low-snr"), None
        for line in readings:
            if line.periods < params.min_periods:
                return WaveFit("too-few-periods", window.frequency_hz(line.turn)), None
            found = _wave(line, layout, motion, params)
            if found is not None and found[0].status == "ok" and _is_multiple(line.turn, gone):
                return WaveFit("ambiguous", found[0].frequency_hz), found[1]
            if found is not None:
                return found
        turn = next(each.turn for each in readings if each.is_line)
        gone.append(turn)
        window = window.without(turn, [1 - _BROAD / turn, 1 + _BROAD / turn])
    return WaveFit("low-snr"), None


def _is_multiple(turn: float, gone: list[float]) -> bool:
    """Whether a line may be a harmonic of one that was no wave: half a period is no grating's."""
    times = [max(round(turn / other), 2) for other in gone]
    return any(abs(turn - n * other) < _SAME_LINE for n, other in zip(times, gone, strict=True))


def _wave(
    ripple: Ripple, layout: Layout, motion: WaveMotion, params: WaveParams
) -> tuple[WaveFit, Line] | None:
    """The wave of a line, as it is or as the mirror image of one too fast to be sampled; or None."""
    window, turn, variance = ripple.window, ripple.turn, ripple.variance
    if not has_lever(layout, motion):
        return WaveFit("ambiguous", window.frequency_hz(turn)), (turn, [1])
    tables = tabulate(window, turn, 1)
    least = together(window, tables, layout, variance)
    found = search(window, tables, layout, motion, params, variance, least)
    best = refine(window, layout, motion, params, found[0]) if len(found.k) else None
    if best is not None and best.stray.any():
        # Strays may have made another reading the best: of small ones both ways to take them know as little.
        likelihood = by_load(best, found, window, layout)[1]
        likeliest = int(likelihood.argmax())
        if likelihood[likeliest] - likelihood[0] > -TEMPER * np.log(params.error_probability):
            found = found[np.argsort(-likelihood, kind="stable")]
            best = refine(window, layout, motion, params, found[0])
    is_wave = best is not None and best.is_wave
    if ripple.is_line and (best is None or not is_wave or (motion.has_speed and best.stray.any())):
        # Too fast to be sampled, a ripple shows as a slower one, whose phases suit no wave well.
        whole_turn = 2 * np.pi / window.largest_step
        for fast in (whole_turn - turn, whole_turn + turn):
            other = search(window, tabulate(window, fast, 1), layout, motion, params, variance, least)
            if len(other.k) and (not is_wave or other.gain[0] > found.gain[0]):
                image = refine(window, layout, motion, params, other[0])
                if image.is_wave and image.stray_alone.mean() < _MOST_STRAY_ALIASED:
                    hz = window.frequency_hz(float(image.waves.turn[0]))
                    return WaveFit("aliased", hz, image.snr_db), (turn, [1])
    if best is None or not is_wave:
        if motion.has_speed and has_lever(layout, motion.without_speed):
            return _wave(ripple, layout, motion.without_speed, params)
        return None
    line = _own(window, layout, motion, params, best)
    fit = WaveFit("ok", window.frequency_hz(line[0]), best.snr_db)
    if line[0] * window.largest_step > 2 * np.pi * _ALIASED:
        return replace(fit, status="aliased"), line
    fit = answer(fit, best, window, layout, motion)
    colour = fit.colour
    fit = weighed(fit, best, found, window, layout, motion, params)
    pairs = pairs_of(colour, best, found, window, layout, motion, params)
    if pairs and not agree(pairs, best, layout):
        refused = WaveFit("ambiguous", fit.frequency_hz, fit.snr_db, error_probability=fit.error_probability)
        return replace(refused, candidates=pair_candidates(pairs)), line
    if pairs and fit.status == "ok":
        return cleared(fit, best, window.less(pairs[0].second, line[0]), layout, motion, params), line
    if pairs:  # the other wave bends the phases: they belie nothing that is said of the motion
        return fit, line
    if fit.status == "ambiguous" and motion.has_speed and has_lever(layout, motion.without_speed):
        # Phases that leave one reading only, whatever the motion, belie what is said of it.
        loose = _wave(ripple, layout, motion.without_speed, params)
        if loose is not None and loose[0].status == "ok":
            return loose
    return fit, line


def _own(window: Window, layout: Layout, motion: WaveMotion, params: WaveParams, best: Refined) -> Line:
    """The lines of a wave, also those too weak to go by."""
    turn = float(best.waves.turn[0])
    n_most = int(np.clip(np.pi / turn / window.largest_step, 1, _OWN_HARMONICS))
    n_most = next((h - 1 for h in range(2, n_most + 1) if window.is_gone(h * turn)), n_most)
    tables = tabulate(window, turn, n_most)
    foreign = foreign_lines(window, layout, motion, params, best.waves, tables, best.variance)
    return turn, [h for h in range(1, n_most + 1) if h not in foreign or h <= best.tables.n_harmonics]

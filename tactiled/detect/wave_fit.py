"""Grooves from one window of scans: the joint maximum-likelihood fit of a plane wave to all channels.

`wave_model` has the model. Steps: find the line in the pooled spectrum (`wave_lines`); list every wave vector
that its phases allow (`wave_search`); climb to the maximum from the best, harmonics and all (`wave_solve`);
weigh best against the others; state sigmas from the Fisher information.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tactiled.array import FloatArray
from tactiled.detect.wave_basis import Tables, Window, make_window, tabulate
from tactiled.detect.wave_lines import LEAST_VARIANCE, find_lines
from tactiled.detect.wave_model import Layout, WaveFit, WaveMotion, WaveParams
from tactiled.detect.wave_search import search
from tactiled.detect.wave_solve import Solver, Waves
from tactiled.events.types import Candidate

_MOST_BAD_PART = 0.05  # of a channel's readings; with more, the channel is left out
_ALIASED = 0.45  # of the scan rate: above, a ripple cannot be told from its mirror image
_SLOW_PART = 0.3  # of the line's power: stronger slow parts may be grooves of too few periods
_FALSE_FUNDAMENTAL = 1e-6  # noise passes for lines below the strongest one so often
# A fundamental has at least this part of its harmonics' power; less may be what the model does not describe.
_LEAST_FUNDAMENTAL = 0.03
_REFINEMENTS = 4
_MOST_CANDIDATES = 8


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
    usable = np.isfinite(volts) if usable is None else usable & np.isfinite(volts)
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
    way = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(time_s))])
    window = make_window(readings, way, rate, channel_offset_s[chosen], params.trend_order)
    return _fit(window, float(time_s[-1] - time_s[0]), here, motion, params)


def _filled(volts: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Readings with the few bad ones bridged by a line."""
    volts = volts.copy()
    scans = np.arange(len(volts))
    for c in np.flatnonzero(~usable.all(axis=0)):
        good = usable[:, c]
        volts[~good, c] = np.interp(scans[~good], scans[good], volts[good, c])
    return volts


def _fit(
    window: Window, duration_s: float, layout: Layout, motion: WaveMotion, params: WaveParams
) -> WaveFit:
    lines = find_lines(window)
    per_s = 1.0 / (duration_s * window.n / (window.n - 1))  # one period of the transform, in Hz
    least = params.min_periods - 0.5  # a line's peak may lie half a bin off
    peaks = [b for b in lines.peaks() if lines.cycles[b] >= least]
    slow = [b for b in lines.peaks() if lines.cycles[b] < least]
    if slow and (not peaks or lines.power[slow[0]] > _SLOW_PART * lines.power[peaks[0]]):
        return WaveFit("too-few-periods")
    if not peaks:
        return WaveFit("low-snr")
    frequency_hz = float(lines.cycles[peaks[0]] * per_s)
    turn = np.pi * float(lines.cycles[peaks[0]]) * (window.n - 1) / window.n
    if turn * window.largest_step > 2 * np.pi * _ALIASED:
        return WaveFit("aliased", frequency_hz)
    variance = lines.variance
    turn = _centred(window, turn, variance)
    turn = _fundamental(window, turn, params)
    tables = tabulate(window, turn, 1)
    found = search(window, tables, layout, motion, params, Solver(window, layout, motion, variance), variance)
    if not len(found.k):
        return WaveFit("ambiguous", frequency_hz)
    best, refined, variance, stray = _refined(window, layout, motion, params, found[0])
    # All readings anew, with what is known by now of noise and strays.
    solver = Solver(window, layout, motion, variance, stray[:, :1])
    found = solver.solve(tabulate(window, float(best.turn[0]), 1), found.k, found.turn, steps=2)
    found = found[np.argsort(-found.gain, kind="stable")]
    tables = refined
    power = tables.explained()
    snr_db = 10 * float(np.log10(max(float((power / variance).mean()) / window.n, 1e-10)))
    frequency_hz = float(best.turn[0]) / np.pi / duration_s
    fit = WaveFit("ok", frequency_hz, snr_db)
    if best.turn[0] / np.pi < params.min_periods - 0.05:
        return replace(fit, status="too-few-periods")
    odds = np.exp((found.gain - found.gain[0]) / 2)
    weights = odds / odds.sum()
    fit = replace(fit, error_probability=float(1 - weights[0]))
    if fit.error_probability > params.error_probability:
        shown = [i for i in np.argsort(-weights, kind="stable")[:_MOST_CANDIDATES] if weights[i] > 1e-4]
        return replace(fit, status="ambiguous", candidates=_candidates(found, weights, shown))
    return _answer(fit, best, window, motion, tables.n_harmonics)


def _fundamental(window: Window, turn: float, params: WaveParams) -> float:
    """The line's own turn, or that of the line that it is a harmonic of."""
    alone = tabulate(window, turn, 1).explained()
    total = (window.volts**2).sum(axis=1)
    for part in range(params.max_harmonics, 1, -1):
        if turn / part < np.pi * params.min_periods:
            continue
        explained = tabulate(window, turn / part, part).explained()
        n_free = window.n - window.trend.shape[1] - 2 * part
        variance = np.maximum((total - explained) / n_free, LEAST_VARIANCE)
        more = float(((explained - alone) / variance).sum())
        level = stats.chi2.isf(_FALSE_FUNDAMENTAL, 2 * (part - 1) * len(variance))
        if more > max(level, _LEAST_FUNDAMENTAL * float((alone / variance).sum())):
            return turn / part
    return turn


def _centred(window: Window, turn: float, variance: FloatArray) -> float:
    """Turn of the largest explained power near a bin."""
    step = np.pi / 8
    for _ in range(3):
        powers = [
            float((tabulate(window, turn + d, 1).explained() / variance).sum()) for d in (-step, 0, step)
        ]
        bend = powers[0] - 2 * powers[1] + powers[2]
        if bend < 0:
            turn += float(np.clip(0.5 * (powers[0] - powers[2]) / bend, -1, 1)) * step
        step /= 4
    return turn


def _harmonics(window: Window, turn: float, params: WaveParams) -> int:
    """The highest harmonic that is seen."""
    highest = min(params.max_harmonics, int(2 * np.pi * _ALIASED / (turn * window.largest_step)))
    if highest < 2:
        return 1
    tables = tabulate(window, turn, highest)
    rest = (window.volts**2).sum(axis=1) - tables.explained()
    variance = np.maximum(rest / (window.n - window.trend.shape[1] - 2 * highest), LEAST_VARIANCE)
    information = np.linalg.inv(tables.gram[:, : 2 * highest, : 2 * highest])
    parts = tables.phasors()
    level = stats.chi2.isf(_FALSE_FUNDAMENTAL, 2 * len(parts))
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        own = np.linalg.solve(information[:, pair, pair], parts[:, pair, np.newaxis])[..., 0]
        if float(((own * parts[:, pair]).sum(axis=1) / variance).sum()) > level:
            return h
    return 1


def _refined(
    window: Window, layout: Layout, motion: WaveMotion, params: WaveParams, start: Waves
) -> tuple[Waves, Tables, FloatArray, FloatArray]:
    """The best wave with the harmonics that are seen; its tables; noise of channels, strays of kinds."""
    best = start
    n_harmonics = _harmonics(window, float(best.turn[0]), params)
    stray = np.zeros((len(np.unique(layout.kind)), n_harmonics))
    for _ in range(_REFINEMENTS):
        tables = tabulate(window, float(best.turn[0]), n_harmonics)
        used = window.trend.shape[1] + 2 * n_harmonics
        rest = (window.volts**2).sum(axis=1) - tables.explained()
        variance = np.maximum(rest / (window.n - used), LEAST_VARIANCE)
        solver = Solver(window, layout, motion, variance, stray)
        best = solver.solve(tables, best.k, best.turn, steps=3)
        stray = solver.stray_of(tables, best)
    return best, tables, variance, stray


def _candidates(found: Waves, weights: FloatArray, shown: list[int]) -> tuple[Candidate, ...]:
    return tuple(
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(weights[i]))
        for i in shown
        for period_mm, angle_deg in [_reading(found.k[i])]
    )


def _reading(k: FloatArray) -> tuple[float, float]:
    """Period and angle (within -90..90) of a wave vector."""
    angle = np.arctan2(k[1], k[0])
    angle -= np.pi * np.round(angle / np.pi)
    return float(2 * np.pi / np.hypot(k[0], k[1])), float(np.degrees(angle))


def _answer(fit: WaveFit, best: Waves, window: Window, motion: WaveMotion, n_harmonics: int) -> WaveFit:
    k, turn = best.k[0], float(best.turn[0])
    size = float(np.hypot(k[0], k[1]))
    period_mm, angle_deg = _reading(k)
    # Rows: period, angle, speed; columns: kx, ky, turn.
    slope = np.zeros((3, 3))
    slope[0, :2] = -period_mm * k / size**2
    slope[1, :2] = -k[1] / size**2, k[0] / size**2
    speed_mm_s = motion.speed_mm_s if motion.has_speed else 0.0
    if motion.has_direction and not motion.has_speed:
        along = float(k @ motion.heading)
        speed_mm_s = turn / window.half_way / along
        slope[2, :2] = -speed_mm_s * motion.heading / along
        slope[2, 2] = speed_mm_s / turn
    covariance = slope @ best.covariance[0] @ slope.T
    if motion.has_speed:
        covariance[2, 2] = motion.speed_sd_mm_s**2
    return replace(
        fit,
        period_mm=period_mm,
        angle_deg=angle_deg,
        speed_mm_s=speed_mm_s,
        covariance=covariance,
        n_harmonics=n_harmonics,
    )

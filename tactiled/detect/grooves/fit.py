"""Joint maximum-likelihood fit of a plane wave to all channels in one window of scans.

The steps: find the line in the pooled spectrum (`spectrum`); list every wave vector that its phases allow
(`search`); climb to the maximum from the best, with all harmonics (`solve`, `refine`); weigh the best
against the others (`ambiguity`) and against two waves of one frequency (`second_wave`); state the
covariance from the Fisher information. `model` defines the wave.

Each window is fitted without knowledge of earlier ones, so that a competing reading that has since become as
likely is found. Between fits, `track` follows the answer.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.ambiguity import (
    assess_ambiguity,
    contradicts_motion,
    has_baseline,
    weigh_readings,
)
from tactiled.detect.grooves.linear import PlaneWaves
from tactiled.detect.grooves.model import (
    ALIASED,
    SAME_WAVE_RAD,
    ChannelLayout,
    TrackedWave,
    WaveFit,
    WaveMotion,
    WaveParams,
    period_and_angle,
    wave_vector,
)
from tactiled.detect.grooves.refine import RefinedWave, refine, variance_inflation
from tactiled.detect.grooves.search import channel_phasors, common_mode_power, search_wave_vectors
from tactiled.detect.grooves.second_wave import has_second_wave
from tactiled.detect.grooves.solve import WaveSolver
from tactiled.detect.grooves.spectrum import RippleHypothesis, foreign_lines, strongest_line
from tactiled.detect.grooves.window import (
    MOST_BAD_PART,
    STRAIGHT,
    DetrendedWindow,
    filled,
    make_window,
    normal_equations,
)

# No converter reads more. Fourth powers of it, and of its noise, are finite numbers.
_MOST_VOLTS = 1e9
# Variance, radians^2. With more, what suits no wave suits its mirror image no better.
_MOST_ALIASED_MISMATCH = 0.2
# Phase rate to either side of a line that is no wave, which is rarely a narrow line either.
_BROAD_LINE = 0.25 * np.pi
# Phase rate. Strong lines are known far better than to a quarter of a bin.
_SAME_LINE = 0.25 * np.pi
# Lines tried: hum and the like may be stronger than the grooves.
_MOST_LINES = 3
_WAVES = ("ok", "ambiguous", "uneven-channels")
# Harmonics of one grating, none of which is a second grating.
_MOST_OWN_HARMONICS = 8
# Part of a grating's power. A weaker second one may be what the model does not describe of the first.
_LEAST_SECOND_PART = 0.01
# Phase rate of a wave, and the multiples of it that are its harmonics.
Line = tuple[float, list[int]]


def fit_wave(
    volts: FloatArray,
    time_s: FloatArray,
    channel_offset_s: FloatArray,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    usable: NDArray[np.bool_] | None = None,
    speeds_mm_s: FloatArray | None = None,
) -> WaveFit:
    """Fit one window.

    Parameters
    ----------
    volts : (n, channels) float64
    time_s : (n,) float64
        Instants at which scans began, evenly spaced or nearly so.
    channel_offset_s : (channels,) float64
        Delay from the beginning of a scan to the sampling of each channel.
    usable : (n, channels) bool
        False for readings to ignore; by default those that are not finite.
    speeds_mm_s : (n,) float64, optional
        Speed from each scan to the next where it is known and not constant; `motion` then holds the mean.

    Examples
    --------
    Grooves of 1.2 mm at 20 degrees, skin moving along +x at 2 mm/s, two seconds at 100 Hz:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.detect.grooves.model import WaveMotion, WaveParams, channel_layout
    >>> layout = channel_layout(load_array("wang2019-3x3"))
    >>> rng, time_s, angle = np.random.default_rng(0), np.arange(200) / 100, np.radians(20)
    >>> x_mm = layout.x_mm + 2 * time_s[:, np.newaxis]
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + layout.y_mm * np.sin(angle))
    >>> volts = 1 + 0.05 * np.cos(phase + layout.kind) + 0.005 * rng.standard_normal(phase.shape)
    >>> motion = WaveMotion(speed_mm_s=2.0, direction_deg=0.0, direction_sd_deg=0.0)
    >>> fit = fit_wave(volts, time_s, np.zeros(36), layout, motion, WaveParams())
    >>> print(f"{fit.status}: {fit.period_mm:.3f} mm, {fit.angle_deg:.1f} degrees")
    ok: 1.200 mm, 20.0 degrees
    """
    prepared = prepare_window(volts, time_s, channel_offset_s, layout, motion, params, usable, speeds_mm_s)
    return prepared if isinstance(prepared, WaveFit) else _fit(*prepared, motion, params)


def prepare_window(
    volts: FloatArray,
    time_s: FloatArray,
    channel_offset_s: FloatArray,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
    usable: NDArray[np.bool_] | None = None,
    speeds_mm_s: FloatArray | None = None,
    trend_order: int = STRAIGHT,
) -> tuple[DetrendedWindow, ChannelLayout] | WaveFit:
    """The window of `fit_wave` and the layout of its usable channels about their centre; or a refusal."""
    sane = np.abs(volts) <= _MOST_VOLTS
    usable = sane if usable is None else usable & sane
    chosen = np.flatnonzero(usable.mean(axis=0) >= 1 - MOST_BAD_PART)
    n = len(volts)
    if n <= params.trend_order + 4 * params.max_harmonics + 1:
        return WaveFit("too-few-periods")
    if not len(chosen):
        return WaveFit("saturated")
    readings = filled(volts[:, chosen], usable[:, chosen])
    x_mm, y_mm = layout.x_mm[chosen], layout.y_mm[chosen]
    centre = (x_mm.min() + x_mm.max()) / 2, (y_mm.min() + y_mm.max()) / 2
    here = ChannelLayout(x_mm - centre[0], y_mm - centre[1], layout.kind[chosen])
    rate = np.full(n, motion.speed_mm_s if motion.has_speed else 1.0)
    if speeds_mm_s is not None and motion.has_speed:
        rate = speeds_mm_s
    return make_window(readings, time_s, rate, channel_offset_s[chosen], trend_order), here


def _fit(window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, params: WaveParams) -> WaveFit:
    """Fit the strongest wave; refuse where what it leaves holds another one."""
    first, line = _strongest_wave(window, layout, motion, params)
    if line is None or first.status not in _WAVES:
        return first
    # Evidence against the given speed from the first wave holds for the second one, too.
    motion = motion.without_speed if first.status == "ok" and not first.uses_given_speed else motion
    least = _LEAST_SECOND_PART * _line_power(window, line[0])
    second, other = _strongest_wave(window.without_lines(*line), layout, motion, params, least)
    if other is None or second.status != "ok":
        return first
    # The first without the second, which was noise to it.
    alone, _ = _strongest_wave(window.without_lines(*other), layout, motion, params)
    if alone.status == "ok" and _are_alike(alone, second, layout):
        return alone  # an uneven speed makes side bands, which are the same grating at other frequencies
    return WaveFit("several-gratings", first.frequency_hz, first.snr_db)


def _are_alike(one: WaveFit, other: WaveFit, layout: ChannelLayout) -> bool:
    """True where two answers cannot be told apart on the array."""
    apart = wave_vector(one.period_mm, one.angle_deg) - wave_vector(other.period_mm, other.angle_deg)
    return bool(np.abs(apart).max() * layout.radius_mm <= SAME_WAVE_RAD)


def _line_power(window: DetrendedWindow, phase_rate: float) -> float:
    """Power of a line, volts^2 summed over channels and scans."""
    return float(normal_equations(window, phase_rate, 1).explained().sum())


def _strongest_wave(
    window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, params: WaveParams, least: float = 0.0
) -> tuple[WaveFit, Line | None]:
    """Fit the strongest line that is a wave and has some power; remove stronger lines that are no waves."""
    if float(window.power.sum()) < least:  # no line has more than the total power
        return WaveFit("low-snr"), None
    removed: list[float] = []
    for _ in range(_MOST_LINES):
        readings = strongest_line(window, params)
        if not readings or max(_line_power(each.window, each.phase_rate) for each in readings) < least:
            return WaveFit("low-snr"), None
        for line in readings:
            if line.periods < params.min_periods:
                return WaveFit("too-few-periods", window.frequency_hz(line.phase_rate)), None
            found = _wave(line, layout, motion, params)
            if found is not None and found[0].status == "ok" and _is_multiple(line.phase_rate, removed):
                return WaveFit("ambiguous", found[0].frequency_hz), found[1]
            if found is not None:
                return found
        phase_rate = next(each.phase_rate for each in readings if each.is_line)
        removed.append(phase_rate)
        window = window.without_lines(
            phase_rate, [1 - _BROAD_LINE / phase_rate, 1 + _BROAD_LINE / phase_rate]
        )
    return WaveFit("low-snr"), None


def _is_multiple(phase_rate: float, removed: list[float]) -> bool:
    """True where a line may be a harmonic of a removed one."""
    times = [max(round(phase_rate / other), 2) for other in removed]
    return any(abs(phase_rate - n * other) < _SAME_LINE for n, other in zip(times, removed, strict=True))


def _wave(
    ripple: RippleHypothesis, layout: ChannelLayout, motion: WaveMotion, params: WaveParams
) -> tuple[WaveFit, Line] | None:
    """Fit the wave of a line, directly or as the mirror image of an undersampled ripple; or None."""
    window, phase_rate = ripple.window, ripple.phase_rate
    if not has_baseline(layout, motion):
        return WaveFit("ambiguous", window.frequency_hz(phase_rate)), (phase_rate, [1])
    best, found = _best_reading(ripple, layout, motion, params)
    suits_motion = best is not None and best.is_wave and not (motion.has_speed and best.mismatch.any())
    if ripple.is_line and not suits_motion:
        least = found.gain[0] if best is not None and best.is_wave else -np.inf
        image = _mirror_image(ripple, layout, motion, params, least)
        if image is not None:
            return image, (phase_rate, [1])
    if best is not None and best.is_wave:
        return _judged(ripple, best, found, layout, motion, params)
    if motion.has_speed and has_baseline(layout, motion.without_speed):
        return _wave(ripple, layout, motion.without_speed, params)
    return None


def _best_reading(
    ripple: RippleHypothesis, layout: ChannelLayout, motion: WaveMotion, params: WaveParams
) -> tuple[RefinedWave | None, PlaneWaves]:
    """The best wave of a line, if any, and all that its phases allow, the best first."""
    window = ripple.window
    equations = normal_equations(window, ripple.phase_rate, 1)
    least = common_mode_power(window, equations, layout, ripple.variance)
    found = search_wave_vectors(window, equations, layout, motion, params, ripple.variance, least)
    if not len(found.k):
        return None, found
    best = refine(window, layout, motion, params, found[0])
    if best.mismatch.any():
        # Strays of channels may have made another reading the best.
        weights = weigh_readings(best, found, window, layout, motion, params).weights
        if weights.argmax():
            found = found[np.argsort(-weights, kind="stable")]
            best = refine(window, layout, motion, params, found[0])
    return best, found


def _mirror_image(
    ripple: RippleHypothesis, layout: ChannelLayout, motion: WaveMotion, params: WaveParams, least_gain: float
) -> WaveFit | None:
    """The refusal of an undersampled ripple, whose image suits the phases of a line better; or None.

    Such a ripple appears at a lower frequency, where its phases suit no wave well.
    """
    window, phase_rate, variance = ripple.window, ripple.phase_rate, ripple.variance
    least = common_mode_power(window, normal_equations(window, phase_rate, 1), layout, variance)
    whole_phase_rate = 2 * np.pi / window.largest_step
    for fast in (whole_phase_rate - phase_rate, whole_phase_rate + phase_rate):
        equations = normal_equations(window, fast, 1)
        found = search_wave_vectors(window, equations, layout, motion, params, variance, least)
        if len(found.k) and found.gain[0] > least_gain:
            image = refine(window, layout, motion, params, found[0])
            if image.is_wave and image.fundamental_mismatch.mean() < _MOST_ALIASED_MISMATCH:
                hz = window.frequency_hz(float(image.waves.phase_rate[0]))
                return WaveFit("aliased", hz, image.snr_db)
    return None


def _judged(
    ripple: RippleHypothesis,
    best: RefinedWave,
    found: PlaneWaves,
    layout: ChannelLayout,
    motion: WaveMotion,
    params: WaveParams,
) -> tuple[WaveFit, Line]:
    """The answer that a wave gives, or the refusal where another reading or a second wave is likely."""
    window = ripple.window
    line = _own_lines(window, layout, motion, params, best)
    refused = WaveFit("aliased", window.frequency_hz(line[0]), best.snr_db)
    if line[0] * window.largest_step > 2 * np.pi * ALIASED:
        return refused, line
    stated, noise_inflation = with_estimates(replace(refused, status="ok"), best, window, layout, motion)
    fit = assess_ambiguity(stated, noise_inflation, best, found, window, layout, motion, params)
    z, variance = channel_phasors(window, best.equations, 1), 2 * best.variance * noise_inflation / window.n
    k, are_alike = best.waves.k[0], not best.mismatch.any()
    if has_second_wave(z, variance, layout, motion, params, k, are_alike):
        return replace(refused, status="several-gratings"), line
    if fit.status != "ok":
        if contradicts_motion(best, found, window, layout, motion, params):
            loose = _wave(ripple, layout, motion.without_speed, params)
            if loose is not None and loose[0].status == "ok":
                return loose
        return fit, line
    if window.removed or stated.wave is None:
        return replace(fit, wave=None), line
    return replace(fit, wave=replace(stated.wave, added=fit.covariance - stated.covariance)), line


def _own_lines(
    window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion, params: WaveParams, best: RefinedWave
) -> Line:
    """List the lines of a wave, including those too weak for the fit."""
    phase_rate = float(best.waves.phase_rate[0])
    n_most = int(np.clip(np.pi / phase_rate / window.largest_step, 1, _MOST_OWN_HARMONICS))
    n_most = next((h - 1 for h in range(2, n_most + 1) if window.is_removed(h * phase_rate)), n_most)
    equations = normal_equations(window, phase_rate, n_most)
    foreign = foreign_lines(window, layout, motion, params, best.waves, equations, best.variance)
    return phase_rate, [
        h for h in range(1, n_most + 1) if h not in foreign or h <= best.equations.n_harmonics
    ]


def with_estimates(
    fit: WaveFit, best: RefinedWave, window: DetrendedWindow, layout: ChannelLayout, motion: WaveMotion
) -> tuple[WaveFit, float]:
    """Add period, angle, speed, their covariance and, as `wave`, what is needed to track them.

    Also returned is the factor by which coloured noise near the line widens the largest variance.
    """
    slope = estimate_slope(best, window, motion)
    solver = WaveSolver(window, layout, motion, best.variance, best.mismatch)
    by_noise, by_mismatch = variance_inflation(window, layout, solver, best, slope)
    wave = TrackedWave(
        best.waves.k[0],
        float(best.waves.phase_rate[0]) / window.half_travel,
        best.mismatch,
        np.sqrt(np.maximum(by_noise, by_mismatch)),
        np.zeros((3, 3)),
    )
    return with_wave(replace(fit, wave=wave), best, window, motion), float(by_noise.max())


def estimate_slope(best: RefinedWave, window: DetrendedWindow, motion: WaveMotion) -> FloatArray:
    """Derivative of period, angle (radians) and speed by kx, ky and phase rate: (3, 3)."""
    k, phase_rate = best.waves.k[0], float(best.waves.phase_rate[0])
    size = float(np.hypot(k[0], k[1]))
    slope = np.zeros((3, 3))
    slope[0, :2] = -period_and_angle(k)[0] * k / size**2
    slope[1, :2] = -k[1] / size**2, k[0] / size**2
    along = float(k @ motion.heading)
    if motion.has_direction and not motion.has_speed:
        speed_mm_s = 2 * np.pi * window.frequency_hz(phase_rate) / along
        slope[2, :2] = -speed_mm_s * motion.heading / along
        slope[2, 2] = speed_mm_s / phase_rate
    return slope


def with_wave(fit: WaveFit, best: RefinedWave, window: DetrendedWindow, motion: WaveMotion) -> WaveFit:
    """Add period, angle, speed and their covariance, which `fit.wave` widens."""
    assert fit.wave is not None
    k, phase_rate = best.waves.k[0], float(best.waves.phase_rate[0])
    period_mm, angle_deg = period_and_angle(k)
    slope = estimate_slope(best, window, motion)
    covariance = slope @ best.waves.covariance[0] @ slope.T * np.outer(fit.wave.scale, fit.wave.scale)
    speed_mm_s = motion.speed_mm_s if motion.has_speed else 0.0
    if motion.has_speed:
        covariance[2, 2] = motion.speed_sd_mm_s**2
    elif motion.has_direction:
        along = float(k @ motion.heading)
        speed_mm_s = 2 * np.pi * window.frequency_hz(phase_rate) / along
        turned = float(k[1] * motion.heading[0] - k[0] * motion.heading[1]) / along
        covariance[2, 2] += (speed_mm_s * turned * np.radians(motion.direction_sd_deg)) ** 2
    return replace(
        fit,
        period_mm=period_mm,
        angle_deg=angle_deg,
        speed_mm_s=speed_mm_s,
        covariance=covariance + fit.wave.added,
        uses_given_speed=motion.has_speed,
    )

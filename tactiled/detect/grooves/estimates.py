"""Period, angle and speed of a refined wave, with their covariance.

The covariance is that of the Fisher information, which assumes white noise that is independent between
channels. Of coloured noise only the part near a line's frequency matters (Grenander, Szego 1958). The
residual of the fit at frequencies beside the line is therefore shifted onto the line, some places to either
side, and the displacement of the answer is computed for each. That accounts for a raised noise floor and for
the side bands of an uneven speed, also where all channels share them.

Where phases deviate within kinds, the channels of one taxel may deviate together. Each taxel's contribution
to the answer is then one sample of the scatter between taxels (cluster-robust variance: Liang, Zeger 1986).
"""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import TINY, ChannelLayout, period_and_angle
from tactiled.detect.grooves.outcome import GrooveAnswer, TrackedWave
from tactiled.detect.grooves.refine import RefinedWave
from tactiled.detect.grooves.solve import WaveSolver, expected_products
from tactiled.detect.grooves.window import CLEAR_CYCLES

# choice: frequencies beside the line: fewer are a poor estimate, more are far from it.
_PLACES = 8
# derived: periods of the window, less rounding. Closer to a line the fit has absorbed the noise.
_NEAREST = 1.0 - 1e-9
# choice: probability that white noise passes as more than white. The covariance is then too wide by the
# factor found.
_FALSE_INFLATION = 0.01
# derived: tail probability at two standard deviations, at which intervals of few degrees of freedom are
# matched.
_TAIL = 0.025
# derived: degrees of freedom that wave vector and phase take. The scatter of a few taxels is too small by
# that.
_SPENT_TAXELS = 3


def groove_answer(
    best: RefinedWave, scale: FloatArray, added: FloatArray, error_probability: float, stray_rad: float
) -> GrooveAnswer:
    """Answer that a wave gives; `scale` and `added` are those of `TrackedWave`."""
    window, k = best.window, best.k
    motion, speed_mm_s, slope = window.motion, _speed_mm_s(best), _slope(best)
    covariance = slope @ best.waves.covariance[0] @ slope.T * np.outer(scale, scale)
    if motion.has_speed:
        covariance[2, 2] = motion.speed_sd_mm_s**2
    elif motion.has_direction:
        turned = float(k @ motion.across) / float(k @ motion.heading)
        covariance[2, 2] += (speed_mm_s * turned * np.radians(motion.direction_sd_deg)) ** 2
    period_mm, angle_deg = period_and_angle(k)
    return GrooveAnswer(
        frequency_hz=best.frequency_hz,
        snr_db=best.snr_db,
        period_mm=period_mm,
        angle_deg=angle_deg,
        speed_mm_s=speed_mm_s,
        covariance=covariance + added,
        uses_given_speed=motion.has_speed,
        error_probability=error_probability,
        stray_rad=stray_rad,
        wave=TrackedWave(k, best.phase_rate / window.half_travel, best.mismatch, scale, added),
    )


def _speed_mm_s(best: RefinedWave) -> float:
    """Given speed, or that of the wave along a known direction; else 0."""
    motion = best.window.motion
    if motion.has_speed or not motion.has_direction:
        return motion.speed_mm_s * motion.has_speed
    return 2 * np.pi * best.frequency_hz / float(best.k @ motion.heading)


def _slope(best: RefinedWave) -> FloatArray:
    """Derivative of period, angle (radians) and speed by kx, ky and phase rate: (3, 3)."""
    k, motion = best.k, best.window.motion
    size = float(np.hypot(k[0], k[1]))
    slope = np.zeros((3, 3))
    slope[0, :2] = -period_and_angle(k)[0] * k / size**2
    slope[1, :2] = -k[1] / size**2, k[0] / size**2
    if motion.has_direction and not motion.has_speed:
        slope[2, :2] = -_speed_mm_s(best) * motion.heading / float(k @ motion.heading)
        slope[2, 2] = _speed_mm_s(best) / best.phase_rate
    return slope


def disagreement(best: RefinedWave, other: FloatArray) -> FloatArray:
    """Square of the difference to another estimate of the wave vector, as a covariance: (3, 3).

    It is added to the stated one where two models of strays give different answers.
    """
    motion, here, there = best.window.motion, period_and_angle(best.k), period_and_angle(other)
    turned = (np.radians(there[1] - here[1]) + np.pi / 2) % np.pi - np.pi / 2
    along = float(best.k @ motion.heading), float(other @ motion.heading)
    faster = _speed_mm_s(best) * (along[0] / along[1] - 1) if not motion.has_speed and along[1] else 0.0
    off = np.array([there[0] - here[0], turned, faster])
    return np.outer(off, off)


def inflation(best: RefinedWave) -> tuple[FloatArray, float]:
    """Factors (3,) of the sds of period, angle and speed, and the largest factor of a variance by noise."""
    slope = _slope(best)
    layout, solver = best.window.layout, WaveSolver(best.window, best.variance, best.mismatch)
    stated = np.maximum(np.einsum("ai,ij,aj->a", slope, best.waves.covariance[0], slope), 1e-200)
    by_noise, by_mismatch = np.ones(len(slope)), np.ones(len(slope))
    noise = _noise_beside(best)
    if len(noise):
        m = 2 * best.equations.n_harmonics
        white = np.linalg.solve(best.equations.gram[:, :m, :m], noise[..., :m, np.newaxis])[..., 0]
        floor = float(((white * noise[..., :m]).sum(axis=-1) / best.variance).mean()) / m
        by_noise = np.maximum(by_noise, _more_than_white(np.array(floor), m * noise[..., 0].size))
        moved = ((solver.displacements(best.equations, best.waves, noise) @ slope.T) ** 2).mean(axis=0)
        by_noise = np.maximum(by_noise, _more_than_white(moved / stated, len(noise)))
    n_taxels = len(layout.places_mm)
    if best.mismatch.any() and n_taxels > _SPENT_TAXELS:
        is_taxel = layout.taxel == np.arange(n_taxels)[:, np.newaxis]
        residual = best.equations.product - expected_products(best.equations, best.waves)[0]
        parts = is_taxel[..., np.newaxis] * residual
        moved = ((solver.displacements(best.equations, best.waves, parts) @ slope.T) ** 2).sum(axis=0)
        left = n_taxels - _SPENT_TAXELS
        effect, dof = design_effect(solver.standardised_mismatch(best.equations, best.waves), layout)
        by_mismatch = np.maximum(
            moved * n_taxels / left / stated * _small_sample_factor(left), effect * _small_sample_factor(dof)
        )
    return np.sqrt(np.maximum(by_noise, by_mismatch)), float(by_noise.max())


def _small_sample_factor(dof: float) -> float:
    """Widening that gives a variance from few degrees of freedom the usual coverage at two sigma."""
    return (special.stdtrit(dof, _TAIL) / special.ndtri(_TAIL)) ** 2


def design_effect(mismatches: FloatArray, layout: ChannelLayout) -> tuple[float, float]:
    """Design effect (Kish 1965) of channels that deviate together within taxels, and its degrees of freedom.

    The ratio of the variance of the taxels' sums to that of as many independent channels. Mismatches
    (channels,) are in standard deviations.
    """
    n_taxels, n_channels = len(layout.places_mm), len(mismatches)
    sums, sizes = np.bincount(layout.taxel, mismatches), np.bincount(layout.taxel)
    left = max(n_taxels - _SPENT_TAXELS, 1)
    left_channels = max(n_channels - layout.is_kind.shape[1] - 2, 1)
    effect = (sums**2 / sizes).sum() / left / max((mismatches**2).sum() / left_channels, TINY)
    effect = float(np.clip(effect, 1.0, n_channels / n_taxels))
    return effect, max(left_channels / effect, 1.0)


def _more_than_white(ratio: FloatArray, dof: int) -> FloatArray:
    """The ratio where white noise would rarely reach it, else 1."""
    return np.where(ratio > special.chdtri(dof, _FALSE_INFLATION) / dof, ratio, 1.0)


def _noise_beside(best: RefinedWave) -> FloatArray:
    """Noise at frequencies beside the line as products of the equations: (samples, channels, functions)."""
    window, phase_rate, n_harmonics = best.window, best.phase_rate, best.equations.n_harmonics
    left = window.without_lines(phase_rate, range(1, n_harmonics + 1))
    cycles = phase_rate / np.pi
    away = np.arange(-2 * _PLACES, 2 * _PLACES + 1)
    there = cycles + away
    multiple = np.round(there / cycles) * cycles
    clear = np.abs(there - multiple) >= np.minimum(_NEAREST, cycles / 2)
    clear |= multiple > n_harmonics * cycles + 0.5
    fits = (np.abs(away) >= _NEAREST) & (there > CLEAR_CYCLES) & (there < 0.5 * window.n - 1) & clear
    away = away[fits][np.argsort(np.abs(away[fits]), kind="stable")][:_PLACES]
    travel = window.travel.mean(axis=0)
    waves = [
        np.exp(-1j * np.outer(travel, h * phase_rate + np.pi * away)) for h in range(1, n_harmonics + 1)
    ]  # (n, places)
    parts = []
    for weighted in (*waves, *(wave * travel[:, np.newaxis] for wave in waves)):
        shifted = left.volts @ weighted
        # A line of any phase: the cosine, and the sine a quarter of a period later.
        z = np.concatenate([shifted, 1j * shifted], axis=1)
        parts += [z.real, -z.imag]
    return np.stack(parts, axis=-1).swapaxes(0, 1)

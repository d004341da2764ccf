"""Period, angle and speed of a refined wave, with their covariance.

The covariance is that of the Fisher information, which assumes white noise that is independent between
channels. Of coloured noise only the part near a line's frequency matters (Grenander, Szego 1958). The
residual of the fit at frequencies beside the line is therefore shifted onto the line, some places to either
side, and the displacement of the answer is computed for each. That accounts for a raised noise floor and for
the side bands of an uneven speed, also where all channels share them.

Where phases of a kind differ by more than noise, strays limit the accuracy, and the wave is that of the
posterior in which they are integrated out (`ambiguity`).
"""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.ambiguity import StrayPosterior, with_strays
from tactiled.detect.grooves.model import FALSE_DOUBT, TINY, period_and_angle
from tactiled.detect.grooves.outcome import GrooveAnswer, TrackedWave
from tactiled.detect.grooves.refine import RefinedWave
from tactiled.detect.grooves.solve import WaveSolver
from tactiled.detect.grooves.window import CLEAR_CYCLES

# choice: frequencies beside the line: fewer are a poor estimate, more are far from it.
_PLACES = 8
# derived: periods of the window, less rounding. Closer to a line the fit has absorbed the noise.
_NEAREST = 1.0 - 1e-9


def groove_answer(
    best: RefinedWave,
    posterior: StrayPosterior,
    scale: FloatArray,
    noise_inflation: float,
    error_probability: float,
) -> GrooveAnswer:
    """Answer that a wave gives; `scale` and `noise_inflation` are those of `TrackedWave`."""
    window, motion, slope = best.window, best.window.motion, _slope(best)
    covariance = slope @ best.waves.covariance[0] @ slope.T * np.outer(scale, scale)
    wave = TrackedWave(
        k=best.k,
        phase_per_travel=best.phase_rate / window.half_travel,
        n_harmonics=best.equations.n_harmonics,
        scale=scale,
        noise_inflation=noise_inflation,
    )
    if best.is_uneven:
        best = with_strays(best, posterior, noise_inflation)
        by_noise, covariance = covariance, slope @ best.waves.covariance[0] @ slope.T
        wider = np.sqrt(np.maximum(np.diag(by_noise) / np.maximum(np.diag(covariance), TINY), 1.0))
        covariance = covariance * np.outer(wider, wider)
    k, speed_mm_s = best.k, _speed_mm_s(best)
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
        covariance=covariance,
        uses_given_speed=motion.has_speed,
        error_probability=error_probability,
        stray_rad=posterior.stray_rad,
        wave=wave,
    )


def _speed_mm_s(best: RefinedWave) -> float:
    """Given speed, or that of the wave along a known direction; else 0."""
    motion = best.window.motion
    if motion.has_speed or not motion.has_direction:
        return motion.speed_mm_s if motion.has_speed else 0.0
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


def inflation(best: RefinedWave) -> tuple[FloatArray, float]:
    """Factors (3,) by which noise widens the sds of period, angle and speed; the largest of the variances."""
    noise = _noise_beside(best)
    if not len(noise):
        return np.ones(3), 1.0
    slope, m = _slope(best), 2 * best.equations.n_harmonics
    stated = np.maximum(np.einsum("ai,ij,aj->a", slope, best.waves.covariance[0], slope), 1e-200)
    white = np.linalg.solve(best.equations.gram[:, :m, :m], noise[..., :m, np.newaxis])[..., 0]
    floor = float(((white * noise[..., :m]).sum(axis=-1) / best.variance).mean()) / m
    moved = WaveSolver(best.window, best.variance).displacements(best.equations, best.waves, noise)
    by_noise = np.maximum(
        _more_than_white(np.array(floor), m * noise[..., 0].size),
        _more_than_white(((moved @ slope.T) ** 2).mean(axis=0) / stated, len(noise)),
    )
    return np.sqrt(by_noise), float(by_noise.max())


def _more_than_white(ratio: FloatArray, dof: int) -> FloatArray:
    """The ratio where white noise would rarely reach it, else 1."""
    return np.where(ratio > special.chdtri(dof, FALSE_DOUBT) / dof, ratio, 1.0)


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
    fits = (away != 0) & (there > CLEAR_CYCLES) & (there < 0.5 * window.n - 1) & clear
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

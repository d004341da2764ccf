"""Period, angle and speed of a wave, with their covariance."""

from dataclasses import replace

import numpy as np

from tactiled.detect.grooves.basis import Window
from tactiled.detect.grooves.model import Layout, WaveFit, WaveMotion
from tactiled.detect.grooves.noise import inflation
from tactiled.detect.grooves.refine import Refined
from tactiled.detect.grooves.solve import Solver
from tactiled.detect.grooves.weigh import reading


def answer(fit: WaveFit, best: Refined, window: Window, layout: Layout, motion: WaveMotion) -> WaveFit:
    """The fit with what a wave says of its grating."""
    k, turn = best.waves.k[0], float(best.waves.turn[0])
    size = float(np.hypot(k[0], k[1]))
    period_mm, angle_deg = reading(k)
    # Rows: period, angle, speed; columns: kx, ky, turn.
    slope = np.zeros((3, 3))
    slope[0, :2] = -period_mm * k / size**2
    slope[1, :2] = -k[1] / size**2, k[0] / size**2
    speed_mm_s = motion.speed_mm_s if motion.has_speed else 0.0
    along = float(k @ motion.heading)
    if motion.has_direction and not motion.has_speed:
        speed_mm_s = turn / window.half_way / along
        slope[2, :2] = -speed_mm_s * motion.heading / along
        slope[2, 2] = speed_mm_s / turn
    solver = Solver(window, layout, motion, best.variance, best.stray)
    colour, strayed = inflation(window, layout, solver, best, slope)
    scale = np.sqrt(np.maximum(colour, strayed))
    covariance = slope @ best.waves.covariance[0] @ slope.T * np.outer(scale, scale)
    if motion.has_speed:
        covariance[2, 2] = motion.speed_sd_mm_s**2
    elif motion.has_direction:
        turned = float(k[1] * motion.heading[0] - k[0] * motion.heading[1]) / along
        covariance[2, 2] += (speed_mm_s * turned * np.radians(motion.direction_sd_deg)) ** 2
    return replace(
        fit,
        period_mm=period_mm,
        angle_deg=angle_deg,
        speed_mm_s=speed_mm_s,
        covariance=covariance,
        n_harmonics=best.tables.n_harmonics,
        is_tied=motion.has_speed,
        colour=float(colour.max()),
    )

"""Refine the best wave of a line: climb to the maximum, with its harmonics."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ALIASED, FALSE_ALARM
from tactiled.detect.grooves.search import explained_power
from tactiled.detect.grooves.solve import PlaneWaves, WaveSolver
from tactiled.detect.grooves.window import DetrendedWindow, NormalEquations

# choice: iterations at most; the frequency of each is that of the one before.
_REFINEMENTS = 4
# choice: radians, and radians per millimetre.
_CONVERGED_RAD = 1e-5
# derived: change of the phase rate from the start. Normal equations do not describe more than a period of the
# window.
_LARGEST_PHASE_RATE_MOVE = np.pi
# prior: part of a line's power, as the channels' own fits explain it. A wave that leaves more does not
# explain the line.
_MOST_UNEXPLAINED_PART = 0.4


def visible_harmonics(window: DetrendedWindow, phase_rate: float) -> int:
    """Number of the highest harmonic that exceeds the noise."""
    sampled = int(2 * np.pi * ALIASED / (phase_rate * window.largest_step))
    highest = window.clear_harmonics(phase_rate, min(window.params.max_harmonics, sampled))
    if highest < 2:
        return 1
    equations = window.equations(phase_rate, highest)
    information = np.linalg.inv(equations.gram[:, : 2 * highest, : 2 * highest])
    level = special.chdtri(2 * len(equations.parts), FALSE_ALARM)
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        parts = equations.parts[:, pair]
        own = np.linalg.solve(information[:, pair, pair], parts[..., np.newaxis])[..., 0]
        if float(((own * parts).sum(axis=1) / equations.variance).sum()) > level:
            return h
    return 1


def foreign_lines(waves: PlaneWaves, equations: NormalEquations, variance: FloatArray) -> list[int]:
    """Multiples of a wave's frequency that are not harmonics of this wave; 1 is the fundamental.

    The phases of a harmonic advance h times as fast across the array as those of the fundamental. The phases
    of noise, or of another grating whose ripple happens to be at a multiple, do not. Strays of channels, too,
    cause a misfit, but a smaller one.

    The equations have the lines in question.
    """
    window = equations.window
    power = window.n / 2  # power of a line of amplitude 1
    level = special.chdtri(len(variance), FALSE_ALARM)
    foreign = []
    for h in range(1, equations.n_harmonics + 1):
        z = equations.phasors(h)
        free = power * float((np.abs(z) ** 2 / variance).sum())
        untied = free - power * explained_power(z, window.layout, h * waves.k[0], variance)
        if untied >= max(level, _MOST_UNEXPLAINED_PART * free):
            foreign.append(h)
    return foreign


@dataclass(frozen=True, eq=False)
class RefinedWave:
    """The best wave of a line."""

    waves: PlaneWaves  # one wave
    equations: NormalEquations  # at its frequency, with its harmonics
    is_uneven: bool  # True where the phases of a kind differ by more than noise
    is_wave: bool = True  # True where the phases of one wave suit the channels

    @property
    def window(self) -> DetrendedWindow:
        """Window that was fitted, with the motion that the fit was tied to."""
        return self.equations.window

    @property
    def variance(self) -> FloatArray:
        """Variance of each channel's noise, volts^2: (channels,)."""
        return self.equations.variance

    @property
    def k(self) -> FloatArray:
        """Wave vector, radians per millimetre: (2,)."""
        return np.asarray(self.waves.k[0])

    @property
    def phase_rate(self) -> float:
        """Phase rate of the fundamental."""
        return float(self.waves.phase_rate[0])

    @property
    def frequency_hz(self) -> float:
        """Mean frequency of the fundamental."""
        return self.window.frequency_hz(self.phase_rate)

    @property
    def snr_db(self) -> float:
        """Power of the ripple over that of the noise, mean of the channels."""
        snr = float((self.equations.explained / self.variance).mean()) / self.window.n
        return 10 * float(np.log10(max(snr, 1e-10)))


def refine(window: DetrendedWindow, start: PlaneWaves) -> RefinedWave:
    """Climb from a start to the nearest maximum, with the visible harmonics that belong to the wave."""
    n_harmonics = visible_harmonics(window, float(start.phase_rate[0]))
    while True:
        best = _climb(window, start, n_harmonics)
        foreign = foreign_lines(best.waves, best.equations, best.variance)
        if not foreign or n_harmonics == 1:
            return best
        # Power over noise of each harmonic, without the overlap of neighbouring lines.
        parts = best.equations.parts**2 * np.einsum("gff->gf", best.equations.gram)[:, : 2 * n_harmonics]
        if np.argmax((parts.T / best.variance).sum(axis=1).reshape(-1, 2).sum(axis=1)) > 0:
            return replace(best, is_wave=False)
        n_harmonics = max(foreign[0] - 1, 1)


def _climb(window: DetrendedWindow, start: PlaneWaves, n_harmonics: int) -> RefinedWave:
    """Climb until the normal equations are those of the wave's frequency."""
    k, phase_rate, phase = start.k, start.phase_rate, None
    for step in range(_REFINEMENTS):
        best = refine_once(window, k, phase_rate, n_harmonics, phase)
        if step == 0:
            line = best.equations
        moved = max(
            float(np.abs(best.waves.phase_rate - phase_rate)[0]), float(np.abs(best.waves.k - k).max())
        )
        k, phase_rate, phase = best.waves.k, best.waves.phase_rate, best.waves.phase
        if moved < _CONVERGED_RAD:
            break
    return replace(best, is_wave=suits_channels(best, line))


def refine_once(
    window: DetrendedWindow,
    k: FloatArray,
    phase_rate: FloatArray,
    n_harmonics: int,
    phase: FloatArray | None = None,
) -> RefinedWave:
    """Climb from a wave vector (1, 2) and phase rate (1,); `is_wave` is not tested."""
    equations = window.equations(float(phase_rate[0]), n_harmonics)
    solver = WaveSolver(window, equations.variance)
    waves = solver.solve(equations, k, phase_rate, 2, phase)
    return RefinedWave(waves, equations, solver.has_strays(equations, waves))


def suits_channels(best: RefinedWave, line: NormalEquations) -> bool:
    """True where the phases of a wave suit the channels, and explain the line from which the climb began.

    A climb from a strong line of less than a period may end at a rate at which the channels have nothing.
    """
    if abs(best.phase_rate - line.phase_rate) >= _LARGEST_PHASE_RATE_MOVE:
        return False
    free = max(float((own.explained / own.variance).sum()) for own in (line, best.equations))
    noise = float(special.chdtri(len(best.variance) * best.equations.n_harmonics, FALSE_ALARM))
    return free - float(best.waves.gain[0]) < max(_MOST_UNEXPLAINED_PART * free, noise)

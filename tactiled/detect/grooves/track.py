"""Follow a fitted wave from window to window: one Gauss-Newton climb each, and a test for another pattern.

A fit (`fit`) spends its time on questions that one answer settles for the windows after it: which line is the
grooves', which of the wave vectors that its phases allow is the true one, whether there are two waves. The
wave itself costs a thirtieth. It is climbed to from the last answer, in a window of raw scans, with the
equations of the fit; the result is the maximum of the same likelihood, so that nothing accumulates and
standard deviations mean what they mean in a fit. What coloured noise adds to them is that of the last fit.

Another pattern under the skin is noticed by its phasors: the window is divided into blocks, and those of the
newest must be those of the blocks before, apart from a common factor, which an uneven speed and the load
change, too.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.detect.grooves.ambiguity import weigh_interpretations
from tactiled.detect.grooves.estimates import groove_answer
from tactiled.detect.grooves.model import ALIASED, FALSE_ALARM, SAME_WAVE_RAD, TINY
from tactiled.detect.grooves.outcome import GrooveAnswer, NewPattern, Refusal
from tactiled.detect.grooves.refine import RefinedWave, refine_once, suits_channels
from tactiled.detect.grooves.ripple import FEW_PERIODS
from tactiled.detect.grooves.window import STRAIGHT, FitWindow, detrended, trend_basis

# choice: length of a block. Grooves that change by 10 % in period or by 10 degrees must be noticed within 1.6
# s.
_BLOCK_S = 1.0
# prior: periods in a block. With fewer, the slope of a block takes much of a ripple.
_BLOCK_PERIODS = 1.5
_FEWEST_EARLIER = 2  # derived: blocks: of one, it is not known how much its phasors vary
# prior: ratio of the part of a block's power that suits no common factor to its mean over earlier blocks:
# misplaced ridges and uneven pads change every block.
_UNLIKE_EARLIER = 4.0
# prior: power of a block over that of earlier ones: with less, the ripple is gone, not under a lighter load.
_GONE = 1 / 16


def track_wave(
    last: GrooveAnswer, scans: FitWindow, *, is_full: bool = False
) -> GrooveAnswer | NewPattern | None:
    """The wave of an answer in another window, or None where it is not there or where it must be fitted.

    The answer is that of an overlapping window; its error probability remains. A full window without two
    earlier blocks is always fitted: another pattern would not be noticed in it, and the wave of the pattern
    before suits the line of the new one at another speed.
    """
    window = detrended(scans)
    if isinstance(window, Refusal) or last.wave is None:
        return None
    if last.frequency_hz * window.duration_s >= FEW_PERIODS:
        window = window.curved
    if not last.uses_given_speed:
        window = window.without_speed
    wave, phase_rate = last.wave, last.wave.phase_per_travel * window.half_travel
    best = refine_once(window, wave.k[np.newaxis], np.array([phase_rate]), wave.n_harmonics)
    least, most = np.pi * scans.params.min_periods, 2 * np.pi * ALIASED / window.largest_step
    # Of a single step, the equations are those of the line from which it began.
    if not least <= best.phase_rate <= most or not suits_channels(best, best.equations):
        return None
    rate_hz = (window.n - 1) / window.duration_s
    n_block = round(max(_BLOCK_S, _BLOCK_PERIODS / best.frequency_hz) * rate_hz)
    if is_full and window.n // n_block - 1 < _FEWEST_EARLIER:
        return None
    if is_another_pattern(best, n_block):
        return NewPattern("ambiguous", best.frequency_hz, best.snr_db)
    posterior = weigh_interpretations(best, best.waves.k, wave.noise_inflation)
    return groove_answer(best, posterior, wave.scale, wave.noise_inflation, last.error_probability)


def is_another_pattern(best: RefinedWave, n_block: int) -> bool:
    """True where the phasors of the newest block are not those of the blocks before, at least two."""
    window = best.window
    n_channels, n_earlier = len(window.volts), window.n // n_block - 1
    n_terms = 2 * best.equations.n_harmonics + 2  # of the fit of a block
    if n_earlier < _FEWEST_EARLIER or n_channels < 2 or n_block < n_terms:
        return False
    z = _block_phasors(best, n_block) / np.sqrt(best.variance)[:, np.newaxis]
    earlier = np.linalg.svd(z[:, :-1], full_matrices=False)[0][:, 0]
    power = (z.real**2 + z.imag**2).sum(axis=0)
    own = np.abs(earlier.conj() @ z) ** 2
    if own[-1] < _GONE * float(own[:-1].mean()):
        return True
    part = 1 - own / np.maximum(power, TINY)
    # In white noise, each part of a phasor has the variance 2 / n_block; `earlier` has its own.
    white = 2 / n_block * (1 + 1 / n_earlier) * special.chdtri(2 * (n_channels - 1), FALSE_ALARM)
    # Coloured noise makes the earlier blocks unlike, too. One of their degrees of freedom is in `earlier`.
    usual = float(part[:-1].sum()) / (n_earlier - 1)
    return bool(part[-1] > max(SAME_WAVE_RAD**2, white / max(power[-1], TINY), _UNLIKE_EARLIER * usual))


def _block_phasors(best: RefinedWave, n_block: int) -> NDArray[np.complex128]:
    """Phasors of the fundamental in each block, the newest last: (channels, blocks)."""
    window = best.window
    n_blocks = window.n // n_block
    newest = slice(window.n - n_blocks * n_block, window.n)
    harmonics = np.arange(1, best.equations.n_harmonics + 1)[:, np.newaxis, np.newaxis]
    angle = harmonics * best.phase_rate * window.travel[:, newest]
    waves = np.concatenate([np.cos(angle), np.sin(angle)]).swapaxes(0, 1)
    waves = waves.reshape(len(waves), -1, n_blocks, n_block).swapaxes(1, 2)
    slow = np.broadcast_to(trend_basis(n_block, STRAIGHT).T, (*waves.shape[:2], 2, n_block))
    basis = np.concatenate([waves, slow], axis=2)  # (1 or channels, blocks, functions, scans)
    volts = window.volts[:, newest].reshape(-1, n_blocks, n_block, 1)
    parts = np.linalg.solve(basis @ basis.swapaxes(2, 3), basis @ volts)[..., 0]
    return np.asarray(parts[..., 0] - 1j * parts[..., best.equations.n_harmonics])
